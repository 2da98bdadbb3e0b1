//! Messages and notifications between the nodes of a run.

use std::fs;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::attach::Wait;
use shm_types::message::{
    Decision, ErrorReport, Handshake, Observation, PolicyEpisodeConfig, Role, ShutdownReport,
    StepCommand, Stop, read_text,
};
use shm_types::{Attach, BusError, ErrorReporter};

use crate::common::{LONG, Run, bus, run};

fn command(lane: u32) -> StepCommand {
    StepCommand { lane, ..Zeroable::zeroed() }
}

fn decision(step: u32) -> Decision {
    Decision { step, ..Zeroable::zeroed() }
}

#[test]
fn a_message_reaches_its_receiver_and_notifies_it() {
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let commands = sim.receiver::<StepCommand>().unwrap();
    let sender = orchestrator.sender::<StepCommand>().unwrap();
    let notifier = orchestrator.notifier(Role::Sim).unwrap();
    for lane in 0..16 {
        sender.send(&command(lane)).unwrap();
    }
    notifier.notify().unwrap();
    assert!(sim.listener().wait(LONG).unwrap());
    let lanes: Vec<u32> = commands.drain().unwrap().iter().map(|c| c.lane).collect();
    assert_eq!(lanes, Vec::from_iter(0..16));
    assert_eq!(commands.next().unwrap(), None);
    assert!(!sim.listener().wait(Duration::ZERO).unwrap(), "one notification, taken once");
    assert!(!sim.listener().wait(Duration::from_micros(10)).unwrap());
}

#[test]
fn every_receiver_gets_it_and_a_missing_one_is_an_error() {
    let Run { attach, .. } = &run();
    let sim = bus(attach, Role::Sim);
    let sender = sim.sender::<Observation>().unwrap();
    let others = [Role::Memory, Role::Policy].map(|role| bus(attach, role));
    let mut receivers = Vec::from(others.each_ref().map(|b| b.receiver::<Observation>().unwrap()));
    sender.send(&Zeroable::zeroed()).unwrap();
    assert!(receivers.iter().all(|r| r.next().unwrap().is_some()));
    receivers.pop();
    let error = sender.send(&Zeroable::zeroed()).unwrap_err();
    assert!(matches!(error, BusError::Deserted { expected: 2, found: 1, .. }), "{error}");
}

#[test]
fn a_stop_message_explains_a_missing_receiver_and_no_other_error() {
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let others = [Role::Memory, Role::Policy].map(|role| bus(attach, role));
    let stops = sim.receiver::<Stop>().unwrap();
    let _other_stops = others.each_ref().map(|b| b.receiver::<Stop>().unwrap());
    let sender = sim.sender::<Observation>().unwrap();
    let receivers = others.each_ref().map(|b| b.receiver::<Observation>().unwrap());
    sender.send(&Zeroable::zeroed()).unwrap();
    drop(receivers);
    let missing = sender.send(&Zeroable::zeroed()).unwrap_err();
    assert!(!stops.explains(&missing).unwrap(), "the run goes on");
    orchestrator.sender::<Stop>().unwrap().send(&Zeroable::zeroed()).unwrap();
    let full = BusError::Full { service: "observation" };
    assert!(!stops.explains(&full).unwrap());
    assert!(stops.explains(&missing).unwrap());
}

/// Left to itself, iceoryx2 warns only, and what is sent is lost.
#[test]
fn a_receiver_that_cannot_connect_to_a_sender_fails() {
    let without_segments = |attach: &Attach| {
        for entry in fs::read_dir("/dev/shm").unwrap().flatten() {
            let name = entry.file_name().into_string().unwrap();
            if name.starts_with(&attach.prefix) && name.ends_with(".data") {
                fs::remove_file(entry.path()).unwrap();
            }
        }
    };
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let _sender = orchestrator.sender::<StepCommand>().unwrap();
    without_segments(attach);
    let error = sim.receiver::<StepCommand>().unwrap_err().to_string();
    assert!(error.contains("no connection to a sender"), "{error}");

    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let commands = sim.receiver::<StepCommand>().unwrap();
    let _sender = orchestrator.sender::<StepCommand>().unwrap();
    without_segments(attach);
    commands.next().unwrap_err();
}

