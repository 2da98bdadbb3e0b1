//! Valid messages. A test changes the fields that it is about.

use std::path::Path;
use std::{fs, io};

use bytemuck::Zeroable;
use case_book::{ActionDeclaration, BookFile, StateField, WORLD_FILE, WorldDeclaration};
use domain::{Action, Feedback, Heading, Outcome, Pose, State};
use shm_types::message::{
    Decision, DocumentId, ExternalEpisode, ExternalQuery, FrameId, ItemKind, MAX_SOURCES,
    NO_ACTION, NO_FRAME, NOT_MEASURED, Observation, PolicyEpisodeConfig, Recall, RecallTrace,
    RecalledItem, RequestId, SegmentStep, StepCommand, StepKind, StepReport, WorldEpisodeConfig,
    write_text,
};
use shm_types::process::monotonic_ns;

/// The declaration of the scripted world: poses on a grid, and the actions and feedback of the benchmark's agent.
pub fn scripted_world() -> WorldDeclaration {
    let field =
        |name: &str, words: Vec<String>| StateField { name: name.to_owned(), words, digits: 0 };
    let action = |action: Action| ActionDeclaration {
        letter: action.letter(),
        words: action.words().to_owned(),
    };
    let headings = Heading::ALL.map(|heading| heading.word().to_owned()).to_vec();
    WorldDeclaration {
        name: "scripted".to_owned(),
        version: "1".to_owned(),
        rules: "You walk on a grid.".to_owned(),
        actions: Action::ALL.map(action).to_vec(),
        state: vec![field("column", vec![]), field("row", vec![]), field("heading", headings)],
        state_sentence: "You are in column {column}, row {row}, and face {heading}.".to_owned(),
        feedback: Feedback::ALL.map(|feedback| feedback.words().to_owned()).to_vec(),
        is_deterministic: true,
    }
}

/// Writes the declaration of the scripted world into the folder to which processes attach.
///
/// # Errors
/// When the file cannot be written.
pub fn write_scripted_world(root: &Path) -> io::Result<()> {
    fs::write(root.join(WORLD_FILE), BookFile::new(scripted_world())?.text)
}

/// The config of an episode with a window of six steps; its seed is the number of its lane.
pub fn config(lane: u32, episode: u64, instruction: &str) -> PolicyEpisodeConfig {
    let seed = lane.into();
    let mut config =
        PolicyEpisodeConfig { lane, episode, seed, repeat: 1, window: 6, ..Zeroable::zeroed() };
    config.instruction_len = write_text(&mut config.instruction, instruction);
    config
}

/// The config that begins an episode of case number `case` at its original start, in `variant`.
pub fn world_config(lane: u32, episode: u64, variant: u32, case: u32) -> WorldEpisodeConfig {
    WorldEpisodeConfig { lane, episode, variant, case, max_steps: 200, ..Zeroable::zeroed() }
}

/// The command to act.
pub fn act(id: RequestId, action: Action) -> StepCommand {
    let RequestId { lane, episode, step } = id;
    let (kind, action) = (StepKind::Act as u8, action as u8);
    StepCommand { lane, episode, step, kind, action, sent_ns: 1, ..Zeroable::zeroed() }
}

/// The observation of a step, after a move forward.
pub fn observation(id: RequestId, frame: FrameId) -> Observation {
    let RequestId { lane, episode, step } = id;
    let (feedback, action) = match step {
        0 => (Feedback::Start, NO_ACTION),
        _ => (Feedback::Moved, Action::Forward as u8),
    };
    Observation {
        lane,
        episode,
        step,
        frame,
        state: State::from(Pose::new(3, 4, Heading::E)).padded(),
        feedback: feedback as u8,
        action,
        ..Zeroable::zeroed()
    }
}

/// The report about a step that goes before its observation, of a task with one sub-goal.
pub fn report(of: &Observation) -> StepReport {
    let &Observation { lane, episode, step, frame, .. } = of;
    let now = monotonic_ns();
    StepReport {
        lane,
        episode,
        step,
        frame,
        commanded_ns: now,
        woken_ns: now,
        stepped_ns: now,
        rendered_ns: now,
        sent_ns: now,
        required: 1,
        ..Zeroable::zeroed()
    }
}

/// The last observation of an episode.
pub fn last(id: RequestId) -> Observation {
    Observation { last: 1, ..observation(id, NO_FRAME) }
}

