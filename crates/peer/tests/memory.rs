//! An external memory against a scripted host: orchestrator, simulator and memory process in this process.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::fs;
use std::path::Path;
use std::sync::mpsc;

use bytemuck::Zeroable;
use domain::{Action, Feedback, Heading, Pose, State};
use peer::memory::{
    Demonstration, Episode, EpisodeEnd, Memory, MemoryDescription, MemoryError, MemoryItem, Method,
    Query, Scope, Source, Step, Views, serve,
};
use rigs::process::{ExternalMemoryRig, LONG};
use shm_types::banks::{BankDemonstration, BankStep};
use shm_types::description::memory_folder;
use shm_types::message::{
    ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery, ExternalStore, ExternalStored,
    FrameId, Handshake, ItemKind, Learning, NO_ACTION, NO_FRAME, NOT_MEASURED, Role, write_text,
};
use shm_types::notes::NoteHeader;
use shm_types::{Attach, BankContent, Note};

/// The index of the external memory.
const INDEX: u8 = 3;

/// A memory that serves in a thread, among its neighbours.
struct Rig {
    rig: ExternalMemoryRig,
    handshake: Handshake,
    told: mpsc::Receiver<String>,
}

/// A note that is not too long.
struct ReceivedNote {
    header: NoteHeader,
    bytes: Vec<u8>,
}

impl Rig {
    fn new() -> Self {
        let (say, told) = mpsc::channel();
        let description = MemoryDescription {
            name: "recorder".to_owned(),
            version: "7".to_owned(),
            scope: Scope::Case,
            embeddings: true,
            frames: true,
            ..MemoryDescription::default()
        };
        let change = |attach: &mut Attach| {
            attach.external_memories = vec![INDEX];
            (attach.frame_capacity, attach.window) = (32, 2);
        };
        let mut rig = ExternalMemoryRig::in_thread(change, move |run| {
            let folder = memory_folder(run, INDEX);
            fs::create_dir(&folder)?;
            let create = || Recorder { say: say.clone(), steps: 0 };
            Ok(serve(&Method::new(description, create), &folder)?)
        });
        let handshake = rig.handshake();
        Self { rig, handshake, told }
    }

    fn publish(&mut self, grey: u8) -> FrameId {
        self.rig.publish(grey)
    }

    fn publish_bank(&mut self, id: u64, content: &BankContent) -> ExternalBuilt {
        self.rig.neighbours.banks.publish(id, content).unwrap();
        self.rig.notify();
        self.rig.until(|neighbours| neighbours.built.next().unwrap())
    }

    fn begin(&self, lane: u32, episode: u64, bank: u64) {
        self.begin_as(Learning::OutsideOfStreams, lane, episode, bank);
    }

    fn begin_as(&self, learning: Learning, lane: u32, episode: u64, bank: u64) {
        let learning = learning as u32;
        let mut message = ExternalEpisode { lane, episode, bank, learning, ..Zeroable::zeroed() };
        (message.seed, message.repeat) = (5, 1);
        (message.image_budget, message.text_budget) = (9, 99);
        message.instruction_len = write_text(&mut message.instruction, "Find a cone.");
        self.rig.neighbours.episodes.send(&message).unwrap();
    }

    fn ask(&self, query: &ExternalQuery) {
        self.rig.neighbours.queries.send(query).unwrap();
        self.rig.notify();
    }

    fn send_store(&self, bank: u64, loads: bool, folder: &Path) {
        let mut message = ExternalStore { bank, loads: loads.into(), ..Zeroable::zeroed() };
        message.folder_len = write_text(&mut message.folder, folder.to_str().unwrap());
        self.rig.neighbours.stores.send(&message).unwrap();
        self.rig.notify();
    }

    fn stored(&mut self) -> ExternalStored {
        self.rig.until(|neighbours| neighbours.stored.next().unwrap())
    }

    fn answer(&mut self) -> ExternalAnswer {
        self.rig.until(|neighbours| neighbours.answers.next().unwrap())
    }

