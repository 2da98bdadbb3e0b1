//! Messages from other processes.

use std::sync::{Arc, OnceLock};

use bytemuck::Zeroable;
use conformance::messages;
use domain::{Action, Arm, DocumentKind, Feedback, Heading, Pose, Representation};
use memory_proc::bank::{MemoryBank, Viewpoint};
use memory_proc::demonstrations::RememberedDemonstration;
use memory_proc::items::{Assembler, Budgets, CheckedAnswer, DocumentSupplier, PublishedTexts};
use orchestrator::lanes::{AnswerError, Lanes, Rules, Turn};
use orchestrator::plan::PlannedEpisode;
use peer::policy::fuzzing::{Incoming, requests};
use results::conditions::{Condition, Demonstrations, Route, Start, Variation};
use results::key::EpisodeKey;
use shm_types::banks::BankHeader;
use shm_types::documents::{Content, Document};
use shm_types::fuzzing::{check_bank, document, document_bytes};
use shm_types::message::{
    DocumentId, ExternalAnswer, Handshake, MAX_EXTERNAL_MEMORIES, MAX_ITEMS, MAX_SOURCES,
    MAX_STEPS, NO_FRAME, Observation, RequestId, Role, StepCommand, StepKind, WirePose, read_text,
    write_text,
};
use warehouse::{CaseSet, Variant, Warehouse, step};

use crate::input::Input;

struct World {
    warehouse: Warehouse,
    cases: CaseSet,
}

fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| World { warehouse: Warehouse::shipped(), cases: CaseSet::shipped() })
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
        arm: Arm::Frozen,
    };
    let case_index = usize::from(choice / 3) % world().cases.cases.len();
    let case = world().cases.cases[case_index].id.clone();
    PlannedEpisode {
        key: EpisodeKey { condition, run: 1, place: None, case },
        case_index,
        seed: 7,
        part: None,
    }
}

/// The simulator's answer to a command of the orchestrator.
fn honest(command: &StepCommand, pose: &mut Pose) -> Observation {
    let &StepCommand { lane, episode, step: number, last, action, .. } = command;
    let case = command.variant.checked_sub(1).map(|case| &world().cases.cases[case as usize]);
    let closed = case.into_iter().flat_map(|case| case.barricade.iter().copied());
    let mut feedback = match StepKind::try_from(command.kind).unwrap() {
        StepKind::Reset => Feedback::Start,
        StepKind::Act | StepKind::Stay => Feedback::NotUnderstood,
    };
    if feedback == Feedback::Start {
        *pose = command.start.try_into().unwrap();
    } else if let Ok(action) = Action::try_from(action) {
        let layout = &world().warehouse.layout;
        (*pose, feedback) = step(layout, &Variant::closing(closed), *pose, action);
    }
    let frame = if last == 1 { NO_FRAME } else { 1 };
    let seen = messages::observation(RequestId { lane, episode, step: number }, frame);
    Observation { pose: (*pose).into(), feedback: feedback as u8, action, last, ..seen }
}

/// What an observation asks for.
fn request(&Observation { lane, episode, step, .. }: &Observation) -> RequestId {
    RequestId { lane, episode, step }
}

/// The orchestrator's lanes between honest answers and changed ones. A finished episode has a record without
/// contradictions, whatever was answered.
pub(crate) fn orchestrator(input: &[u8]) {
    const LANES: usize = 2;
    let mut input = Input(input);
    let World { warehouse, cases } = world();
    let mut lanes = Lanes::new(warehouse, cases, RULES, LANES);
    let mut poses = [Pose::new(0, 0, Heading::N); LANES];
    let mut commands: [Option<StepCommand>; LANES] = [None; LANES];
    let mut seen: [Option<Observation>; LANES] = [None; LANES];
    let mut now = 1;
    while !input.is_empty() {
        let (choice, what) = (input.byte(), input.byte());
        let lane = usize::from(choice) % LANES;
        now = u64::saturating_add(now, u64::from(what) << (choice % 48));
        lanes.set_time(now);
        if commands[lane].is_none() {
            commands[lane] = Some(lanes.begin(lane, planned(what)).command);
        }
        let turn = match (what % 4, commands[lane], seen[lane]) {
            (0, Some(command), _) => {
                let observation = honest(&command, &mut poses[lane]);
                seen[lane] = Some(observation);
                lanes.observed(&input.changed(observation))
            }
            (1, _, Some(seen)) => {
                lanes.recalled(&input.changed(messages::recall_trace(request(&seen))))
            }
            (2, _, Some(seen)) => {
                let action = Action::ALL[usize::from(choice) % Action::ALL.len()];
                lanes.decided(&input.changed(messages::decision(request(&seen), action)))
            }
            (3, _, Some(seen)) => {
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
                commands[command.lane as usize] = Some(command);
            }
            Ok(Turn::Finished(finished)) => {
                finished.record.check(RULES.max_steps).unwrap();
                let lane = finished.lane as usize;
                (commands[lane], seen[lane]) = (None, None);
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                if !matches!(error, AnswerError::NoSuchLane { .. }) {
                    lanes.give_up(lane as u32);
                    (commands[lane], seen[lane]) = (None, None);
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
        variant: 0,
        instruction: "Find a cone.".to_owned(),
        poses: (0..=steps).map(|y| Pose::new(3, y, Heading::N)).collect(),
        feedback: vec![Feedback::Moved; usize::from(steps) + 1],
        stages: vec![0; usize::from(steps) + 1],
        actions: vec![Some(Action::Forward); usize::from(steps)],
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
        item.kind = input.byte() % 5;
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
    let Ok(checked) = CheckedAnswer::new(items, bank(), BUDGETS) else { return };
    let supplied = checked.supplied;
    assert!(supplied.images <= BUDGETS.images && supplied.text <= BUDGETS.text);
    let (mut texts, mut documents) = (PublishedTexts::new(), Published::default());
    let mut assembler =
        Assembler { bank: bank(), episode: (1, 7), texts: &mut texts, documents: &mut documents };
    let frame = |at: Viewpoint| Some(1 + u64::from(at.pose.cell.y));
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
    let incoming = [
        Incoming::Config(Box::new(messages::config(0, 5, "Find a cone."))),
        Incoming::Observation(Box::new(messages::observation(id, 9))),
        Incoming::Recall(Box::new(made)),
    ];
    let (complete, refused) = requests(1, &documents, incoming);
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
            let pose = WirePose([input.byte(), input.byte(), input.byte(), input.byte()]);
            if let Ok(read) = Pose::try_from(pose) {
                assert_eq!(WirePose::from(read).0[..3], pose.0[..3]);
                assert_eq!(read.to_string().parse::<Pose>().unwrap(), read);
            }
        }
    }
}
