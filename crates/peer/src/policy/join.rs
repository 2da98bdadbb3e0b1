//! Joins the messages of a step: a lane's episode config, its observation, and the recall for the same step. Builds the
//! window of past steps from the observations.
//!
//! Pure: messages in, complete steps out. A message with an invalid value is an error that names the value and changes
//! nothing.

use std::collections::VecDeque;
use std::fmt::Display;
use std::ops::Range;
use std::sync::Arc;

use case_book::WorldDeclaration;
use domain::pose::UnknownCode;
use domain::{ActionCode, FeedbackCode, State};
use shm_types::message::{
    DocumentId, EpisodeId, FrameId, ItemKind, MAX_ITEMS, MAX_SOURCES, MAX_STEPS, MAX_WINDOW,
    NO_DOCUMENT, NO_FRAME, Observation, PolicyEpisodeConfig, Recall, RecalledInstruction,
    RecalledItem, RequestId, SegmentStep, read_action, read_flag, read_text,
};

const RECALL: &str = "recall";

/// The episode of a lane.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct LaneEpisode {
    pub(super) id: EpisodeId,
    pub(super) seed: u64,
    pub(super) repeat: u32,
    pub(super) instruction: String,
    pub(super) starts_as_demonstrated: bool,
    pub(super) demonstrated_elsewhere: bool,
    /// What the world says of itself.
    pub(super) world: Arc<WorldDeclaration>,
    /// Window length.
    window: usize,
}

/// A past step: its view, the action taken there (`None` if the answer could not be read) and the feedback to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct JoinedStep {
    pub(super) frame: FrameId,
    pub(super) action: Option<ActionCode>,
    pub(super) feedback: FeedbackCode,
}

/// The content of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observed {
    pub(super) step: u32,
    pub(super) frame: FrameId,
    pub(super) state: State,
    pub(super) feedback: FeedbackCode,
}

/// A view and the expert's action there, each if it is supplied.
pub(super) type SuppliedStep = (FrameId, Option<ActionCode>);

/// The content of a recall.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Recalled {
    lane: u32,
    episode: EpisodeId,
    step: u32,
    pub(super) items: Vec<ItemContent>,
    /// The steps of all items.
    pub(super) steps: Vec<SuppliedStep>,
}

/// An item of a recall, whose document has not been looked up.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ItemContent {
    Text(TextPart),
    /// Steps in [`Recalled::steps`].
    Steps {
        kind: StepsKind,
        steps: Range<usize>,
        instruction: Option<TextPart>,
    },
    /// Steps in a document, and the instruction of each demonstration that they belong to.
    Trajectory {
        kind: StepsKind,
        document: DocumentId,
        steps: Range<usize>,
        instructions: Vec<Option<TextPart>>,
    },
    /// A view in [`Recalled::steps`]. An empty caption or instruction is absent.
    Frame {
        frame: FrameId,
        caption: Option<TextPart>,
        instruction: Option<TextPart>,
    },
    /// Actions in a document, and the instruction of each demonstration that they are taken from.
    Plan {
        document: DocumentId,
        steps: Range<usize>,
        instructions: Vec<Option<TextPart>>,
    },
}

/// Some bytes of a document.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TextPart {
    pub(super) document: DocumentId,
    pub(super) bytes: Range<usize>,
}

impl TextPart {
    fn new(document: DocumentId, first_byte: u32, bytes: u32) -> Self {
        Self { document, bytes: range(first_byte, bytes) }
    }

    /// The same; `None` for an empty text, which is in no document.
    fn unless_absent(self) -> Option<Self> {
        Some(self).filter(|part| part.document != NO_DOCUMENT || !part.bytes.is_empty())
    }
}

fn range(first: u32, count: u32) -> Range<usize> {
    first as usize..first as usize + count as usize
}

/// What the steps of an item are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StepsKind {
    pub(super) distance: Option<f32>,
    pub(super) is_whole: bool,
}