    fn note(&mut self) -> ReceivedNote {
        let Note { header, bytes } =
            self.rig.until(|neighbours| neighbours.notes.drain().unwrap().pop());
        ReceivedNote { header, bytes: bytes.unwrap() }
    }

    fn error_report(&mut self) -> String {
        let (report, text) = self.rig.error_report();
        assert_eq!((report.role, report.index), (Role::ExternalMemory as u32, u32::from(INDEX)));
        text
    }

    fn told(&self) -> String {
        self.told.recv_timeout(LONG).unwrap()
    }

    fn stop(self) {
        assert_eq!(self.rig.stop().index, u32::from(INDEX));
    }
}

/// Tells the test what it is given. It fails where an instruction or a step says so.
struct Recorder {
    say: mpsc::Sender<String>,
    steps: u64,
}

impl Recorder {
    fn say(&self, what: String) {
        self.say.send(what).unwrap();
    }
}

impl Memory for Recorder {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        for of in demonstrations {
            if of.instruction == "Fail." {
                return Err(MemoryError::new("as it was told"));
            }
            let greys: Vec<u8> =
                (0..of.steps.len()).filter_map(|at| of.frame(at)).map(|f| f.pixels[0]).collect();
            let rows: Vec<_> = (0..of.steps.len()).filter_map(|at| of.embedding(at)).collect();
            let actions: Vec<_> = of.steps.iter().map(|step| step.action).collect();
            assert!(of.stages.is_empty() && of.bank.is_some() && of.dimension() == 2);
            self.say(format!(
                "{} at {} sees {greys:?} as {rows:?} does {actions:?}",
                of.instruction, of.steps[0].state
            ));
        }
        Ok(())
    }

    fn begin_episode(&mut self, episode: &Episode<'_>) -> Result<(), MemoryError> {
        let Episode { lane, episode, instruction, seed, repeat, image_budget, text_budget, learns } =
            episode;
        let learns = if *learns { " learns" } else { "" };
        self.say(format!(
            "episode {episode} in {lane}: {instruction} seed {seed} repeat {repeat} budgets {image_budget} \
             {text_budget}{learns}"
        ));
        Ok(())
    }

    fn observe(&mut self, step: &Step<'_>) -> Result<(), MemoryError> {
        self.steps += 1;
        if step.frame.is_none() {
            self.say(format!("{} ended at step {}", step.episode, step.step));
        }
        Ok(())
    }

    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let window: Vec<_> = query
            .window
            .iter()
            .map(|past| (past.frame.pixels()[0], past.action, past.feedback))
            .collect();
        let Step { step, frame, embedding, state, .. } = query.now;
        let grey = frame.unwrap().pixels[0];
        self.say(format!("step {step} at {state} sees {grey} as {embedding:?} after {window:?}"));
        assert_eq!(query.instruction, "Find a cone.");
        let source = Source { demonstration: 0, first: 1, count: 2 };
        match step {
            0 => Ok(vec![
                MemoryItem::Text { text: "left".into(), sources: vec![source] },
                MemoryItem::Steps { source, views: Views::All, actions: true, distance: Some(0.5) },
                MemoryItem::Steps {
                    source,
                    views: Views::Keyframes(vec![2]),
                    actions: false,
                    distance: None,
                },
                MemoryItem::Frame {
                    demonstration: 0,
                    step: 2,
                    caption: "bärrel".into(),
                    distance: None,
                },
            ]),
            1 => Ok(vec![MemoryItem::text("x"); 9]),
            _ => Err(MemoryError::new("it is tired")),
        }
    }

    fn end_episode(&mut self, end: &EpisodeEnd<'_>) -> Result<(), MemoryError> {
        let EpisodeEnd { lane, episode, demonstration, success, sub_goals } = *end;
        if let Some(number) = demonstration {
            self.say(format!("learned from {episode} as {number}: {success:?} {sub_goals:?}"));
        } else {
            assert_eq!(*end, EpisodeEnd::unlearned(lane, episode));
            self.say(format!("end of {episode}"));
        }
        Ok(())
    }

    fn save(&mut self, folder: &Path) -> Result<(), MemoryError> {
        fs::write(folder.join("steps"), self.steps.to_string()).map_err(MemoryError::new)
    }

    fn load(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let read = fs::read_to_string(folder.join("steps")).map_err(MemoryError::new)?;
        self.steps = read.parse().map_err(MemoryError::new)?;
        Ok(())
    }

    fn store_bytes(&self) -> Option<u64> {
        Some(1000 + self.steps)
    }

    fn tokens(&self) -> Option<u32> {
        Some(17)
    }
}