#[test]
fn sending_never_waits_for_a_missing_receiver_unless_asked_to() {
    let Run { attach, .. } = &run();
    let (sent, was_sent) = mpsc::channel();
    thread::scope(|scope| {
        scope.spawn(move || {
            let policy = bus(attach, Role::Policy);
            let decisions = policy.sender::<Decision>().unwrap();
            sent.send(decisions.send(&decision(1))).unwrap();
            decisions.wait_for_receivers(LONG).unwrap();
            decisions.send(&decision(2)).unwrap();
            assert!(policy.listener().wait(LONG).unwrap());
        });
        let error = was_sent.recv_timeout(LONG / 4).unwrap().unwrap_err();
        assert!(matches!(error, BusError::Deserted { expected: 1, found: 0, .. }), "{error}");
        let orchestrator = bus(attach, Role::Orchestrator);
        let decisions = orchestrator.receiver::<Decision>().unwrap();
        let first = std::iter::repeat_with(|| decisions.next().unwrap()).find_map(|found| found);
        assert_eq!(first, Some(decision(2)));
        orchestrator.notifier(Role::Policy).unwrap().notify().unwrap();
    });
}

#[test]
fn waiting_for_receivers_ends() {
    let Run { attach, .. } = &run();
    let policy = bus(attach, Role::Policy);
    let decisions = policy.sender::<Decision>().unwrap();
    let error = decisions.wait_for_receivers(Duration::ZERO).unwrap_err();
    assert!(matches!(error, BusError::Deserted { expected: 1, found: 0, .. }), "{error}");
}

#[test]
fn first_and_last_messages_arrive_from_a_sender_that_was_dropped() {
    let Run { attach, .. } = &run();
    let orchestrator = bus(attach, Role::Orchestrator);
    let (handshakes, shutdown_reports) = (
        orchestrator.handshake_receiver().unwrap(),
        orchestrator.receiver::<ShutdownReport>().unwrap(),
    );
    let policy = bus(attach, Role::Policy);
    policy.sender::<Handshake>().unwrap().send(&Zeroable::zeroed()).unwrap();
    assert!(handshakes.next().unwrap().is_some());
    policy.sender::<ShutdownReport>().unwrap().send(&Zeroable::zeroed()).unwrap();
    policy.sender::<ShutdownReport>().unwrap().send(&Zeroable::zeroed()).unwrap();
    drop(policy);
    assert_eq!(shutdown_reports.drain().unwrap().len(), 2);
}

#[test]
fn a_message_outlives_its_sender_for_connected_receivers() {
    let Run { attach, .. } = &run();
    let (orchestrator, policy) = (bus(attach, Role::Orchestrator), bus(attach, Role::Policy));
    let decisions = orchestrator.receiver::<Decision>().unwrap();
    let sender = policy.sender::<Decision>().unwrap();
    assert_eq!(decisions.next().unwrap(), None);
    sender.send(&decision(1)).unwrap();
    sender.send(&decision(2)).unwrap();
    drop(sender);
    drop(policy);
    assert_eq!(decisions.drain().unwrap(), [decision(1), decision(2)]);
}

#[test]
fn messages_of_many_short_lived_senders_all_arrive() {
    let Run { attach, .. } = &run();
    let orchestrator = bus(attach, Role::Orchestrator);
    let handshakes = orchestrator.handshake_receiver().unwrap();
    let decisions = orchestrator.receiver::<Decision>().unwrap();
    let sent: Vec<_> = (0..16).map(decision).collect();
    for message in &sent {
        let policy = bus(attach, Role::Policy);
        let sender = policy.sender::<Decision>().unwrap();
        policy.sender::<Handshake>().unwrap().send(&Zeroable::zeroed()).unwrap();
        assert!(handshakes.next().unwrap().is_some());
        sender.send(message).unwrap();
    }
    assert_eq!(decisions.drain().unwrap(), sent);
}

#[test]
fn a_full_queue_is_an_error_and_not_a_wait() {
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let commands = sim.receiver::<StepCommand>().unwrap();
    let sender = orchestrator.sender::<StepCommand>().unwrap();
    let room = 2 * attach.lanes + 16;
    assert_eq!(commands.next().unwrap(), None);
    for lane in 0..room {
        sender.send(&command(lane)).unwrap();
    }
    for _ in 0..3 {
        let error = sender.send(&command(0)).unwrap_err();
        assert!(matches!(error, BusError::Full { service: "command" }), "{error}");
    }
    assert_eq!(commands.drain().unwrap().len(), room as usize);
    sender.send(&command(0)).unwrap();
}

