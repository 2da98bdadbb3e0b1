//! Joining what belongs together: a lane's brief, its observation and the recall for the same step.
//!
//! Pure: messages in, complete steps out. Messages are input from other processes, so each is checked
//! here, and a bad one is an error that names the value and leaves everything as it was.

use domain::{Action, Feedback, Pose, pose::UnknownCode};
use shm_types::message::{
    DocumentId, FrameId, MAX_DOCUMENTS, MAX_SEGMENT, MAX_WINDOW, NO_ACTION, NO_FRAME, Observation,
    PastStep, PolicyEpisodeConfig, Recall, SegmentStep, read_text,
};

use crate::RequestId;

/// What a recall is called in complaints.
const RECALL: &str = "recall";

/// Why a message cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum BadMessage {
    #[error("{message} for lane {lane}: the run has {lanes}")]
    Lane { message: &'static str, lane: u32, lanes: usize },
    #[error("{message} for lane {lane}, step {step}: {problem}")]
    Value { message: &'static str, lane: u32, step: u32, problem: UnknownCode },
    #[error("recall for lane {lane}, step {step}: {count} {what}, at most {most} fit")]
    Count { lane: u32, step: u32, what: &'static str, count: u32, most: usize },
    #[error("observation for lane {lane}, step {step}: it names no frame")]
    NoFrame { lane: u32, step: u32 },
}

/// What an observation says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observed {
    pub(super) step: u32,
    pub(super) frame: FrameId,
    pub(super) pose: Pose,
    pub(super) feedback: Feedback,
}

/// What a recall says.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Recalled {
    lane: u32,
    episode: u64,
    pub(super) step: u32,
    /// View, action and feedback of the last steps.
    pub(super) window: Vec<(FrameId, Option<Action>, Feedback)>,
    /// View and action of the remembered segment; empty without one.
    pub(super) segment: Vec<(FrameId, Option<Action>)>,
    pub(super) distance: f32,
    /// What is supplied beside them, in order.
    pub(super) documents: Vec<DocumentId>,
}

impl Recalled {
    /// Reads a message, which is large and should not be copied.
    pub(super) fn read(message: &Recall) -> Result<Self, BadMessage> {
        let &Recall { lane, step, episode, distance, .. } = message;
        let count = |what, count: u32, most: usize| {
            let fits = usize::try_from(count).ok().filter(|&count| count <= most);
            fits.ok_or(BadMessage::Count { lane, step, what, count, most })
        };
        let window = &message.window[..count("past steps", message.window_len, MAX_WINDOW)?];
        let segment =
            &message.segment[..count("remembered views", message.segment_len, MAX_SEGMENT)?];
        let documents =
            &message.documents[..count("documents", message.documents_len, MAX_DOCUMENTS)?];
        let past = |past: &PastStep| {
            Ok((past.frame, action(past.action)?, Feedback::try_from(past.feedback)?))
        };
        let remembered = |view: &SegmentStep| Ok((view.frame, action(view.action)?));
        let bad = bad_value(RECALL, lane, step);
        Ok(Self {
            lane,
            episode,
            step,
            window: window.iter().map(past).collect::<Result<_, _>>().map_err(&bad)?,
            segment: segment.iter().map(remembered).collect::<Result<_, _>>().map_err(&bad)?,
            distance,
            documents: documents.to_vec(),
        })
    }
}

/// The running episode of a lane, and what has come for its current step.
#[derive(Debug, Default)]
pub(super) struct Lane {
    pub(super) episode: u64,
    pub(super) seed: u64,
    pub(super) repeat: u32,
    pub(super) instruction: String,
    pub(super) starts_as_demonstrated: bool,
    running: bool,
    observed: Option<Observed>,
    recalled: Option<Recalled>,
}

/// A step that has everything it needs.
#[derive(Debug)]
pub(super) struct Ready {
    pub(super) lane: u32,
    pub(super) observed: Observed,
    pub(super) recalled: Recalled,
}

/// All lanes of a run.
#[derive(Debug)]
pub(super) struct Join {
    lanes: Vec<Lane>,
}

impl Join {
    pub(super) fn new(lanes: u32) -> Self {
        Self { lanes: (0..lanes).map(|_| Lane::default()).collect() }
    }

    pub(super) fn lane(&self, lane: u32) -> &Lane {
        &self.lanes[lane as usize]
    }