impl Recalled {
    /// Reads a message where it lies.
    pub(super) fn read(world: &WorldDeclaration, message: &Recall) -> Result<Self, String> {
        let &Recall { lane, step, episode, .. } = message;
        let count = |what, count: u32, most: usize| {
            let fits = usize::try_from(count).ok().filter(|&count| count <= most);
            fits.ok_or_else(|| bad_count(RECALL, lane, step, (count, what, most)))
        };
        let items = &message.items[..count("items", message.items_len, MAX_ITEMS)?];
        let steps = &message.steps[..count("steps", message.steps_len, MAX_STEPS)?];
        let supplied = |supplied: &SegmentStep| {
            let action = read_action(supplied.action)?;
            Ok((supplied.frame, world.read_action(action)?))
        };
        let steps = steps.iter().map(supplied).collect::<Result<Vec<_>, UnknownCode>>();
        let steps = steps.map_err(|problem| bad(RECALL, lane, step, problem))?;
        let instructions = count("instructions", message.instructions_len, MAX_SOURCES)?;
        let instructions = &message.instructions[..instructions];
        let items = items.iter().enumerate().map(|(item, content)| {
            ItemContent::read(content, &steps, instructions)
                .map_err(|problem| bad_item(lane, step, item, &problem))
        });
        let items = items.collect::<Result<_, _>>()?;
        Ok(Self { lane, episode, step, items, steps })
    }

    /// The documents that the items name.
    pub(super) fn documents(&self) -> impl Iterator<Item = DocumentId> {
        self.items.iter().flat_map(|item| {
            let (steps, texts): (_, Vec<&TextPart>) = match item {
                ItemContent::Text(part) => (None, vec![part]),
                ItemContent::Steps { instruction, .. } => (None, instruction.iter().collect()),
                ItemContent::Trajectory { document, instructions, .. }
                | ItemContent::Plan { document, instructions, .. } => {
                    (Some(*document), instructions.iter().flatten().collect())
                }
                ItemContent::Frame { caption, instruction, .. } => {
                    (None, caption.iter().chain(instruction).collect())
                }
            };
            steps.into_iter().chain(texts.into_iter().map(|part| part.document))
        })
    }
}

impl ItemContent {
    /// Reads an item of a recall with `steps` and `instructions`; an error continues "item 2 ...".
    fn read(
        item: &RecalledItem,
        steps: &[SuppliedStep],
        instructions: &[RecalledInstruction],
    ) -> Result<Self, String> {
        let &RecalledItem { document, distance, kind, whole, .. } = item;
        let text = TextPart::new(document, item.first_byte, item.bytes);
        let supplied = range(item.first_step, item.steps);
        let kind = ItemKind::try_from(kind).map_err(|problem| format!("is invalid: {problem}"))?;
        if kind != ItemKind::Text && supplied.is_empty() {
            return Err("has no steps".to_owned());
        }
        if matches!(kind, ItemKind::Steps | ItemKind::Frame) && supplied.end > steps.len() {
            let (Range { start, end }, len) = (supplied, steps.len());
            return Err(format!("has the steps {start}..{end} of a message with {len}"));
        }
        let named = range(item.first_instruction.into(), item.instructions.into());
        let of_item = instructions.get(named.clone()).ok_or_else(|| {
            format!("has the instructions {named:?} of a message with {}", instructions.len())
        })?;
        let mut instructions = of_item
            .iter()
            .map(|of| TextPart::new(of.document, of.first_byte, of.bytes).unless_absent());
        let expected = match kind {
            ItemKind::Text => 0,
            ItemKind::Steps | ItemKind::Frame => 1,
            // As many as there are demonstrations in the document.
            ItemKind::Trajectory | ItemKind::Plan => of_item.len(),
        };
        if of_item.len() != expected {
            let count = of_item.len();
            return Err(format!("has {count} instructions, expected {expected}"));
        }
        let distance = distance.is_finite().then_some(distance);
        let what = StepsKind { distance, is_whole: whole != 0 };
        Ok(match kind {
            ItemKind::Text => Self::Text(text),
            ItemKind::Steps => {
                let instruction = instructions.next().flatten();
                Self::Steps { kind: what, steps: supplied, instruction }
            }
            ItemKind::Trajectory => {
                let instructions = instructions.collect();
                Self::Trajectory { kind: what, document, steps: supplied, instructions }
            }
            ItemKind::Plan => {
                Self::Plan { document, steps: supplied, instructions: instructions.collect() }
            }
            ItemKind::Frame => {
                let [(frame, _)] = steps[supplied] else {
                    return Err(format!("is a frame of {} steps", item.steps));
                };
                if frame == NO_FRAME {
                    return Err("is a frame that names no frame".to_owned());
                }
                let (caption, instruction) = (text.unless_absent(), instructions.next().flatten());
                Self::Frame { frame, caption, instruction }
            }
        })
    }
}

