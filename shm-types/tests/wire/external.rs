//! Banks and notes, and services of which each external memory has its own.

use bytemuck::Zeroable;
use shm_types::banks::{BankDemonstration, BankStep, max_banks};
use shm_types::message::{ExternalEpisode, Heartbeat, NO_FRAME, Role};
use shm_types::notes::NoteHeader;
use shm_types::{
    Attach, BankContent, BankPublisher, BankReceiver, Bus, NotePublisher, NoteReceiver, NoteTooLong,
};

use crate::common::{LONG, Run, bus, run};

/// A run with the external memories 0 and 2: memory, and both of them.
fn joined(run: &Run) -> (Bus, [Bus; 2]) {
    let attach = Attach { external_memories: vec![0, 2], ..run.attach.clone() };
    let external = |index| Bus::join_as(attach.clone(), Role::ExternalMemory, index).unwrap();
    (bus(&attach, Role::Memory), [external(0), external(2)])
}

#[test]
fn each_external_memory_has_its_own_queue_and_listener() {
    let run = run();
    let (memory, [first, second]) = joined(&run);
    let receivers = [&first, &second].map(|bus| bus.receiver::<ExternalEpisode>().unwrap());
    for (index, episode) in [(2, 5), (0, 6)] {
        let message = ExternalEpisode { episode, ..Zeroable::zeroed() };
        memory.sender_to::<ExternalEpisode>(index).unwrap().send(&message).unwrap();
    }
    memory.notifier_of(Role::ExternalMemory, 2).unwrap().notify().unwrap();
    assert!(second.listener().wait(LONG).unwrap());
    let received = receivers.map(|receiver| receiver.drain().unwrap());
    assert_eq!(received.map(|all| all.iter().map(|m| m.episode).collect::<Vec<_>>()), [[6], [5]]);

    // What all send to the orchestrator is one service, and says from whom it is.
    let orchestrator = Bus::join(first.attach().clone(), Role::Orchestrator).unwrap();
    let heartbeats = orchestrator.receiver::<Heartbeat>().unwrap();
    for bus in [&memory, &first, &second] {
        let beat = Heartbeat { index: bus.index().into(), done: 1, ..Zeroable::zeroed() };
        bus.sender::<Heartbeat>().unwrap().send(&beat).unwrap();
    }
    let from = heartbeats.drain().unwrap().iter().map(|beat| beat.index).collect::<Vec<_>>();
    assert_eq!(from, [0, 0, 2]);
}

#[test]
fn a_bank_is_read_where_it_was_written_and_outlives_its_queue() {
    let run = run();
    let (memory, [external, _]) = joined(&run);
    let mut receiver = BankReceiver::new(&external).unwrap();
    let mut publisher = BankPublisher::new(&memory, 0).unwrap();
    let step = |x: u8| BankStep { frame: NO_FRAME, content_hash: [x; 16], ..Zeroable::zeroed() };
    let demonstration = |first_step, steps, first_byte, bytes| BankDemonstration {
        first_step,
        steps,
        first_byte,
        bytes,
    };
    let content = BankContent {
        demonstrations: vec![demonstration(0, 2, 0, 6), demonstration(2, 1, 6, 9)],
        steps: vec![step(1), step(2), step(3)],
        embeddings: (0..9).map(|n| n as f32).collect(),
        text: "a conea bärrel".to_owned(),
    };
    let most = max_banks(external.attach());
    let mut kept = Vec::new();
    for id in 0..most as u64 {
        publisher.publish(id, &content).unwrap();
        kept.push(receiver.take().unwrap().unwrap().unwrap());
    }
    for (id, bank) in kept.iter().enumerate() {
        assert_eq!((bank.id(), bank.dimension()), (id as u64, 3));
        assert_eq!(bank.steps(), content.steps);
        assert_eq!(bank.embeddings(), content.embeddings);
        assert_eq!(bank.demonstrations(), content.demonstrations);
        let instructions = bank.demonstrations().iter().map(|d| bank.instruction(d));
        assert_eq!(instructions.collect::<Vec<_>>(), ["a cone", "a bärrel"]);
    }
    publisher.take_back(3).unwrap();
    let taken = receiver.take().unwrap().unwrap().unwrap();
    assert!(taken.id() == 3 && taken.demonstrations().is_empty() && taken.embeddings().is_empty());

    // A large one.
    let rows = 5000;
    let large = BankContent {
        demonstrations: vec![demonstration(0, rows, 0, 0)],
        steps: vec![step(7); rows as usize],
        embeddings: vec![0.5; 384 * rows as usize],
        text: String::new(),
    };
    publisher.publish(1 << 40, &large).unwrap();
    let bank = receiver.take().unwrap().unwrap().unwrap();
    assert_eq!((bank.steps().len(), bank.dimension(), bank.embeddings()[9]), (5000, 384, 0.5));

    // What points outside of the bank is refused.
    for bad in [demonstration(2, 2, 0, 0), demonstration(0, 0, 0, 0), demonstration(0, 1, 9, 9)] {
        let content = BankContent { demonstrations: vec![bad], ..content.clone() };
        publisher.publish(99, &content).unwrap();
        let error = receiver.take().unwrap().unwrap().unwrap_err().to_string();
        assert!(error.starts_with("bank 99: a demonstration lies outside"), "{error}");
    }
}

#[test]
fn notes_arrive_with_their_lane_and_episode() {
    let run = run();
    let (memory, [_, external]) = joined(&run);
    let mut receiver = NoteReceiver::new(&memory, 2).unwrap();
    let mut publisher = NotePublisher::new(&external).unwrap();
    let ids = [(1, 7, "left of the door".repeat(1000)), (3, 9, String::new())]
        .map(|(lane, episode, text)| publisher.publish(lane, episode, text.as_bytes()).unwrap());
    let notes = receiver.drain().unwrap();
    let headers: Vec<NoteHeader> = notes.iter().map(|note| note.header).collect();
    let header = |id, episode, lane| NoteHeader { id, episode, lane, reserved: 0 };
    assert_eq!(headers, [header(ids[0], 7, 1), header(ids[1], 9, 3)]);
    assert_eq!(notes[0].bytes.as_ref().map(Vec::len), Ok(16_000));

    let long = vec![0; (16 << 20) + 1];
    let refused = publisher.publish(0, 0, &long).unwrap_err().to_string();
    let expected = "have 16777217 bytes together, and at most 16777216 can be sent";
    assert!(refused.ends_with(expected), "{refused}");
    publisher.publish_of_any_length(0, 0, &long).unwrap();
    let received = receiver.drain().unwrap().remove(0).bytes;
    assert_eq!(received, Err(NoteTooLong { bytes: long.len() }));
}