    /// A new episode for a lane; whatever the lane had is dropped.
    pub(super) fn config(&mut self, config: &PolicyEpisodeConfig) -> Result<(), BadMessage> {
        const MESSAGE: &str = "policy brief";
        let lane = self.lane_mut(MESSAGE, config.lane)?;
        let instruction = read_text(&config.instruction, config.instruction_len)
            .map_err(bad_value(MESSAGE, config.lane, 0))?;
        *lane = Lane {
            episode: config.episode,
            seed: config.seed,
            repeat: config.repeat,
            instruction: instruction.to_owned(),
            starts_as_demonstrated: config.starts_as_demonstrated != 0,
            running: true,
            observed: None,
            recalled: None,
        };
        Ok(())
    }

    /// What is true after a step. One that comes late, for an episode that is over, is dropped.
    pub(super) fn observation(&mut self, message: &Observation) -> Result<(), BadMessage> {
        const MESSAGE: &str = "observation";
        let &Observation { lane: number, step, .. } = message;
        let lane = self.lane_mut(MESSAGE, number)?;
        if !lane.running || lane.episode != message.episode {
            return Ok(());
        }
        if message.last != 0 {
            *lane = Lane::default();
            return Ok(());
        }
        let bad = bad_value(MESSAGE, number, step);
        if message.frame == NO_FRAME {
            return Err(BadMessage::NoFrame { lane: number, step });
        }
        lane.observed = Some(Observed {
            step,
            frame: message.frame,
            pose: message.pose.try_into().map_err(&bad)?,
            feedback: message.feedback.try_into().map_err(&bad)?,
        });
        Ok(())
    }

    /// What memory gives for a step. Late ones are dropped.
    pub(super) fn recall(&mut self, recalled: Recalled) -> Result<(), BadMessage> {
        let lane = self.lane_mut(RECALL, recalled.lane)?;
        if lane.running && lane.episode == recalled.episode {
            lane.recalled = Some(recalled);
        }
        Ok(())
    }

    /// Takes every step that has its observation and its recall, by lane.
    pub(super) fn take_ready(&mut self) -> Vec<Ready> {
        let mut ready = Vec::new();
        for (number, lane) in self.lanes.iter_mut().enumerate() {
            if let (Some(observed), Some(recalled)) = (lane.observed, &mut lane.recalled)
                && observed.step == recalled.step
            {
                let recalled = std::mem::take(recalled);
                (lane.observed, lane.recalled) = (None, None);
                ready.push(Ready { lane: number as u32, observed, recalled });
            }
        }
        ready
    }

    /// Whether a recall is here whose observation is not: that is being delivered to one receiver after the other,
    /// and its sender wakes nobody but the memory.
    pub(super) fn is_half(&self) -> bool {
        self.lanes.iter().any(|lane| lane.recalled.is_some())
    }

    /// Whether `ticket` is of an episode that runs.
    pub(super) fn is_running(&self, ticket: RequestId) -> bool {
        let lane = self.lanes.get(ticket.lane as usize);
        lane.is_some_and(|lane| lane.running && lane.episode == ticket.episode)
    }

    fn lane_mut(&mut self, message: &'static str, lane: u32) -> Result<&mut Lane, BadMessage> {
        let lanes = self.lanes.len();
        self.lanes.get_mut(lane as usize).ok_or(BadMessage::Lane { message, lane, lanes })
    }
}

fn action(code: u8) -> Result<Option<Action>, UnknownCode> {
    if code == NO_ACTION { Ok(None) } else { Action::try_from(code).map(Some) }
}