/// The running episode of a lane, and the messages of its current step.
#[derive(Debug, Default)]
struct Lane {
    episode: Option<Arc<LaneEpisode>>,
    /// Steps before the current one, oldest first.
    window: VecDeque<JoinedStep>,
    /// The current step.
    current: Option<Observed>,
    /// Whether the current step waits for its recall.
    is_open: bool,
    recalled: Option<Recalled>,
}

impl Lane {
    fn is_running(&self, id: EpisodeId) -> bool {
        self.episode.as_ref().is_some_and(|episode| episode.id == id)
    }
}

/// A step with everything that belongs to it.
#[derive(Debug)]
pub(super) struct Ready {
    pub(super) lane: u32,
    pub(super) episode: Arc<LaneEpisode>,
    pub(super) observed: Observed,
    pub(super) window: Vec<JoinedStep>,
    pub(super) recalled: Recalled,
}

/// All lanes of a run.
#[derive(Debug)]
pub(super) struct Join {
    lanes: Vec<Lane>,
    /// What the world says of itself.
    world: Arc<WorldDeclaration>,
}

impl Join {
    pub(super) fn new(lanes: u32, world: Arc<WorldDeclaration>) -> Self {
        Self { lanes: (0..lanes).map(|_| Lane::default()).collect(), world }
    }

    /// Begins an episode in a lane, and drops what the lane had.
    pub(super) fn begin(&mut self, config: &PolicyEpisodeConfig) -> Result<(), String> {
        const MESSAGE: &str = "episode config";
        let number = config.lane;
        let world = Arc::clone(&self.world);
        let lane = self.lane_mut(MESSAGE, number)?;
        let instruction = read_text(&config.instruction, config.instruction_len)
            .map_err(|problem| bad(MESSAGE, number, 0, problem))?;
        let window = usize::from(config.window);
        if window > MAX_WINDOW {
            let count = (config.window.into(), "past steps", MAX_WINDOW);
            return Err(bad_count(MESSAGE, number, 0, count));
        }
        let bad_value = |problem: UnknownCode| bad(MESSAGE, number, 0, problem);
        let episode = LaneEpisode {
            id: config.episode,
            seed: config.seed,
            repeat: config.repeat,
            instruction: instruction.to_owned(),
            starts_as_demonstrated: read_flag(config.starts_as_demonstrated).map_err(bad_value)?,
            demonstrated_elsewhere: read_flag(config.demonstrated_elsewhere).map_err(bad_value)?,
            world,
            window,
        };
        *lane = Lane { episode: Some(Arc::new(episode)), ..Lane::default() };
        Ok(())
    }

    /// Takes the observation of a step. One of another episode is late and is dropped.
    pub(super) fn observe(&mut self, message: &Observation) -> Result<(), String> {
        const MESSAGE: &str = "observation";
        let &Observation { lane: number, step, frame, .. } = message;
        let lane = self.lane_mut(MESSAGE, number)?;
        let Some(episode) = lane.episode.as_ref().filter(|episode| episode.id == message.episode)
        else {
            return Ok(());
        };
        let bad_value = |problem: UnknownCode| bad(MESSAGE, number, step, problem);
        if read_flag(message.last).map_err(bad_value)? {
            *lane = Lane::default();
            return Ok(());
        }
        if frame == NO_FRAME {
            return Err(bad(MESSAGE, number, step, "it names no frame"));
        }
        let world = &episode.world;
        let state = world.read_state(&message.state);
        let state = state.map_err(|problem| bad(MESSAGE, number, step, problem))?;
        let feedback = world.read_feedback(message.feedback).map_err(bad_value)?;
        let action = world.read_action(read_action(message.action).map_err(bad_value)?);
        let action = action.map_err(bad_value)?;
        let expected = lane.current.map_or(0, |current| current.step + 1);
        if step != expected {
            let problem = format_args!("step {expected} is next");
            return Err(bad(MESSAGE, number, step, problem));
        }
        if let Some(past) = lane.current {
            lane.window.push_back(JoinedStep { frame: past.frame, action, feedback });
            if lane.window.len() > episode.window {
                lane.window.pop_front();
            }
        }
        lane.current = Some(Observed { step, frame, state, feedback });
        lane.is_open = true;
        Ok(())
    }

    /// Takes the recall of a step. One of another episode is late and is dropped.
    pub(super) fn recall(&mut self, recalled: Recalled) -> Result<(), String> {
        let lane = self.lane_mut(RECALL, recalled.lane)?;
        if lane.is_running(recalled.episode) {
            lane.recalled = Some(recalled);
        }
        Ok(())
    }

