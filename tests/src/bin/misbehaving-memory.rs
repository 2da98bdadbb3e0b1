//! An external memory for tests with one fault, named by its argument; `well-behaved` has none.
//!
//! The SDK prevents most of the faults, so this uses the bus directly. A fault in one episode has the episode's instruction as
//! second argument; with `sdk-` before its name, it is committed through the SDK.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use bytemuck::Zeroable;
use case_book::{BookFile, WORLD_FILE, WorldDeclaration};
use peer::memory::{Memory, MemoryError, MemoryItem, Method, Query};
use serde_json::json;
use shm_types::description::run_of_memory_folder;
use shm_types::message::{
    AnswerItem, ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery, ExternalStore,
    ExternalStored, Handshake, ItemKind, Learning, MAX_INSTRUCTION, NOT_MEASURED, Role,
    ShutdownReport, Stop, WIRE_VERSION, read_text,
};
use shm_types::process::{ProcessWatch, monotonic_ns};
use shm_types::{
    ATTACH_VARIABLE, Attach, AttachError, Bank, BankReceiver, Bus, ErrorReporter, FrameStore,
    MemoryDescription, NotePublisher, registry,
};

/// The text that the memory supplies.
const TEXT: &str = "Zurück zum Tor.";

/// Faults of a memory that learns.
const LEARNING: [&str; 4] =
    ["saves-nothing", "saves-the-time", "loads-nothing", "learns-from-evaluations"];

/// Bytes of a text that is too long to be sent.
const HUGE: usize = 17_000_000;

/// The step at which a fault in one episode occurs.
const FAULTY_STEP: u32 = 3;

/// Text of a query that cannot be answered.
const UNUSABLE: &str = "the query cannot be used";

fn main() -> anyhow::Result<()> {
    let mode = std::env::args().nth(1).context("usage: misbehaving-memory FAULT")?;
    let victim = std::env::args().nth(2).unwrap_or_default();
    let folder = PathBuf::from(std::env::var_os(ATTACH_VARIABLE).context(ATTACH_VARIABLE)?);
    if let Some(fault) = mode.strip_prefix("sdk-") {
        let description = MemoryDescription {
            name: mode.clone(),
            deterministic: true,
            ..MemoryDescription::default()
        };
        let (fault, victim) = (fault.to_owned(), victim);
        let create = move || FaultyMemory { fault: fault.clone(), victim: victim.clone() };
        return Ok(peer::memory::serve(&Method::new(description, create), &folder)?);
    }
    if mode == "leaves-a-lock" {
        let lock = fs::File::create_new(folder.join("my.lock"));
        lock.unwrap_or_else(|_| fail("I run already"));
    }
    describe(&mode, &folder)?;
    let (run, index) = run_of_memory_folder(&folder).context("not the folder of a memory")?;
    let attach = wait_for_run(&mode, run)?;
    serve(&mode, &victim, attach, index)
}

/// A memory with the SDK that is at fault in the episodes with the instruction `victim`.
struct FaultyMemory {
    fault: String,
    victim: String,
}

impl Memory for FaultyMemory {
    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        if query.instruction != self.victim || query.now.step != FAULTY_STEP {
            return Ok(Vec::new());
        }
        match self.fault.as_str() {
            "huge-text" => {
                Ok(vec![MemoryItem::Text { text: "x".repeat(HUGE).into(), sources: Vec::new() }])
            }
            "huge-reason" => Err(MemoryError::new("x".repeat(HUGE))),
            fault => fail(&format!("there is no fault {fault} with the SDK")),
        }
    }
}

fn fail(why: &str) -> ! {
    eprintln!("{why}");
    std::process::exit(3)
}

fn describe(mode: &str, folder: &Path) -> anyhow::Result<()> {
    let description = MemoryDescription {
        name: mode.to_owned(),
        version: "1".to_owned(),
        frames: mode == "keeps-frames",
        deterministic: true,
        learns: mode == "well-behaved" || LEARNING.contains(&mode),
        ..MemoryDescription::default()
    };
    match mode {
        "undescribed" => {}
        "huge-description" => {
            let text = json!({ "name": mode, "version": "1".repeat(HUGE) }).to_string();
            let draft = folder.join("draft.json");
            fs::write(&draft, text)?;
            fs::rename(draft, folder.join("description.json"))?;
        }
        "nameless" => {
            let text = r#"{"name": "My Memory", "version": "1"}"#;
            // Renamed, so that it is read whole.
            let draft = folder.join("draft.json");
            fs::write(&draft, text)?;
            fs::rename(draft, folder.join("description.json"))?;
        }
        _ => description.write(folder)?,
    }
    Ok(())
}

