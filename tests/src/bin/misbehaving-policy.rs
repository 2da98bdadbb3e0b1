//! A policy for tests with one fault, named by its argument.
//!
//! `crash-on TEXT` and `silent-on TEXT` fail in the episodes whose instruction is TEXT, and `long-name` has a name that does
//! not fit into a message. The other faults are those that the SDK prevents, so they use the bus directly.

#![expect(clippy::unwrap_used, reason = "a policy for tests may end by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use bytemuck::Zeroable;
use domain::Action;
use peer::{Answers, Batch, Decider, ServeError, serve_from_environment};
use shm_types::message::{
    Decision, Handshake, ItemKind, MAX_ITEMS, NOT_MEASURED, Observation, PolicyEpisodeConfig,
    Recall, Role, ShutdownReport, Stop,
};
use shm_types::process::ProcessWatch;
use shm_types::{ATTACH_VARIABLE, Attach, Bus, FrameStore};

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mode = arguments.next().unwrap();
    match (mode.as_str(), arguments.next()) {
        ("crash-on" | "silent-on", Some(victim)) => {
            let outcome =
                serve_from_environment(&mut Picky { crashes: mode == "crash-on", victim });
            if let Err(error) = outcome {
                eprintln!("misbehaving-policy: {error}");
                std::process::exit(2);
            }
        }
        ("long-name", _) => {
            let error = serve_from_environment(&mut LongName("x".repeat(17_000_000)));
            eprintln!("misbehaving-policy: {}", error.unwrap_err());
            std::process::exit(2);
        }
        (mode, _) => raw(mode),
    }
}

/// A policy with a long name.
struct LongName(String);

impl peer::Policy for LongName {
    fn name(&self) -> &str {
        &self.0
    }