    /// Takes all steps that have their observation and their recall, by lane.
    pub(super) fn take_ready(&mut self) -> Vec<Ready> {
        let mut ready = Vec::new();
        for (number, lane) in self.lanes.iter_mut().enumerate() {
            let Lane { episode: Some(episode), current: Some(observed), is_open: true, .. } = lane
            else {
                continue;
            };
            let Some(recalled) = lane.recalled.take_if(|recalled| recalled.step == observed.step)
            else {
                continue;
            };
            lane.is_open = false;
            ready.push(Ready {
                lane: number as u32,
                episode: Arc::clone(episode),
                observed: *observed,
                window: lane.window.iter().copied().collect(),
                recalled,
            });
        }
        ready
    }

    /// Whether a recall waits for its observation. The observation has been sent, without a notification for the
    /// policy, and may arrive a moment later.
    pub(super) fn awaits_observation(&self) -> bool {
        self.lanes.iter().any(|lane| lane.recalled.is_some())
    }

    /// Whether `id` belongs to a running episode.
    pub(super) fn is_running(&self, id: RequestId) -> bool {
        self.lanes.get(id.lane as usize).is_some_and(|lane| lane.is_running(id.episode))
    }

    fn lane_mut(&mut self, message: &str, lane: u32) -> Result<&mut Lane, String> {
        let lanes = self.lanes.len();
        let lane_of = self.lanes.get_mut(lane as usize);
        lane_of.ok_or_else(|| format!("{message} for lane {lane}: the run has {lanes} lanes"))
    }
}

/// Why a message cannot be used.
fn bad(message: &str, lane: u32, step: u32, problem: impl Display) -> String {
    format!("{message} for lane {lane}, step {step}: {problem}")
}

fn bad_count(
    message: &str,
    lane: u32,
    step: u32,
    (count, what, most): (u32, &str, usize),
) -> String {
    bad(message, lane, step, format_args!("{count} {what}, but at most {most} fit"))
}