fn wait_for_run(mode: &str, run: &Path) -> anyhow::Result<Attach> {
    loop {
        let attach = if mode == "ignores-the-wire-version" {
            let text = fs::read_to_string(run.join("attach.json")).ok();
            let attach = text.map(|text| serde_json::from_str::<Attach>(&text)).transpose()?;
            attach.map(|attach| Attach {
                wire_version: WIRE_VERSION,
                root: run.to_owned(),
                ..attach
            })
        } else {
            match Attach::read(run) {
                Ok(attach) => Some(attach),
                Err(AttachError::File { .. }) => None,
                Err(error) => bail!(error),
            }
        };
        if let Some(attach) = attach {
            return Ok(attach);
        }
        if mode == "hasty" {
            fail("there is no run");
        }
        ensure!(registry::is_alive(run) || mode == "waits-forever", "the run is over");
        thread::sleep(Duration::from_millis(5));
    }
}

/// The episode of a lane.
#[derive(Clone, Copy)]
struct Episode {
    id: u64,
    budgets: (u32, u32),
    is_over: bool,
    is_valid: bool,
    is_victim: bool,
    bank: u64,
    learns: bool,
}

fn serve(mode: &str, victim: &str, attach: Attach, index: u8) -> anyhow::Result<()> {
    let watch = ProcessWatch::new(attach.orchestrator_pid)?;
    let lanes = attach.lanes;
    let world = BookFile::<WorldDeclaration>::read(&attach.root.join(WORLD_FILE))?.book;
    let bus = Bus::join_as(attach, Role::ExternalMemory, index)?;
    let mut bank_queue = BankReceiver::new(&bus)?;
    let episode_queue = bus.receiver::<ExternalEpisode>()?;
    let query_queue = bus.receiver::<ExternalQuery>()?;
    let stops = bus.receiver::<Stop>()?;
    let mut frames = FrameStore::new(&bus)?;
    let mut notes = NotePublisher::new(&bus)?;
    let built = bus.sender::<ExternalBuilt>()?;
    let stores = bus.receiver::<ExternalStore>()?;
    let stored = bus.sender::<ExternalStored>()?;
    let answers = bus.sender::<ExternalAnswer>()?;
    let mut errors = ErrorReporter::new(&bus)?;
    let orchestrator = bus.notifier(Role::Orchestrator)?;
    let host = bus.notifier(Role::Memory)?;
    if mode != "no-handshake" {
        let handshake = Handshake::new(Role::ExternalMemory, [("memory", mode.to_owned())])?;
        let handshake = Handshake {
            wire_version: handshake.wire_version + u32::from(mode == "old"),
            index: u32::from(index) + u32::from(mode == "wrong-index"),
            ..handshake
        };
        bus.sender()?.send(&handshake)?;
        orchestrator.notify()?;
    }
    // By id: the steps of each demonstration.
    let mut banks: BTreeMap<u64, Vec<u32>> = BTreeMap::new();
    // By id of the bank: the number of episodes that it was learned from.
    let mut learned: BTreeMap<u64, u32> = BTreeMap::new();
    let mut kept = Vec::new();
    let mut episodes: BTreeMap<u32, Episode> = BTreeMap::new();
    let mut announced: Vec<ExternalEpisode> = Vec::new();
    let mut answered = 0;
    loop {
        let to_store = stores.drain()?;
        let (queries, begun) = (query_queue.drain()?, episode_queue.drain()?);
        while let Some(bank) = bank_queue.take()? {
            let bank = match bank {
                Ok(bank) => bank,
                Err(error) => {
                    errors.report(error);
                    continue;
                }
            };
            let id = bank.id();
            if bank.demonstrations().is_empty() {
                banks.remove(&id);
                continue;
            }
            let message = ExternalBuilt { bank: id, ..Zeroable::zeroed() };
            let reason = why_not(mode, &bank);
            let failure = match reason {
                Some(why) => notes.publish_of_any_length(u32::MAX, 0, why.as_bytes())?,
                None => 0,
            };
            match mode {
                "builds-nothing" => {}
                "builds-another" => {
                    built.send(&ExternalBuilt { bank: id + 1, ..message })?;
                }
                _ => built.send(&ExternalBuilt { failure, ..message })?,
            }
            host.notify()?;
            let steps = bank.demonstrations().iter().map(|demonstration| demonstration.steps);
            banks.insert(id, steps.collect());
            if mode == "keeps-banks" {
                kept.push(bank);
            }
        }
        announced.extend(begun);
        let last_step = queries.last().map_or(0, |query| query.step);
        for query in queries {
            let ExternalQuery { lane, episode, step, .. } = query;
            // Only now, because the last query of the lane's earlier episode may have arrived together with the announcement.
            let is_first = |next: &ExternalEpisode| (next.lane, next.episode) == (lane, episode);
            if let Some(at) = announced.iter().position(is_first) {
                let message = announced[at];
                // Those of the lane that came before are over.
                let later = announced.split_off(at + 1);
                announced.retain(|next| next.lane != lane);
                announced.extend(later);
                let ExternalEpisode { lane, episode, bank, image_budget, text_budget, .. } =
                    message;
                let is_busy = episodes.get(&lane).is_some_and(|earlier| !earlier.is_over);
                if mode == "keeps-old-episodes" && is_busy {
                    continue;
                }
                let instruction = read_text(&message.instruction, message.instruction_len);
                let is_victim = instruction.as_ref().is_ok_and(|text| *text == victim);
                let is_ascii = instruction.as_ref().is_ok_and(|text| text.is_ascii());
                if mode == "ascii" && !is_ascii {
                    fail("I read ASCII only");
                }
                let is_valid = banks.contains_key(&bank)
                    && (message.instruction_len as usize) <= MAX_INSTRUCTION;
                let budgets = (image_budget, text_budget);
                let learns = message.learning == Learning::Learns as u32
                    || mode == "learns-from-evaluations";
                let begun = Episode {
                    id: episode,
                    budgets,
                    is_over: false,
                    is_valid,
                    is_victim,
                    bank,
                    learns,
                };
                episodes.insert(lane, begun);
            }
            // A lane whose next episode is announced awaits no answer.
            let is_over = announced.iter().any(|next| next.lane == lane);
            let known = episodes.get_mut(&lane);
            let late = Episode {
                id: episode,
                budgets: (0, 0),
                is_over: false,
                is_valid: true,
                is_victim: false,
                bank: 0,
                learns: false,
            };
            let (running, is_known) = match known {
                Some(running) if running.id == episode => {
                    running.is_over = query.last == 1;
                    if running.is_over && running.learns {
                        *learned.entry(running.bank).or_default() += 1;
                    }
                    (*running, true)
                }
                _ => (late, false),
            };
            if !is_known && !matches!(mode, "answers-late" | "keeps-old-episodes") {
                errors.report(format_args!("query of unknown episode {episode} in lane {lane}"));
                continue;
            }
            if !is_known && mode == "keeps-old-episodes"
                || is_over && mode != "answers-late"
                || query.last == 1 && mode != "answers-the-end"
            {
                continue;
            }
            let frame = frames.get(query.frame).ok().flatten();
            let is_usable = frame.is_some()
                && running.is_valid
                && world.read_state(&query.state).is_ok()
                && world.read_feedback(query.feedback).is_ok();
            answered += 1;
            let received_ns = monotonic_ns();
            let mut usual = ExternalAnswer {
                episode,
                lane,
                step,
                received_ns,
                tokens: NOT_MEASURED,
                ..Zeroable::zeroed()
            };
            let (images, text) = running.budgets;
            let mut note = TEXT.as_bytes().to_vec();
            if !is_usable && is_known && query.last == 0 && mode != "believes" {
                note = UNUSABLE.as_bytes().to_vec();
                usual.failed = 1;
            } else if mode == "fails" {
                usual.failed = 1;
            } else if running.is_victim && step == FAULTY_STEP && mode.starts_with("huge-") {
                note = vec![b'x'; HUGE];
                let bytes = HUGE as u32;
                usual.failed = u32::from(mode == "huge-reason");
                usual.items[0] =
                    AnswerItem { kind: ItemKind::Text as u8, bytes, ..Zeroable::zeroed() };
                usual.items_len = u32::from(mode == "huge-text");
            } else if running.is_victim && step == FAULTY_STEP && mode == "leaves" {
                drop((bank_queue, episode_queue, query_queue, stops, frames, notes, built));
                drop((stores, stored, answers, errors, orchestrator, host, bus));
                loop {
                    thread::sleep(Duration::from_secs(1));
                }
            } else {
                let nothing = AnswerItem { distance: f32::NAN, ..Zeroable::zeroed() };
                let bytes = note.len() as u32;
                let steps =
                    AnswerItem { kind: ItemKind::Steps as u8, steps: 1, views: 1, ..nothing };
                let text_item = AnswerItem { kind: ItemKind::Text as u8, bytes, ..nothing };
                let mut items = Vec::new();
                if images > 0 || mode == "ignores-budgets" {
                    items.push(steps);
                }
                if text >= bytes {
                    items.push(text_item);
                }
                if let (Some(&count), Some(first)) = (learned.get(&running.bank), items.first_mut())
                {
                    first.distance = count as f32;
                }
                match mode {
                    "garbage" => items.push(AnswerItem { kind: 77, ..nothing }),
                    "unknown-demonstration" => {
                        items.push(AnswerItem { demonstration: 77, ..steps })
                    }
                    "past-the-end" => items.push(AnswerItem { steps: 1000, ..steps }),
                    "past-the-note" => items.push(AnswerItem { bytes: bytes + 1, ..text_item }),
                    "not-utf-8" => items.push(AnswerItem { bytes: 4, ..text_item }),
                    "not-a-distance" => {
                        items.push(AnswerItem { distance: f32::INFINITY, ..steps });
                    }
                    "one-bank" if images > 0 => {
                        items.push(AnswerItem { demonstration: 1, first_step: 3, ..steps });
                    }
                    "draws" if images > 0 => {
                        items.push(AnswerItem { distance: answered as f32, ..steps });
                    }
                    _ => {}
                }
                usual.items[..items.len()].copy_from_slice(&items);
                usual.items_len = items.len() as u32 + if mode == "nine-items" { 9 } else { 0 };
            }
            let note_lane = if mode == "wrong-note" { lane + 1 } else { lane };
            if lane < lanes {
                usual.note = notes.publish_of_any_length(note_lane, episode, &note)?;
            }
            usual.sent_ns = if mode == "no-times" { 0 } else { monotonic_ns() };
            let sent = match mode {
                "silent" => vec![],
                "wrong-lane" => vec![ExternalAnswer { lane: lane + 1, ..usual }],
                "no-such-lane" => vec![ExternalAnswer { lane: 4242, ..usual }],
                "wrong-step" => vec![ExternalAnswer { step: step + 1, ..usual }],
                "mixes-lanes" => vec![ExternalAnswer { step: last_step, ..usual }],
                "twice" => vec![usual; 2],
                "flood" => vec![usual; 5000],
                "crash" if answered == 30 => {
                    eprintln!("I am no good at this");
                    std::process::abort();
                }
                _ => vec![usual],
            };
            // A flood fills the queue.
            sent.iter().for_each(|answer| drop(answers.send(answer)));
            host.notify()?;
        }
        for message in to_store {
            let ExternalStore { bank, loads, folder_len, .. } = message;
            let file = Path::new(read_text(&message.folder, folder_len)?).join("learned");
            let known = learned.get(&bank).copied().unwrap_or(0);
            let text = match mode {
                "saves-the-time" => format!("{known} {}", monotonic_ns()),
                _ => known.to_string(),
            };
            match (mode, loads) {
                ("saves-nothing", 0) => continue,
                ("loads-nothing", 1) => {}
                (_, 0) => fs::write(file, text)?,
                _ => {
                    let text = fs::read_to_string(file)?;
                    let count = text.split(' ').next().unwrap_or_default().parse()?;
                    learned.insert(bank, count);
                }
            }
            stored.send(&ExternalStored { bank, ..Zeroable::zeroed() })?;
            host.notify()?;
        }
        if mode != "keeps-frames" {
            let _ = frames.apply_evictions();
        }
        if stops.next()?.is_some() && mode != "ignores-stop" {
            if mode != "no-shutdown-report" {
                let shutdown_report = ShutdownReport {
                    role: Role::ExternalMemory as u32,
                    index: index.into(),
                    ..Zeroable::zeroed()
                };
                bus.sender()?.send(&shutdown_report)?;
                orchestrator.notify()?;
            }
            return Ok(());
        }
        if watch.has_ended() && mode != "outlives" {
            return Ok(());
        }
        bus.listener().wait(Duration::from_millis(200))?;
    }
}

/// Why a memory with this fault cannot be built from a bank.
fn why_not(mode: &str, bank: &Bank) -> Option<String> {
    let demonstrations = bank.demonstrations();
    let first = bank.instruction(&demonstrations[0]);
    let is_mixed =
        demonstrations.iter().any(|demonstration| bank.instruction(demonstration) != first);
    let why = match mode {
        "cannot-build" => "I have no idea",
        "small" if demonstrations.len() > 100 => "too many demonstrations",
        "one-task" if is_mixed && demonstrations.len() < 100 => "demonstrations of two tasks",
        "huge-build" => return Some("x".repeat(HUGE)),
        _ => return None,
    };
    Some(why.to_owned())
}
