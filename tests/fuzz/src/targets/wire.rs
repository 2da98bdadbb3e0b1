//! Messages from other processes.

use std::sync::{Arc, OnceLock};

use bytemuck::Zeroable;
use case_book::{BookFile, BookRequest, EpisodeFacts};
use conditions::key::EpisodeKey;
use conditions::{Condition, Demonstrations, Mismatch, Route, Start, Variation};
use conformance::messages;
use domain::{
    Action, Arm, DocumentKind, Feedback, Heading, MAX_STATE, Pose, Representation, State,
};
use memory_proc::bank::MemoryBank;
use memory_proc::demonstrations::{RememberedDemonstration, ViewId};
use memory_proc::items::{Assembler, Budgets, CheckedAnswer, DocumentSupplier, PublishedTexts};
use orchestrator::books::Books;
use orchestrator::lanes::{AnswerError, Lanes, Rules, Turn};
use orchestrator::plan::PlannedEpisode;
use peer::policy::fuzzing::{Incoming, requests};
use rigs::scripted::{ScriptedSim, ScriptedStep};
use shm_types::banks::BankHeader;
use shm_types::documents::{Content, Document};
use shm_types::fuzzing::{check_bank, document, document_bytes};
use shm_types::message::{
    DocumentId, ExternalAnswer, Handshake, MAX_EXTERNAL_MEMORIES, MAX_ITEMS, MAX_SOURCES,
    MAX_STEPS, Observation, RequestId, Role, StepReport, read_text, write_text,
};
use shm_types::notes::{Note, NoteHeader};
use warehouse::CaseSet;
use warehouse::case_book::write_books;

use crate::input::Input;

fn cases() -> &'static CaseSet {
    static CASES: OnceLock<CaseSet> = OnceLock::new();
    CASES.get_or_init(CaseSet::shipped)
}

/// The case book, on blocked routes too.
fn books() -> &'static Books {
    static BOOKS: OnceLock<Books> = OnceLock::new();
    BOOKS.get_or_init(|| {
        let cases = cases().cases.iter().map(|case| case.id.clone()).collect();
        let demonstrations = vec![Demonstrations::ORIGINAL];
        let request =
            BookRequest { cases, demonstrations, blocked: true, ..BookRequest::default() };
        let books = write_books(&request).unwrap();
        Books {
            cases: BookFile::new(books.cases).unwrap(),
            demonstrations: BookFile::new(books.demonstrations).unwrap(),
            streams: None,
            elsewhere: None,
        }
    })
}

const RULES: Rules = Rules {
    horizon: 6,
    hits: 1,
    keyframes: 40,
    memory_images: 40,
    memory_text_bytes: 65_536,
    max_steps: 12,
    expert: false,
    external_memories: [None; MAX_EXTERNAL_MEMORIES],
};

fn planned(choice: u8) -> PlannedEpisode {
    let memory = [Representation::Working, Representation::Episodic, Representation::Hybrid]
        [choice as usize % 3];
    let demonstrations = match memory {
        Representation::Working => Demonstrations::NONE,
        _ => Demonstrations::ORIGINAL,
    };
    let start = if choice & 32 == 0 { Start::Original } else { Start::New };
    // A passage is closed for new starts only.
    let is_blocked = start == Start::New && choice & 64 != 0;
    let route = if is_blocked { Route::Blocked } else { Route::Unchanged };
    let condition = Condition {
        memory: memory.into(),
        start,
        route,
        demonstrations,
        variation: Variation::STANDARD,
        mismatch: Mismatch::None,
        arm: Arm::Frozen,
    };
    let case_index = usize::from(choice / 3) % cases().cases.len();
    let case = cases().cases[case_index].id.clone();
    PlannedEpisode {
        key: EpisodeKey { condition, run: 1, place: None, case },
        case_index,
        seed: 7,
        part: None,
    }
}

/// What an observation asks for.
fn request(&Observation { lane, episode, step, .. }: &Observation) -> RequestId {
    RequestId { lane, episode, step }
}

/// The id of every note.
const NOTE: DocumentId = 1;

/// The note with the facts of an episode.
fn note(facts: &EpisodeFacts) -> Note {
    let header = NoteHeader { id: NOTE, ..NoteHeader::zeroed() };
    Note { header, bytes: Ok(serde_json::to_vec(facts).unwrap()) }
}