fn bad_value(message: &'static str, lane: u32, step: u32) -> impl Fn(UnknownCode) -> BadMessage {
    move |problem| BadMessage::Value { message, lane, step, problem }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use shm_types::message::write_text;

    use super::*;

    fn config(lane: u32, episode: u64) -> PolicyEpisodeConfig {
        let mut config = PolicyEpisodeConfig { lane, episode, ..Zeroable::zeroed() };
        config.instruction_len = write_text(&mut config.instruction, "Find a blue barrel.");
        config
    }

    fn observation(lane: u32, episode: u64, step: u32) -> Observation {
        Observation { lane, episode, step, frame: 7, ..Zeroable::zeroed() }
    }

    fn recall(lane: u32, episode: u64, step: u32) -> Recall {
        Recall { lane, episode, step, ..Zeroable::zeroed() }
    }

    fn recalled(join: &mut Join, message: &Recall) -> Result<(), BadMessage> {
        join.recall(Recalled::read(message)?)
    }

    /// Two lanes; the second one walks episode 5.
    fn join() -> Join {
        let mut join = Join::new(2);
        join.config(&config(1, 5)).unwrap();
        join
    }

    fn ready(join: &mut Join) -> Vec<(u32, u32)> {
        join.take_ready().iter().map(|ready| (ready.lane, ready.observed.step)).collect()
    }

    #[test]
    fn a_step_is_complete_with_observation_and_recall_in_either_order() {
        let mut join = join();
        join.observation(&observation(1, 5, 0)).unwrap();
        assert_eq!(ready(&mut join), []);
        recalled(&mut join, &recall(1, 5, 0)).unwrap();
        assert_eq!(ready(&mut join), [(1, 0)]);
        assert_eq!(ready(&mut join), [], "it is taken once");
        recalled(&mut join, &recall(1, 5, 1)).unwrap();
        join.observation(&observation(1, 5, 1)).unwrap();
        assert_eq!(ready(&mut join), [(1, 1)]);
        assert_eq!(join.lane(1).instruction, "Find a blue barrel.");
    }

    #[test]
    fn what_belongs_to_another_step_or_episode_never_joins() {
        let mut join = join();
        join.observation(&observation(1, 5, 3)).unwrap();
        recalled(&mut join, &recall(1, 5, 2)).unwrap();
        recalled(&mut join, &recall(1, 4, 3)).unwrap();
        join.observation(&observation(0, 0, 0)).unwrap();
        recalled(&mut join, &recall(0, 0, 0)).unwrap();
        assert_eq!(ready(&mut join), []);
        join.config(&config(1, 6)).unwrap();
        recalled(&mut join, &recall(1, 6, 3)).unwrap();
        assert_eq!(ready(&mut join), [], "a new episode starts with nothing");
    }

    #[test]
    fn the_last_observation_ends_the_episode() {
        let mut join = join();
        let last = Observation { last: 1, frame: NO_FRAME, ..observation(1, 5, 9) };
        join.observation(&last).unwrap();
        join.observation(&observation(1, 5, 9)).unwrap();
        recalled(&mut join, &recall(1, 5, 9)).unwrap();
        assert_eq!(ready(&mut join), []);
    }

    #[test]
    fn bad_messages_say_what_is_wrong_and_change_nothing() {
        let mut join = join();
        let mut no_text = config(1, 6);
        no_text.instruction_len = 4000;
        let mut bad_pose = observation(1, 5, 2);
        bad_pose.pose.0[2] = 9;
        let mut bad_action = Recall { segment_len: 1, ..recall(1, 5, 2) };
        bad_action.segment[0].action = 77;
        let mut bad_feedback = Recall { window_len: 1, ..recall(1, 5, 2) };
        bad_feedback.window[0].feedback = 5;
        let errors = [
            join.config(&config(2, 6)),
            join.config(&no_text),
            join.observation(&bad_pose),
            join.observation(&Observation { feedback: 8, ..observation(1, 5, 2) }),
            join.observation(&Observation { frame: NO_FRAME, ..observation(1, 5, 2) }),
            recalled(&mut join, &Recall { window_len: 33, ..recall(1, 5, 2) }),
            recalled(&mut join, &Recall { segment_len: 1 << 31, ..recall(1, 5, 2) }),
            recalled(&mut join, &bad_action),
            recalled(&mut join, &bad_feedback),
            recalled(&mut join, &recall(u32::MAX, 5, 2)),
        ];
        let texts: Vec<_> = errors.into_iter().map(|e| e.unwrap_err().to_string()).collect();
        insta::assert_snapshot!(texts.join("\n"), @r"
        policy brief for lane 2: the run has 2
        policy brief for lane 1, step 0: a text of 4000 bytes is not UTF-8 that fits
        observation for lane 1, step 2: 9 is not a heading (0 N, 1 E, 2 S, 3 W)
        observation for lane 1, step 2: 8 is not a feedback (0 to 4)
        observation for lane 1, step 2: it names no frame
        recall for lane 1, step 2: 33 past steps, at most 32 fit
        recall for lane 1, step 2: 2147483648 remembered views, at most 32 fit
        recall for lane 1, step 2: 77 is not an action (0 to 6)
        recall for lane 1, step 2: 5 is not a feedback (0 to 4)
        recall for lane 4294967295: the run has 2
        ");
        assert_eq!(join.lane(1).episode, 5);
        assert_eq!(ready(&mut join), []);
    }
}