/// Why an item of a recall cannot be used; `problem` continues "item 2 ...".
pub(super) fn bad_item(lane: u32, step: u32, item: usize, problem: &str) -> String {
    bad(RECALL, lane, step, format_args!("item {item} {problem}"))
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use conformance::messages::scripted_world;
    use domain::{Action, Feedback};
    use shm_types::message::{NO_ACTION, write_text};

    use super::*;

    fn config(lane: u32, episode: u64) -> PolicyEpisodeConfig {
        let mut config = PolicyEpisodeConfig { lane, episode, window: 2, ..Zeroable::zeroed() };
        config.instruction_len = write_text(&mut config.instruction, "Find a blue barrel.");
        config
    }

    fn observation(lane: u32, episode: u64, step: u32) -> Observation {
        let frame = 100 + u64::from(step);
        Observation { lane, episode, step, frame, feedback: 1, ..Zeroable::zeroed() }
    }

    fn recall(lane: u32, episode: u64, step: u32) -> Recall {
        Recall { lane, episode, step, ..Zeroable::zeroed() }
    }

    fn recalled(join: &mut Join, message: &Recall) -> Result<(), String> {
        join.recall(Recalled::read(&scripted_world(), message)?)
    }

    /// Two lanes; episode 5 runs in the second one.
    fn join() -> Join {
        let mut join = Join::new(2, Arc::new(scripted_world()));
        join.begin(&config(1, 5)).unwrap();
        join
    }

    fn ready(join: &mut Join) -> Vec<(u32, u32)> {
        join.take_ready().iter().map(|ready| (ready.lane, ready.observed.step)).collect()
    }

    #[test]
    fn a_step_is_complete_with_observation_and_recall_in_either_order() {
        let mut join = join();
        join.observe(&observation(1, 5, 0)).unwrap();
        assert_eq!(ready(&mut join), []);
        recalled(&mut join, &recall(1, 5, 0)).unwrap();
        assert_eq!(ready(&mut join), [(1, 0)]);
        assert_eq!(ready(&mut join), [], "a step is taken once");
        recalled(&mut join, &recall(1, 5, 1)).unwrap();
        assert!(join.awaits_observation());
        join.observe(&observation(1, 5, 1)).unwrap();
        let steps = join.take_ready();
        assert_eq!((steps.len(), steps[0].observed.step), (1, 1));
        assert_eq!(steps[0].episode.instruction, "Find a blue barrel.");
        assert!(!join.awaits_observation());
    }

    #[test]
    fn the_window_holds_the_last_steps_oldest_first() {
        let mut join = join();
        let mut windows = Vec::new();
        for step in 0..4 {
            let action = if step == 2 { NO_ACTION } else { step as u8 };
            join.observe(&Observation { action, ..observation(1, 5, step) }).unwrap();
            recalled(&mut join, &recall(1, 5, step)).unwrap();
            windows.push(join.take_ready().pop().unwrap().window);
        }
        let past = |step: u64, action: Option<Action>| JoinedStep {
            frame: 100 + step,
            action: action.map(ActionCode::from),
            feedback: Feedback::Moved.into(),
        };
        let first = past(0, Some(Action::Backward));
        let (second, third) = (past(1, None), past(2, Some(Action::Right)));
        let expected = [vec![], vec![first], vec![first, second], vec![second, third]];
        assert_eq!(windows, expected);
        join.begin(&PolicyEpisodeConfig { window: 0, ..config(1, 6) }).unwrap();
        for step in 0..2 {
            join.observe(&observation(1, 6, step)).unwrap();
        }
        recalled(&mut join, &recall(1, 6, 1)).unwrap();
        assert_eq!(join.take_ready()[0].window, []);
    }

    #[test]
    fn messages_of_different_steps_or_episodes_never_join() {
        let mut join = join();
        join.observe(&observation(1, 5, 0)).unwrap();
        recalled(&mut join, &recall(1, 5, 1)).unwrap();
        recalled(&mut join, &recall(1, 4, 0)).unwrap();
        join.observe(&observation(0, 0, 0)).unwrap();
        recalled(&mut join, &recall(0, 0, 0)).unwrap();
        assert_eq!(ready(&mut join), []);
        join.begin(&config(1, 6)).unwrap();
        recalled(&mut join, &recall(1, 6, 0)).unwrap();
        assert_eq!(ready(&mut join), [], "a new episode starts with nothing");
    }

    #[test]
    fn the_last_observation_ends_the_episode() {
        let mut join = join();
        let last = Observation { last: 1, frame: NO_FRAME, ..observation(1, 5, 9) };
        join.observe(&last).unwrap();
        join.observe(&observation(1, 5, 9)).unwrap();
        recalled(&mut join, &recall(1, 5, 9)).unwrap();
        assert_eq!(ready(&mut join), []);
    }

    #[test]
    fn invalid_messages_are_described_and_change_nothing() {
        let mut join = join();
        let no_text = PolicyEpisodeConfig { instruction_len: 4000, ..config(1, 6) };
        let mut bad_state = observation(1, 5, 0);
        bad_state.state[2] = 9.0;
        let with_action = |action| {
            let mut recall = Recall { steps_len: 1, ..recall(1, 5, 0) };
            recall.steps[0].action = action;
            recall
        };
        let with = |item| {
            let mut recall =
                Recall { items_len: 2, steps_len: 4, instructions_len: 2, ..recall(1, 5, 0) };
            recall.items[1] = item;
            recall
        };
        let of_kind = |kind| RecalledItem { kind, ..Zeroable::zeroed() };
        let of_text = |first_instruction, instructions| RecalledItem {
            first_instruction,
            instructions,
            ..of_kind(0)
        };
        let steps = |kind: ItemKind, first_step, steps| {
            with(RecalledItem { first_step, steps, instructions: 1, ..of_kind(kind as u8) })
        };
        let errors = [
            join.begin(&config(2, 6)),
            join.begin(&no_text),
            join.begin(&PolicyEpisodeConfig { window: 33, ..config(1, 6) }),
            join.begin(&PolicyEpisodeConfig { demonstrated_elsewhere: 2, ..config(1, 6) }),
            join.observe(&Observation { last: 7, ..observation(1, 5, 0) }),
            join.observe(&bad_state),
            join.observe(&Observation { feedback: 8, ..observation(1, 5, 0) }),
            join.observe(&Observation { action: 7, ..observation(1, 5, 0) }),
            join.observe(&Observation { frame: NO_FRAME, ..observation(1, 5, 0) }),
            join.observe(&observation(1, 5, 1)),
            recalled(&mut join, &Recall { items_len: 1 << 31, ..recall(1, 5, 0) }),
            recalled(&mut join, &Recall { steps_len: 49, ..recall(1, 5, 0) }),
            recalled(&mut join, &with_action(77)),
            recalled(&mut join, &with_action(7)),
            recalled(&mut join, &with(of_kind(9))),
            recalled(&mut join, &steps(ItemKind::Steps, 2, 0)),
            recalled(&mut join, &steps(ItemKind::Steps, 2, 3)),
            recalled(&mut join, &steps(ItemKind::Steps, u32::MAX, u32::MAX)),
            recalled(&mut join, &steps(ItemKind::Trajectory, 0, 0)),
            recalled(&mut join, &steps(ItemKind::Frame, 0, 2)),
            recalled(&mut join, &steps(ItemKind::Frame, 0, 1)),
            recalled(&mut join, &Recall { instructions_len: 17, ..recall(1, 5, 0) }),
            recalled(&mut join, &with(of_text(2, 1))),
            recalled(&mut join, &with(of_text(0, 1))),
            recalled(&mut join, &with(RecalledItem { steps: 1, ..of_kind(ItemKind::Steps as u8) })),
            recalled(&mut join, &recall(u32::MAX, 5, 0)),
        ];
        let texts: Vec<_> = errors.into_iter().map(|e| e.unwrap_err().to_string()).collect();
        insta::assert_snapshot!(texts.join("\n"), @r"
        episode config for lane 2: the run has 2 lanes
        episode config for lane 1, step 0: a text of 4000 bytes is not UTF-8 that fits
        episode config for lane 1, step 0: 33 past steps, but at most 32 fit
        episode config for lane 1, step 0: 2 is not a flag (0 no, 1 yes)
        observation for lane 1, step 0: 7 is not a flag (0 no, 1 yes)
        observation for lane 1, step 0: this is no state of the world scripted: heading is 9, not one of 0 to 3
        observation for lane 1, step 0: 8 is not a feedback of this world
        observation for lane 1, step 0: 7 is not an action of this world
        observation for lane 1, step 0: it names no frame
        observation for lane 1, step 1: step 0 is next
        recall for lane 1, step 0: 2147483648 items, but at most 8 fit
        recall for lane 1, step 0: 49 steps, but at most 48 fit
        recall for lane 1, step 0: 77 is not an action (0 to 63)
        recall for lane 1, step 0: 7 is not an action of this world
        recall for lane 1, step 0: item 1 is invalid: 9 is not an item kind (0 text, 1 steps, 2 trajectory, 3 frame, 4 plan)
        recall for lane 1, step 0: item 1 has no steps
        recall for lane 1, step 0: item 1 has the steps 2..5 of a message with 4
        recall for lane 1, step 0: item 1 has the steps 4294967295..8589934590 of a message with 4
        recall for lane 1, step 0: item 1 has no steps
        recall for lane 1, step 0: item 1 is a frame of 2 steps
        recall for lane 1, step 0: item 1 is a frame that names no frame
        recall for lane 1, step 0: 17 instructions, but at most 16 fit
        recall for lane 1, step 0: item 1 has the instructions 2..3 of a message with 2
        recall for lane 1, step 0: item 1 has 1 instructions, expected 0
        recall for lane 1, step 0: item 1 has 0 instructions, expected 1
        recall for lane 4294967295: the run has 2 lanes
        ");
        join.observe(&observation(1, 5, 0)).unwrap();
        recalled(&mut join, &recall(1, 5, 0)).unwrap();
        assert_eq!(ready(&mut join), [(1, 0)]);
    }

    proptest::proptest! {
        /// Whatever arrives is read or refused.
        #[test]
        fn no_recall_panics(
            bytes in proptest::collection::vec(proptest::num::u8::ANY, size_of::<Recall>()),
            counts in (0..=MAX_ITEMS as u32, 0..=MAX_STEPS as u32, 0..=MAX_SOURCES as u32),
            ranges in proptest::collection::vec((0..60_u32, 0..60_u32, 0..5_u8), MAX_ITEMS),
        ) {
            let world = scripted_world();
            let mut recall: Recall = bytemuck::pod_read_unaligned(&bytes);
            let _ = Recalled::read(&world, &recall);
            (recall.items_len, recall.steps_len, recall.instructions_len) = counts;
            recall.steps.iter_mut().for_each(|step| step.action %= 7);
            let _ = Recalled::read(&world, &recall);
            for (item, range) in recall.items.iter_mut().zip(ranges) {
                (item.first_step, item.steps, item.kind) = range;
                item.instructions = 1;
            }
            if let Ok(recalled) = Recalled::read(&world, &recall) {
                assert_eq!(recalled.items.len(), counts.0 as usize);
            }
        }
    }
}