/// A bank of one demonstration of three steps, whose views are `frames`.
fn bank(frames: [FrameId; 3], instruction: &str) -> BankContent {
    let step = |(at, frame): (u8, FrameId)| BankStep {
        frame,
        content_hash: [at; 16],
        state: State::from(Pose::new(1, at, Heading::N)).padded(),
        action: if at == 2 { NO_ACTION } else { Action::Forward as u8 },
        feedback: Feedback::Moved as u8,
        reserved: [0; 6],
    };
    let demonstration = BankDemonstration {
        first_step: 0,
        steps: 3,
        first_byte: 0,
        bytes: instruction.len() as u32,
    };
    BankContent {
        demonstrations: vec![demonstration],
        steps: (0..).zip(frames).map(step).collect(),
        embeddings: vec![1.0, 0.0, 0.0, 1.0, 0.6, 0.8],
        text: instruction.to_owned(),
    }
}

fn query(lane: u32, episode: u64, step: u32, frame: FrameId) -> ExternalQuery {
    let mut query = ExternalQuery {
        lane,
        episode,
        step,
        frame,
        state: State::from(Pose::new(2, 3, Heading::E)).padded(),
        action: if step == 0 { NO_ACTION } else { Action::TurnLeft as u8 },
        feedback: Feedback::Turned as u8,
        embedding_len: 2,
        ..Zeroable::zeroed()
    };
    query.embedding[..2].copy_from_slice(&[0.6, 0.8]);
    query
}