/// The orchestrator's lanes between honest answers and changed ones. A finished episode has a record without
/// contradictions, whatever was answered.
pub(crate) fn orchestrator(input: &[u8]) {
    const LANES: usize = 2;
    let mut input = Input(input);
    let mut lanes = Lanes::new(books(), RULES, LANES);
    let mut sim = ScriptedSim::default();
    let mut steps: [Option<ScriptedStep>; LANES] = [const { None }; LANES];
    let mut seen: [Option<Observation>; LANES] = [None; LANES];
    let mut now = 1;
    while !input.is_empty() {
        let (choice, what) = (input.byte(), input.byte());
        let lane = usize::from(choice) % LANES;
        now = u64::saturating_add(now, u64::from(what) << (choice % 48));
        lanes.set_time(now);
        let answer =
            steps[lane].get_or_insert_with(|| sim.begin(&lanes.begin(lane, planned(what)).world));
        let turn = match (what % 4, seen[lane]) {
            (0, _) => {
                let ScriptedStep { report, observation, facts } = answer.clone();
                seen[lane] = Some(observation);
                let notes: Vec<Note> = facts.iter().map(note).collect();
                lanes.reported(&input.changed(StepReport { facts: NOTE, ..report }), &notes)
            }
            (1, Some(seen)) => {
                lanes.recalled(&input.changed(messages::recall_trace(request(&seen))))
            }
            (2, Some(seen)) => {
                let action = Action::ALL[usize::from(choice) % Action::ALL.len()];
                lanes.decided(&input.changed(messages::decision(request(&seen), action)))
            }
            (3, Some(seen)) => {
                let RequestId { lane, episode, .. } = request(&seen);
                let report =
                    shm_types::message::SnapshotReport { lane, episode, ..Zeroable::zeroed() };
                lanes.learned(&input.changed(report))
            }
            _ => Ok(Turn::Wait),
        };
        match turn {
            Ok(Turn::Wait) => {}
            Ok(Turn::Command(command)) => {
                steps[command.lane as usize] = Some(sim.step(&command));
            }
            Ok(Turn::Finished(finished)) => {
                finished.record.check(RULES.max_steps).unwrap();
                let lane = finished.lane as usize;
                (steps[lane], seen[lane]) = (None, None);
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                if !matches!(error, AnswerError::NoSuchLane { .. }) {
                    lanes.give_up(lane as u32);
                    (steps[lane], seen[lane]) = (None, None);
                }
            }
        }
        lanes.take_answered();
        lanes.take_stepped();
        lanes.pending(now);
    }
    lanes.give_up_all();
    assert_eq!(lanes.busy(), 0);
}

/// Documents that are counted and forgotten.
#[derive(Default)]
struct Published {
    contents: Vec<Content>,
}

impl DocumentSupplier for Published {
    fn publish(&mut self, _: (u32, u64), content: &Content) -> anyhow::Result<DocumentId> {
        self.contents.push(content.clone());
        Ok(self.contents.len() as DocumentId)
    }

    fn consolidated(
        &mut self,
        _: DocumentKind,
        _: domain::Demonstrations,
    ) -> anyhow::Result<Arc<str>> {
        anyhow::bail!("there is none")
    }

    fn published(&self, _: &Arc<str>) -> Option<DocumentId> {
        None
    }
}

fn bank() -> &'static MemoryBank {
    static BANK: OnceLock<MemoryBank> = OnceLock::new();
    let made = |(number, steps): (u16, u8)| RememberedDemonstration {
        case: 8,
        number,
        // Named by the row.
        views: (0..=steps).map(|y| ViewId { sequence: 0, number: 0, step: y.into() }).collect(),
        instruction: "Find a cone.".to_owned(),
        states: (0..=steps).map(|y| Pose::new(3, y, Heading::N).into()).collect(),
        feedback: vec![Feedback::Moved.into(); usize::from(steps) + 1],
        stages: vec![0; usize::from(steps) + 1],
        actions: vec![Some(Action::Forward.into()); usize::from(steps)],
    };
    BANK.get_or_init(|| MemoryBank::new([(0, 9), (3, 4), (1, 60)].map(made)))
}