#[test]
fn a_role_cannot_use_the_services_of_another() {
    let Run { attach, .. } = &run();
    let policy = bus(attach, Role::Policy);
    let error = policy.sender::<StepCommand>().unwrap_err();
    assert_eq!(error.to_string(), "the policy process may not send on command");
    let error = policy.receiver::<StepCommand>().unwrap_err();
    assert_eq!(error.to_string(), "the policy process may not receive on command");
}

#[test]
fn runs_and_generations_never_meet() {
    let (one, other) = (run(), run());
    let next = Attach { generation: 2, ..one.attach.clone() };
    let senders = bus(&one.attach, Role::Orchestrator);
    let sender = senders.sender::<StepCommand>().unwrap();
    let sims = [&one.attach, &next, &other.attach].map(|attach| bus(attach, Role::Sim));
    let receivers = sims.each_ref().map(|sim| sim.receiver::<StepCommand>().unwrap());
    sender.send(&command(3)).unwrap();
    senders.notifier(Role::Sim).unwrap().notify().unwrap();
    assert!(receivers[0].next().unwrap().is_some());
    assert!(sims[0].listener().wait(Duration::ZERO).unwrap());
    for (sim, receiver) in sims.iter().zip(&receivers).skip(1) {
        assert_eq!(receiver.next().unwrap(), None);
        assert!(!sim.listener().wait(Duration::ZERO).unwrap());
    }
}

/// Two nodes send each other messages and sleep in between; a lost notification would leave both asleep.
fn ping_pong(spin_us: u32) {
    const ROUNDS: u32 = 5_000;
    let Run { attach, .. } = &run();
    let attach = &Attach { wait: Wait { spin_us }, ..attach.clone() };
    thread::scope(|scope| {
        scope.spawn(|| {
            let policy = bus(attach, Role::Policy);
            let configs = policy.receiver::<PolicyEpisodeConfig>().unwrap();
            let decisions = policy.sender::<Decision>().unwrap();
            let notifier = policy.notifier(Role::Orchestrator).unwrap();
            let mut seen = 0;
            while seen < ROUNDS {
                for PolicyEpisodeConfig { episode, .. } in configs.drain().unwrap() {
                    decisions.send(&decision(episode as u32)).unwrap();
                    seen += 1;
                }
                notifier.notify().unwrap();
                if seen < ROUNDS {
                    policy.listener().wait(4 * LONG).unwrap();
                }
            }
            // Stay until everything has arrived.
            policy.listener().wait(LONG).unwrap();
        });
        let orchestrator = bus(attach, Role::Orchestrator);
        let decisions = orchestrator.receiver::<Decision>().unwrap();
        let configs = orchestrator.sender::<PolicyEpisodeConfig>().unwrap();
        let notifier = orchestrator.notifier(Role::Policy).unwrap();
        configs.wait_for_receivers(LONG).unwrap();
        let (mut sent, mut seen) = (0, 0);
        while seen < ROUNDS {
            // One to four messages in flight, and a notification for each batch.
            while sent < ROUNDS && sent - seen <= sent % 4 {
                let config = PolicyEpisodeConfig { episode: sent.into(), ..Zeroable::zeroed() };
                configs.send(&config).unwrap();
                sent += 1;
            }
            notifier.notify().unwrap();
            orchestrator.listener().wait(4 * LONG).unwrap();
            for Decision { step, .. } in decisions.drain().unwrap() {
                assert_eq!(step, seen);
                seen += 1;
            }
        }
        notifier.notify().unwrap();
    });
}

#[test]
fn no_notification_is_lost() {
    ping_pong(0);
}

#[test]
fn no_notification_is_lost_with_polling() {
    ping_pong(50);
}

#[test]
fn error_reports_are_counted_and_never_block() {
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let mut reporter = ErrorReporter::new(&sim).unwrap();
    reporter.report("no receiver yet");
    let receiver = orchestrator.receiver::<ErrorReport>().unwrap();
    for lane in 0..1000 {
        reporter.report(format_args!("lane {lane} is not below 4"));
    }
    assert_eq!(reporter.count(), 1001);
    let first = receiver.next().unwrap().unwrap();
    assert_eq!(read_text(&first.text, first.text_len), Ok("lane 0 is not below 4"));
    assert_eq!((first.role, first.count), (Role::Sim as u32, 2));
}