#[test]
fn a_memory_is_built_asked_and_ended() {
    let mut rig = Rig::new();
    let facts = rig.handshake.facts().unwrap();
    assert_eq!(rig.handshake.index, u32::from(INDEX));
    assert_eq!((facts["memory"].as_str(), facts["version"].as_str()), ("recorder", "7"));
    let folder = memory_folder(&rig.rig.neighbours.attach().root, INDEX);
    assert!(MemoryDescription::read(&folder).unwrap().sdk.starts_with("peer "));

    let frames = [10, 20, 30].map(|grey| rig.publish(grey));
    let built = rig.publish_bank(5, &bank(frames, "Find a barrel."));
    assert_eq!((built.bank, built.failure, built.store_bytes), (5, 0, 1000));
    assert_eq!(
        rig.told(),
        "Find a barrel. at 1,0,0 sees [10, 20, 30] as [[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]] does \
         [Some(ActionCode(0)), Some(ActionCode(0)), None]"
    );

    rig.begin(2, 41, 5);
    let now = rig.publish(40);
    rig.ask(&query(2, 41, 0, now));
    assert_eq!(rig.told(), "episode 41 in 2: Find a cone. seed 5 repeat 1 budgets 9 99");
    assert_eq!(rig.told(), "step 0 at 2,3,1 sees 40 as Some([0.6, 0.8]) after []");
    let answer = rig.answer();
    assert_eq!((answer.lane, answer.episode, answer.step, answer.failed), (2, 41, 0, 0));
    assert_eq!((answer.items_len, answer.sources_len, answer.tokens), (4, 1, 17));
    assert_eq!(answer.store_bytes, 1001);
    assert!(answer.received_ns > 0 && answer.received_ns <= answer.sent_ns);
    let kinds = answer.items[..4].iter().map(|item| item.kind).collect::<Vec<_>>();
    let [text, steps, frame] = [ItemKind::Text, ItemKind::Steps, ItemKind::Frame].map(|k| k as u8);
    assert_eq!(kinds, [text, steps, steps, frame]);
    let note = rig.note();
    assert_eq!((note.header.id, note.header.lane, note.header.episode), (answer.note, 2, 41));
    assert_eq!(note.bytes, "left\u{2}\0\0\0bärrel".as_bytes());
    let places = answer.items.map(|item| (item.first_byte, item.bytes, item.views, item.actions));
    assert_eq!(places[..4], [(0, 4, 0, 0), (0, 0, 1, 1), (4, 4, 2, 0), (8, 7, 0, 0)]);
    assert!(answer.items[1].distance == 0.5 && answer.items[2].distance.is_nan());

    // Nine items do not fit, and the episode cannot go on after that.
    let later = rig.publish(50);
    rig.ask(&query(2, 41, 1, later));
    assert_eq!(
        rig.told(),
        "step 1 at 2,3,1 sees 50 as Some([0.6, 0.8]) after [(40, Some(ActionCode(4)), FeedbackCode(2))]"
    );
    for step in 1..3 {
        let answer = rig.answer();
        assert_eq!((answer.step, answer.failed, answer.items_len), (step, 1, 0));
        assert_eq!(rig.note().bytes, b"9 items, and at most 8 fit");
        if step == 1 {
            rig.ask(&query(2, 41, 2, later));
        }
    }

    // Another episode in the lane.
    rig.begin(2, 42, 5);
    rig.ask(&query(2, 42, 0, now));
    assert_eq!(rig.told(), "end of 41");
    rig.told();
    rig.told();
    assert_eq!(rig.answer().episode, 42);

    // The end of an episode and the beginning of the lane's next one can arrive together.
    rig.rig
        .neighbours
        .queries
        .send(&ExternalQuery { last: 1, ..query(2, 42, 1, NO_FRAME) })
        .unwrap();
    rig.begin(2, 43, 5);
    rig.ask(&query(2, 43, 0, now));
    for told in ["42 ended at step 1", "end of 42", "episode 43 in 2", "step 0"] {
        let heard = rig.told();
        assert!(heard.starts_with(told), "{heard}");
    }
    assert_eq!(rig.answer().episode, 43);
    assert!(rig.rig.neighbours.error_reports.next().unwrap().is_none());
    rig.rig.neighbours.evict(now).unwrap();
    rig.stop();
}

#[test]
fn what_cannot_be_built_or_is_not_known_is_answered_with_the_reason() {
    let mut rig = Rig::new();
    let frames = [10, 20, 30].map(|grey| rig.publish(grey));
    let built = rig.publish_bank(5, &bank(frames, "Fail."));
    let note = rig.note();
    assert_eq!(
        (built.failure, note.bytes.as_slice()),
        (note.header.id, "as it was told".as_bytes())
    );

    for (lane, bank, why) in
        [(0, 5, "the memory could not be built"), (1, 77, "bank 77 was not received")]
    {
        rig.begin(lane, 50 + u64::from(lane), bank);
        rig.ask(&query(lane, 50 + u64::from(lane), 0, frames[0]));
        assert_eq!(rig.answer().failed, 1);
        assert_eq!(rig.note().bytes, why.as_bytes());
    }

    // A view that is not there is no failure of the memory: it is reported, and nothing answers.
    let missing = frames[2] + 9;
    rig.rig.neighbours.banks.publish(6, &bank([missing; 3], "Find a barrel.")).unwrap();
    rig.rig.notify();
    assert_eq!(rig.error_report(), format!("bank 6: frame {missing} is not in the store"));
    rig.publish_bank(7, &bank(frames, "Find a barrel."));
    rig.begin(0, 60, 7);
    rig.ask(&query(0, 60, 0, missing));
    assert_eq!(rig.error_report(), format!("lane 0, step 0: frame {missing} is not in the store"));

    // A query of no episode is reported; nothing answers it.
    rig.ask(&query(3, 99, 0, frames[0]));
    assert_eq!(rig.error_report(), "query of unknown episode 99 in lane 3");
    rig.begin(900, 61, 7);
    rig.ask(&query(900, 61, 0, frames[0]));
    assert_eq!(rig.error_report(), "episode 61 in lane 900: invalid values");
    assert_eq!(rig.error_report(), "query of unknown episode 61 in lane 900");
    assert!(rig.rig.neighbours.answers.next().unwrap().is_none());

    // A bank that is taken back is known no longer.
    rig.rig.neighbours.banks.take_back(7).unwrap();
    rig.begin(1, 62, 7);
    rig.ask(&query(1, 62, 0, frames[0]));
    assert_eq!(rig.answer().failed, 1);
    assert_eq!(rig.note().bytes, b"bank 7 was not received");
    rig.stop();
}