/// A recall with a segment, whose last view has no action; without an item if `segment` is empty.
pub fn recall(id: RequestId, segment: &[FrameId]) -> Recall {
    let RequestId { lane, episode, step } = id;
    let mut recall = Recall { lane, episode, step, ..Zeroable::zeroed() };
    if !segment.is_empty() {
        let item = RecalledItem { distance: 0.125, ..item(ItemKind::Steps) };
        let last = segment.len() - 1;
        let steps = segment.iter().enumerate();
        let action = |at| (at < last).then_some(Action::TurnLeft);
        let steps: Vec<_> = steps.map(|(at, &frame)| supplied(frame, action(at))).collect();
        supply(&mut recall, item, &steps);
    }
    recall
}

/// An item without a document, steps and distance; a step or a frame is of one demonstration.
pub fn item(kind: ItemKind) -> RecalledItem {
    let instructions = matches!(kind, ItemKind::Steps | ItemKind::Frame).into();
    RecalledItem { kind: kind as u8, distance: f32::NAN, instructions, ..Zeroable::zeroed() }
}

/// A step of an item.
pub fn supplied(frame: FrameId, action: Option<Action>) -> SegmentStep {
    let action = action.map_or(NO_ACTION, |action| action as u8);
    SegmentStep { frame, action, reserved: [0; 7] }
}

/// An item that is the whole text of a document.
pub fn text(document: DocumentId, bytes: usize) -> RecalledItem {
    RecalledItem { document, bytes: bytes as u32, ..item(ItemKind::Text) }
}

/// Adds an item to a recall, with the steps that the message holds for it, and as many empty instructions as it says.
///
/// # Panics
/// When the message has no room for them.
pub fn supply(recall: &mut Recall, item: RecalledItem, steps: &[SegmentStep]) {
    let (at, first) = (recall.items_len as usize, recall.steps_len as usize);
    recall.items[at] = item;
    recall.items[at].first_instruction = recall.instructions_len as u8;
    recall.instructions_len += u32::from(item.instructions);
    assert!(recall.instructions_len as usize <= MAX_SOURCES, "there is no room for instructions");
    recall.items_len += 1;
    if !steps.is_empty() {
        recall.items[at].first_step = recall.steps_len;
        recall.items[at].steps = steps.len() as u32;
        recall.steps[first..first + steps.len()].copy_from_slice(steps);
        recall.steps_len += steps.len() as u32;
    }
}

/// The account of a recall without a retrieval.
pub fn recall_trace(id: RequestId) -> RecallTrace {
    let RequestId { lane, episode, step } = id;
    RecallTrace { lane, episode, step, tokens: NOT_MEASURED, ..Zeroable::zeroed() }
}

/// The decision to act, by a policy that saw one image and asked no model.
pub fn decision(id: RequestId, action: Action) -> Decision {
    let RequestId { lane, episode, step } = id;
    Decision {
        lane,
        episode,
        step,
        outcome: Outcome::Acted as u8,
        action: action as u8,
        images: 1,
        images_asked: 1,
        prompt_tokens: NOT_MEASURED,
        completion_tokens: NOT_MEASURED,
        cached_tokens: NOT_MEASURED,
        image_tokens: NOT_MEASURED,
        memory_tokens: NOT_MEASURED,
        reusable_tokens: NOT_MEASURED,
        ..Zeroable::zeroed()
    }
}

/// The beginning of an episode that remembers the bank with the id `bank`; its seed is the number of its lane.
pub fn external_episode(lane: u32, episode: u64, bank: u64, instruction: &str) -> ExternalEpisode {
    let mut begun = ExternalEpisode {
        episode,
        bank,
        seed: lane.into(),
        lane,
        text_budget: 65_536,
        image_budget: 16,
        repeat: 1,
        ..Zeroable::zeroed()
    };
    begun.instruction_len = write_text(&mut begun.instruction, instruction);
    begun
}

/// The query of a step, after a move forward.
pub fn query(
    id: RequestId,
    frame: FrameId,
    state: impl Into<State>,
    embedding: &[f32],
) -> ExternalQuery {
    let RequestId { lane, episode, step } = id;
    let (feedback, action) = match step {
        0 => (Feedback::Start, NO_ACTION),
        _ => (Feedback::Moved, Action::Forward as u8),
    };
    let mut query = ExternalQuery {
        episode,
        frame,
        lane,
        step,
        state: state.into().padded(),
        embedding_len: embedding.len() as u32,
        feedback: feedback as u8,
        action,
        ..Zeroable::zeroed()
    };
    query.embedding[..embedding.len()].copy_from_slice(embedding);
    query
}

/// The last message of an episode, which is not answered.
pub fn last_query(id: RequestId, state: impl Into<State>) -> ExternalQuery {
    ExternalQuery { last: 1, ..query(id, NO_FRAME, state, &[]) }
}