    fn act(&mut self, _: &[peer::Request<'_>]) -> Vec<peer::Decision> {
        Vec::new()
    }
}

/// Turns left in all episodes but those with the instruction `victim`.
struct Picky {
    crashes: bool,
    victim: String,
}

impl Decider for Picky {
    fn name(&self) -> &str {
        "picky"
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        for request in batch.iter() {
            if request.instruction != self.victim {
                let decision = peer::Decision::act(request, Action::TurnLeft);
                answers.decide(request.id(), decision);
            } else if self.crashes && request.step == 3 {
                eprintln!("I cannot stand this one");
                std::process::abort();
            } else if self.crashes {
                let decision = peer::Decision::act(request, Action::TurnLeft);
                answers.decide(request.id(), decision);
            }
        }
        Ok(())
    }
}

/// The messages received for a lane.
#[derive(Default)]
struct Lane {
    episode: u64,
    observed: Option<u32>,
    recalled: Option<u32>,
    decided: Option<u32>,
}

/// Turns left, without the SDK.
fn raw(mode: &str) {
    let folder = PathBuf::from(std::env::var_os(ATTACH_VARIABLE).unwrap());
    let attach = if mode == "ignores-the-wire-version" {
        let text = fs::read_to_string(folder.join("attach.json")).unwrap();
        let attach: Attach = serde_json::from_str(&text).unwrap();
        Attach { wire_version: shm_types::message::WIRE_VERSION, root: folder, ..attach }
    } else {
        Attach::read(&folder).unwrap()
    };
    let watch = ProcessWatch::new(attach.orchestrator_pid).unwrap();
    let bus = Bus::join(attach, Role::Policy).unwrap();
    let configs = bus.receiver::<PolicyEpisodeConfig>().unwrap();
    let observation_queue = bus.receiver::<Observation>().unwrap();
    let recall_queue = bus.receiver::<Recall>().unwrap();
    let stops = bus.receiver::<Stop>().unwrap();
    let mut frames = FrameStore::new(&bus).unwrap();
    let documents = shm_types::DocumentStore::new(&bus).unwrap();
    let decisions = bus.sender::<Decision>().unwrap();
    let orchestrator = bus.notifier(Role::Orchestrator).unwrap();
    if mode != "no-handshake" {
        let handshake = Handshake::new(Role::Policy, [("policy", mode.to_owned())]).unwrap();
        let handshake = Handshake {
            wire_version: handshake.wire_version + u32::from(mode == "old"),
            ..handshake
        };
        bus.sender().unwrap().send(&handshake).unwrap();
        orchestrator.notify().unwrap();
    }
    let mut lanes: BTreeMap<u32, Lane> = BTreeMap::new();
    let mut answered = 0;
    loop {
        let (recalls, observations) =
            (recall_queue.drain().unwrap(), observation_queue.drain().unwrap());
        for PolicyEpisodeConfig { lane, episode, .. } in configs.drain().unwrap() {
            lanes.insert(lane, Lane { episode, ..Lane::default() });
        }
        let mut due = Vec::new();
        for Observation { lane, episode, step, last, frame, .. } in observations {
            let entry = lanes.entry(lane).or_default();
            if last == 1 && mode != "decides-the-end" {
                lanes.remove(&lane);
            } else if mode == "takes-the-late" || entry.episode == episode {
                let _ = frames.get(frame);
                entry.observed = Some(step);
                if last == 1 {
                    // No recall follows.
                    entry.recalled = Some(step);
                }
                due.push((lane, episode, step));
            }
        }
        for Recall { lane, episode, step, items_len, items, .. } in recalls {
            let mut items = items[..items_len.min(MAX_ITEMS as u32) as usize].iter();
            if mode == "knows-no-captions" && items.any(|item| item.kind == ItemKind::Frame as u8) {
                eprintln!("I know no captions");
                std::process::abort();
            }
            let entry = lanes.entry(lane).or_default();
            if mode == "takes-the-late" || entry.episode == episode {
                entry.recalled = Some(step);
                due.push((lane, episode, step));
            }
        }
        due.dedup();
        for (lane, episode, step) in due {
            let Some(entry) = lanes.get_mut(&lane) else { continue };
            let is_due = match mode {
                "decides-early" => entry.decided != Some(step),
                _ => entry.observed == Some(step) && entry.recalled == Some(step),
            };
            if !is_due {
                continue;
            }
            (entry.observed, entry.recalled, entry.decided) = (None, None, Some(step));
            answered += 1;
            let action = if mode == "draws" { answered % 7 } else { Action::TurnLeft as u32 } as u8;
            let usual = Decision {
                episode,
                lane,
                step,
                action,
                images_asked: NOT_MEASURED,
                images: if mode == "miscounts" { NOT_MEASURED - 1 } else { NOT_MEASURED },
                attempts: NOT_MEASURED,
                prompt_tokens: NOT_MEASURED,
                completion_tokens: NOT_MEASURED,
                cached_tokens: NOT_MEASURED,
                image_tokens: NOT_MEASURED,
                memory_tokens: NOT_MEASURED,
                reusable_tokens: NOT_MEASURED,
                ..Zeroable::zeroed()
            };
            let sent = match mode {
                "silent" | "no-handshake" => vec![],
                "wrong-lane" => vec![Decision { lane: lane + 1, ..usual }],
                "no-such-lane" => vec![Decision { lane: 4242, ..usual }],
                "wrong-step" => vec![Decision { step: step + 1, ..usual }],
                "garbage" => vec![Decision { outcome: 77, ..usual }],
                "twice" => vec![usual; 2],
                "flood" => vec![usual; 5000],
                // It closes its queues, and does not end.
                "leaves" if answered == 20 => {
                    drop((configs, observation_queue, stops, frames, documents, decisions));
                    drop((orchestrator, recall_queue, bus));
                    loop {
                        std::thread::sleep(Duration::from_secs(1));
                    }
                }
                "crash" if answered == 20 => {
                    eprintln!("I am no good at this");
                    std::process::abort();
                }
                _ => vec![usual],
            };
            // A flood fills the queue.
            sent.iter().for_each(|decision| drop(decisions.send(decision)));
            orchestrator.notify().unwrap();
        }
        if mode != "keeps-frames" {
            let _ = frames.apply_evictions();
        }
        if stops.next().unwrap().is_some() && mode != "ignores-stop" {
            if mode != "no-shutdown-report" {
                let shutdown_report =
                    ShutdownReport { role: Role::Policy as u32, ..Zeroable::zeroed() };
                bus.sender().unwrap().send(&shutdown_report).unwrap();
                orchestrator.notify().unwrap();
            }
            return;
        }
        if watch.has_ended() && mode != "outlives" {
            return;
        }
        bus.listener().wait(Duration::from_millis(200)).unwrap();
    }
}