/// An external memory's answer, up to the recall: within the budgets, and every part of it exists.
pub(crate) fn memory(input: &[u8]) {
    const BUDGETS: Budgets = Budgets { images: 20, text: 64 };
    let mut input = Input(input);
    let mut answer: ExternalAnswer = Zeroable::zeroed();
    (answer.items_len, answer.sources_len) = (input.byte().into(), input.byte().into());
    for item in answer.items.iter_mut().take(answer.items_len as usize) {
        item.kind = input.byte() % 6;
        item.demonstration = (input.byte() % 4).into();
        (item.first_step, item.steps) = (input.byte().into(), input.byte().into());
        (item.first_byte, item.bytes) = (input.byte().into(), input.byte().into());
        (item.views, item.actions) = (input.byte() % 4, input.byte() % 3);
    }
    for source in answer.sources.iter_mut().take(answer.sources_len as usize) {
        (source.item, source.demonstration) = (input.byte().into(), (input.byte() % 4).into());
        (source.first_step, source.steps) = (input.byte().into(), input.byte().into());
    }
    let answer = input.changed(answer);
    let note = input.bytes(usize::MAX);
    let Ok(items) = memory_proc::fuzzing::answered_items(&answer, note) else { return };
    assert!(items.len() <= MAX_ITEMS);
    let Ok(checked) = CheckedAnswer::new(items, bank(), &messages::scripted_world(), BUDGETS)
    else {
        return;
    };
    let supplied = checked.supplied;
    assert!(supplied.images <= BUDGETS.images && supplied.text <= BUDGETS.text);
    let (mut texts, mut documents) = (PublishedTexts::new(), Published::default());
    let mut assembler =
        Assembler { bank: bank(), episode: (1, 7), texts: &mut texts, documents: &mut documents };
    let frame = |at: ViewId| Some(1 + u64::from(at.step));
    let recall = assembler.assemble(&checked, frame).unwrap();
    assert!(recall.items_len as usize <= MAX_ITEMS && recall.steps_len as usize <= MAX_STEPS);
    assert!(recall.sources_len as usize <= MAX_SOURCES);
    for content in &documents.contents {
        let kind = content.kind();
        assert_eq!(&document(kind, document_bytes(content)).unwrap(), content);
    }
    // A policy accepts what memory made of it.
    let documents: Vec<Arc<Document>> = (1..)
        .zip(documents.contents)
        .map(|(id, content)| Arc::new(Document { id, episode: 0, lane: 0, content }))
        .collect();
    let id = RequestId { lane: 0, episode: 5, step: 0 };
    let mut made = messages::recall(id, &[]);
    (made.items_len, made.items) = (recall.items_len, recall.items);
    (made.steps_len, made.steps) = (recall.steps_len, recall.steps);
    (made.instructions_len, made.instructions) = (recall.instructions_len, recall.instructions);
    let incoming = [
        Incoming::Config(Box::new(messages::config(0, 5, "Find a cone."))),
        Incoming::Observation(Box::new(messages::observation(id, 9))),
        Incoming::Recall(Box::new(made)),
    ];
    let (complete, refused) =
        requests(1, Arc::new(messages::scripted_world()), &documents, incoming);
    assert_eq!((complete.len(), refused), (1, 0), "the policy refuses a recall of memory");
}

/// What travels beside messages, and texts in them.
pub(crate) fn blocks(input: &[u8]) {
    let mut input = Input(input);
    let choice = input.byte();
    match choice % 4 {
        0 => {
            let kinds = [
                DocumentKind::Summary,
                DocumentKind::Semantic,
                DocumentKind::Trajectories,
                DocumentKind::Note,
            ];
            let (kind, bytes) = (kinds[usize::from(choice / 4) % 4], input.0);
            if let Ok(content) = document(kind, bytes) {
                assert_eq!((content.kind(), document_bytes(&content)), (kind, bytes));
            }
        }
        1 => {
            let [demonstrations, steps, dimension, text_bytes] =
                [input.byte(), input.byte(), input.byte(), input.byte()].map(u32::from);
            let header =
                BankHeader { id: 1, demonstrations, steps, dimension, text_bytes, reserved: 0 };
            let header = input.changed(header);
            let words: Vec<u64> = input
                .0
                .chunks(8)
                .map(|bytes| bytes.iter().rev().fold(0, |word, &byte| word << 8 | u64::from(byte)))
                .collect();
            let _ = check_bank(&header, &words);
        }
        2 => {
            let mut handshake: Handshake = Zeroable::zeroed();
            handshake.facts_len = u32::from(input.word());
            let text = input.bytes(handshake.facts.len());
            handshake.facts[..text.len()].copy_from_slice(text);
            if let Ok(facts) = handshake.facts() {
                let pairs = facts.iter().map(|(name, value)| (name.as_str(), value.clone()));
                let again = Handshake::new(Role::Sim, pairs);
                if let Ok(again) = again {
                    assert_eq!(again.facts().unwrap(), facts);
                }
            }
        }
        _ => {
            let len = u32::from(input.word());
            if let Ok(text) = read_text(input.0, len) {
                let mut buffer = vec![0; input.0.len()];
                assert_eq!(write_text(&mut buffer, text), len);
            }
            let mut numbers = [0.0; MAX_STATE];
            for number in &mut numbers {
                *number = f32::from_le_bytes([(); 4].map(|()| input.byte()));
            }
            if let Ok(state) = State::new(&numbers) {
                assert_eq!(state.padded(), numbers);
                assert_eq!(state.to_string().parse(), Ok(state));
            }
            if let Ok(state) = messages::scripted_world().read_state(&numbers) {
                assert_eq!(state.padded(), numbers);
            }
        }
    }
}