#[test]
fn a_memory_learns_from_an_episode_and_is_saved_and_loaded() {
    let mut rig = Rig::new();
    let frames = [10, 20, 30].map(|grey| rig.publish(grey));
    rig.publish_bank(5, &bank(frames, "Find a barrel."));
    rig.told();

    // It is saved after the last step of the episode, although both arrive together.
    rig.begin_as(Learning::Learns, 0, 41, 5);
    rig.ask(&query(0, 41, 0, frames[0]));
    assert!(rig.told().ends_with(" learns"));
    rig.told();
    rig.answer();
    let mut last = ExternalQuery { last: 1, ..query(0, 41, 1, NO_FRAME) };
    (last.outcome, last.demonstration, last.sub_goals_len) = (2, 1, 2);
    last.sub_goals[..2].copy_from_slice(&[0, 1]);
    rig.rig.neighbours.queries.send(&last).unwrap();
    let folder = tempfile::tempdir().unwrap();
    rig.send_store(5, false, folder.path());
    assert_eq!(rig.told(), "41 ended at step 1");
    assert_eq!(rig.told(), "learned from 41 as 1: Some(true) Some([0, 1])");
    let stored = rig.stored();
    assert_eq!((stored.bank, stored.failure, stored.store_bytes), (5, 0, 1002));
    assert_eq!(fs::read_to_string(folder.path().join("steps")).unwrap(), "2");

    // An evaluation: it observes nothing.
    rig.begin_as(Learning::ReadsOnly, 1, 42, 5);
    rig.ask(&query(1, 42, 0, frames[0]));
    assert_eq!(rig.answer().store_bytes, 1002);
    rig.ask(&ExternalQuery { last: 1, ..query(1, 42, 1, NO_FRAME) });
    for told in ["episode 42", "step 0", "end of 42"] {
        let heard = rig.told();
        assert!(heard.starts_with(told), "{heard}");
    }

    // Another one of the same bank loads it. Nothing is told of how its next episode ended.
    rig.publish_bank(6, &bank(frames, "Find a barrel."));
    rig.told();
    rig.send_store(6, true, folder.path());
    assert_eq!(rig.stored().store_bytes, 1002);
    rig.begin_as(Learning::Learns, 0, 43, 6);
    let mut last = ExternalQuery { last: 1, ..query(0, 43, 0, NO_FRAME) };
    (last.demonstration, last.sub_goals_len) = (2, NOT_MEASURED);
    rig.ask(&last);
    assert!(rig.told().ends_with(" learns"));
    assert_eq!(rig.told(), "43 ended at step 0");
    assert_eq!(rig.told(), "learned from 43 as 2: None None");

    // What cannot be loaded, and a bank that is not there.
    rig.send_store(6, true, &folder.path().join("missing"));
    let (stored, note) = (rig.stored(), rig.note());
    assert_eq!((stored.failure, note.header.lane), (note.header.id, u32::MAX));
    rig.send_store(77, false, folder.path());
    assert_eq!(
        (rig.stored().bank, rig.note().bytes),
        (77, b"there is no memory of the bank".to_vec())
    );
    rig.stop();
}

