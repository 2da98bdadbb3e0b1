//! Several worlds in a run: what each has of its own, and what they share.

use bytemuck::Zeroable;
use shm_types::message::{NO_DOCUMENT, Observation, Role, StepCommand};
use shm_types::{Attach, Bus, BusError, FramePublisher, FrameStore, NotePublisher, NoteReceiver};

use crate::common::{LONG, Run, bus, run};

/// The worlds of a run with three.
fn joined(attach: &Attach) -> [Bus; 3] {
    [0, 1, 2].map(|index| Bus::join_as(attach.clone(), Role::Sim, index).unwrap())
}

#[test]
fn each_world_has_its_own_queue_and_listener_and_no_other_process_has_its_place() {
    let Run { attach, .. } = &run();
    let attach = &Attach { worlds: 3, ..attach.clone() };
    assert_eq!([0, 1, 2, 3, 4].map(|lane| attach.world_of(lane)), [0, 1, 2, 0, 1]);
    let orchestrator = bus(attach, Role::Orchestrator);
    let worlds = joined(attach);
    let commands = worlds.each_ref().map(|world| world.receiver::<StepCommand>().unwrap());
    for (index, episode) in [(2, 5), (0, 6)] {
        let command = StepCommand { episode, ..Zeroable::zeroed() };
        orchestrator.sender_to::<StepCommand>(index).unwrap().send(&command).unwrap();
        orchestrator.notifier_of(Role::Sim, index).unwrap().notify().unwrap();
        assert!(worlds[usize::from(index)].listener().wait(LONG).unwrap());
    }
    let received = commands.map(|queue| queue.drain().unwrap());
    let episodes = received.map(|all| all.iter().map(|m| m.episode).collect::<Vec<_>>());
    assert_eq!(episodes, [vec![6], vec![], vec![5]]);

    let taken = Bus::join_as(attach.clone(), Role::Sim, 2).unwrap_err();
    assert!(matches!(taken, BusError::Taken { role: Role::Sim }), "{taken}");
    let fourth = Bus::join_as(attach.clone(), Role::Sim, 3).unwrap_err().to_string();
    assert_eq!(fourth, "worlds is 3, but must be more than 3, the index of this world");
}

#[test]
fn frames_observations_and_facts_of_all_worlds_arrive_under_different_ids() {
    let Run { attach, .. } = &run();
    let attach = &Attach { worlds: 3, ..attach.clone() };
    let [memory, policy, orchestrator] =
        [Role::Memory, Role::Policy, Role::Orchestrator].map(|role| bus(attach, role));
    let mut stores = [&memory, &policy].map(|bus| FrameStore::new(bus).unwrap());
    let seen = [&memory, &policy].map(|bus| bus.receiver::<Observation>().unwrap());
    let mut facts = NoteReceiver::of_facts(&orchestrator).unwrap();
    let worlds = joined(attach);
    let mut ids = Vec::new();
    for (value, world) in (1..).zip(&worlds) {
        let mut frames = FramePublisher::new(world).unwrap();
        // As many as each store holds: what one world publishes takes no room from another.
        for _ in 0..attach.frame_capacity {
            let mut slot = frames.loan().unwrap();
            slot.pixels_mut().fill(value);
            let frame = frames.publish(slot, [value; 16]).unwrap();
            for store in &mut stores {
                assert_eq!(store.get(frame).unwrap().unwrap().pixels()[0], value);
            }
            ids.push(frame);
        }
        let observation = Observation { frame: ids[0], ..Zeroable::zeroed() };
        world.sender().unwrap().send(&observation).unwrap();
        NotePublisher::of_facts(world).unwrap().publish(0, 1, b"{}").unwrap();
        assert!(stores.iter().all(|store| store.len() == ids.len()));
    }
    let mut notes: Vec<_> = facts.drain().unwrap().iter().map(|note| note.header.id).collect();
    let counts = [ids.len(), notes.len()];
    ids.sort_unstable();
    ids.dedup();
    notes.retain(|&id| id != NO_DOCUMENT);
    notes.sort_unstable();
    notes.dedup();
    assert_eq!([ids.len(), notes.len()], counts);
    assert_eq!(seen.map(|queue| queue.drain().unwrap().len()), [3, 3]);
}