#[test]
fn an_end_with_an_unknown_code_is_an_error_of_that_episode() {
    let mut rig = Rig::new();
    let frames = [10, 20, 30].map(|grey| rig.publish(grey));
    rig.publish_bank(5, &bank(frames, "Find a barrel."));
    rig.told();
    let folder = tempfile::tempdir().unwrap();
    let last = ExternalQuery { last: 1, sub_goals_len: NOT_MEASURED, ..query(0, 0, 0, NO_FRAME) };
    let unknown_outcome =
        "3 is not an outcome of an episode (0 not told, 1 not completed, 2 completed)";
    for (episode, end, reason) in [
        (41, ExternalQuery { outcome: 3, ..last }, unknown_outcome),
        (42, ExternalQuery { sub_goals_len: 25, ..last }, "25 sub-goals are too many"),
        (43, ExternalQuery { action: 9, ..last }, "9 is not an action of this world"),
    ] {
        rig.begin_as(Learning::Learns, 0, episode, 5);
        rig.ask(&ExternalQuery { episode, ..end });
        rig.send_store(5, false, folder.path());
        let (stored, note) = (rig.stored(), rig.note());
        assert_eq!((stored.bank, stored.failure), (5, note.header.id));
        assert_eq!(String::from_utf8_lossy(&note.bytes), reason);
        let mut told = rig.told.try_iter();
        assert!(!told.any(|told| told.starts_with("learned from")), "of episode {episode}");
    }

    // The memory goes on with the next episode.
    rig.begin_as(Learning::Learns, 0, 44, 5);
    rig.ask(&ExternalQuery { episode: 44, outcome: 1, ..last });
    for told in ["episode 44", "44 ended at step 0", "learned from 44 as 0: Some(false) None"] {
        let heard = rig.told();
        assert!(heard.starts_with(told), "{heard}");
    }
    rig.stop();
}

#[test]
fn a_query_with_an_unknown_code_fails_its_episode() {
    let mut rig = Rig::new();
    let frames = [10, 20, 30].map(|grey| rig.publish(grey));
    rig.publish_bank(5, &bank(frames, "Find a barrel."));
    let now = query(0, 0, 0, frames[0]);
    for (episode, asked, reason) in [
        (41, ExternalQuery { action: 9, ..now }, "9 is not an action of this world"),
        (42, ExternalQuery { last: 2, ..now }, "2 is not a flag (0 no, 1 yes)"),
        (
            43,
            ExternalQuery { embedding_len: 1025, ..now },
            "an embedding of 1025 numbers is too long",
        ),
    ] {
        rig.begin(0, episode, 5);
        rig.ask(&ExternalQuery { episode, ..asked });
        assert_eq!(rig.answer().failed, 1);
        assert_eq!(String::from_utf8_lossy(&rig.note().bytes), reason);
    }
    let mut message = ExternalStore { bank: 5, loads: 2, ..Zeroable::zeroed() };
    message.folder_len = write_text(&mut message.folder, "/nowhere");
    rig.rig.neighbours.stores.send(&message).unwrap();
    rig.rig.notify();
    assert!(rig.stored().failure > 0);
    assert_eq!(rig.note().bytes, b"2 is not a flag (0 no, 1 yes)");
    rig.stop();
}

#[test]
fn a_folder_that_is_not_a_memory_s_is_refused() {
    let description = MemoryDescription { name: "x".to_owned(), ..MemoryDescription::default() };
    let never = || -> Recorder { unreachable!() };
    let method = Method::new(description, never);
    let error = serve(&method, "/nowhere".as_ref()).unwrap_err().to_string();
    assert_eq!(error, "/nowhere is not the folder of a run, or that run is over");
    let base = tempfile::tempdir().unwrap();
    let error = serve(&method, base.path()).unwrap_err().to_string();
    assert!(error.contains("is not the folder of an external memory of a run"), "{error}");
    let folder = memory_folder(base.path(), 1);
    std::fs::create_dir(&folder).unwrap();
    let error = serve(&method, &folder).unwrap_err().to_string();
    assert!(error.ends_with("is not the folder of a run, or that run is over"), "{error}");
}
