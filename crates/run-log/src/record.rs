//! The lines of a run folder's journals.
//!
//! What an [`EpisodeRecord`] holds follows from settings, seed and frames alone: runs with another number
//! of lanes, or killed and resumed, give the same lines in another order. Everything else about an episode
//! goes into its [`EpisodeTimings`].

use std::collections::BTreeMap;

use case_book::SharedFacts;
use domain::names::named;
use domain::{Arm, ExternalName, FeedbackLevel, MemoryKind, Outcome, SEQUENCE_ENDED, StreamOrder};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use conditions::key::{EpisodeKey, StreamPlace};
use conditions::{
    Condition, Demonstrations, Hint, Mismatch, Route, SegmentContent, Start, Variation, is_default,
    is_standard_window, standard_window,
};

named! {
    /// How an episode ended.
    Ending, "ending" {
        /// The task is done.
        Complete = "complete",
        /// T_max steps were taken without completing it.
        OutOfSteps = "out-of-steps",
        /// The world ended it before: the task could no longer be completed.
        Failed = "failed",
    }
}

/// One finished episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeRecord {
    /// The [`EpisodeKey`] as it is written: unique in the log.
    pub key: String,
    /// The memory.
    pub memory: MemoryKind,
    /// The start.
    pub start: Start,
    /// The route.
    pub route: Route,
    /// The demonstrations.
    pub demonstrations: Demonstrations,
    /// Past steps that the policy was shown, h. Absent where it is the standard, 6.
    #[serde(skip_serializing_if = "is_standard_window", default = "standard_window")]
    pub window: u32,
    /// What retrieved segments held. Absent where it is the standard, `actions`.
    #[serde(skip_serializing_if = "is_default", default)]
    pub segment: SegmentContent,
    /// Whether the original-start hint was given where it is true. Absent where it is the standard, `on`.
    #[serde(skip_serializing_if = "is_default", default)]
    pub hint: Hint,
    /// What the episode differs in from the demonstrations, beside start and route. Absent where it is nothing, `none`.
    #[serde(skip_serializing_if = "is_default", default)]
    pub mismatch: Mismatch,
    /// What the memory was built from, and whether it changed. Absent where it is the standard, `frozen`.
    #[serde(skip_serializing_if = "is_default", default)]
    pub arm: Arm,
    /// The repetition, from 1.
    pub run: u32,
    /// The case's id.
    pub case: String,
    /// The task's number, 1 to 10.
    pub task: u8,
    /// The episode's seed.
    pub seed: u64,
    /// How it ended; `complete` is s_i = 1.
    pub ending: Ending,
    /// Steps taken, p_i.
    pub steps: u32,
    /// Length of the reference, l_i.
    pub reference: u32,
    /// The actions, a letter of the world for each step, `?` for an unreadable answer.
    pub actions: String,
    /// Hashes of the state of the world at its begin and at its end, as the world defines them, in hexadecimal digits; absent
    /// in a record of an earlier version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_hashes: Option<[String; 2]>,
    /// For each sub-goal, in order of completion: the step at which it was completed.
    pub sub_goals: Vec<u32>,
    /// Sub-goals of the whole task; a return is the last. The episode is complete when `sub_goals` has as many.
    pub required: u32,
    /// On a blocked route: the first step, from 1, at which the agent ran into what the route's variant changed. Absent when it
    /// did not, and elsewhere.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub conflict_at: Option<u32>,
    /// Requests to the policy. Absent where there was no policy to ask (the expert).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub requests: Option<u32>,
    /// Images in all of them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub images: Option<u64>,
    /// Images that the policy was not shown, because they were more than its budget. Absent when there were none.
    #[serde(skip_serializing_if = "is_none", default)]
    pub images_dropped: u64,
    /// Tokens of all prompts. Absent when any was not measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub prompt_tokens: Option<u64>,
    /// Tokens of all completions. Absent when any was not measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub completion_tokens: Option<u64>,
    /// Tokens of all prompts that are injected memory, an estimate. Absent when unknown for any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub memory_tokens: Option<u64>,
    /// Answers in which no action could be read, by kind.
    #[serde(skip_serializing_if = "Unread::is_none", default)]
    pub unread: Unread,
    /// On a blocked route: what the closed passage does to demonstrations. Absent elsewhere.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub blocked: Option<BlockedRecord>,
    /// Where memory's answer came from, one word a request: the demonstration's letter (`o` original, `p` opposite, `n`
    /// nearby, `d` distant, `a` after the event, `w` elsewhere) and the first step in it, for example `o12`; with the case
    /// before it when it is another's (`t03-07:o12`). `e4:3` is step 3 of the episode at position 4 of the sequence; `-` is no
    /// match. Several sources are joined by `+`: `o12+n3`. Absent when nothing was ever retrieved.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub retrieved: Option<String>,
    /// The distance of each source of [`Self::retrieved`], in the same form: four decimals, `-` for one that the memory does
    /// not tell, for example `0.0132+-`. Absent when it tells none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub distances: Option<String>,
    /// Mean distance of the first match of each request that has one, rounded to millionths: the cosine distance for
    /// episodic memory, whatever an external memory says.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub distance: Option<f64>,
    /// Items that memory wanted to supply and that exceeded its budgets. Absent when there were none.
    #[serde(skip_serializing_if = "is_none", default)]
    pub memory_items_dropped: u64,
    /// Images in them. Absent when there were none.
    #[serde(skip_serializing_if = "is_none", default)]
    pub memory_images_dropped: u64,
    /// Bytes of text in them. Absent when there were none.
    #[serde(skip_serializing_if = "is_none", default)]
    pub memory_text_dropped: u64,
    /// Where the episode stands in its stream, and what its memory knew. Absent outside of streams.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stream: Option<StreamRecord>,
    /// What the world tells of the episode: a JSON object that only the world and its own scores understand, but for the
    /// [`SharedFacts`] that it may have.
    pub world: Map<String, Value>,
}

/// What a record of an episode on a blocked route holds beside the rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockedRecord {
    /// Whether the closed passage has invalidated the case's original demonstration: replayed on this route, it does not
    /// complete the task.
    pub invalidated: bool,
    /// Sources that memory retrieved.
    pub retrievals: u32,
    /// Those that are stale, as in [`StreamRecord::stale`].
    pub stale: u32,
}

/// What a record of an episode in a stream holds beside the rest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamRecord {
    /// The stream.
    pub stream: u32,
    /// The order of its blocks.
    pub order: StreamOrder,
    /// The position of the episode in its sequence, from 0.
    pub position: u32,
    /// The block whose case it is, as drawn, from 0. Block 0 is the unchanged world.
    pub block: u32,
    /// The place of that block in this order, from 0.
    pub place: u32,
    /// Blocks that were learned before: i of `R[i][j]`.
    pub after: u32,
    /// The learning round in the block, from 1. Absent for an evaluation, which changes no memory.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub round: Option<u32>,
    /// What a memory that learns is told at the end of the episode.
    pub feedback: FeedbackLevel,
    /// The state of the world: an index into the `worlds` of `streams.json`.
    pub world: u32,
    /// Whether events have invalidated the case's original demonstration: replayed in this world, it does not complete
    /// the task.
    pub invalidated: bool,
    /// The actions of the reference, a letter for each.
    pub reference_actions: String,
    /// Sources that memory retrieved.
    pub retrievals: u32,
    /// Those that are stale: the source completes its task in the world in which it was recorded, and does not in this
    /// one.
    pub stale: u32,
    /// The snapshot of the memory after the episode, in hexadecimal digits. Only for a memory that learned from it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub snapshot: Option<String>,
    /// The size of the memory's store at the end of the episode, in bytes. Absent if it told none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub store_bytes: Option<u64>,
}

impl StreamRecord {
    /// The place that the episode's key names.
    pub fn key_place(&self) -> StreamPlace {
        let Self { stream, order, position, .. } = *self;
        StreamPlace { stream, order, position }
    }

    /// Whether it is a learning episode, as opposed to an evaluation.
    pub fn learns(&self) -> bool {
        self.round.is_some()
    }
}

impl EpisodeRecord {
    /// The condition.
    pub fn condition(&self) -> Condition {
        Condition {
            memory: self.memory,
            start: self.start,
            route: self.route,
            demonstrations: self.demonstrations,
            variation: Variation { window: self.window, segment: self.segment, hint: self.hint },
            mismatch: self.mismatch,
            arm: self.arm,
        }
    }

    /// What every world may tell of an episode. The default if it is told in another form, which no record that was
    /// [checked](Self::check) has.
    pub fn shared_facts(&self) -> SharedFacts {
        SharedFacts::of(&self.world).unwrap_or_default()
    }

    /// On a blocked route: whether the agent ran into what the route's variant changed, b_i. `None` elsewhere.
    pub fn had_conflict(&self) -> Option<bool> {
        (self.route == Route::Blocked).then_some(self.conflict_at.is_some())
    }

    /// The key that its fields make.
    pub fn own_key(&self) -> EpisodeKey {
        EpisodeKey {
            condition: self.condition(),
            run: self.run,
            place: self.stream.as_ref().map(StreamRecord::key_place),
            case: self.case.clone(),
        }
    }

    /// Whether the task was completed, s_i.
    pub fn is_success(&self) -> bool {
        self.ending == Ending::Complete
    }
}

/// Counts of answers in which no action could be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Unread {
    /// The answer has text, but no action.
    pub unreadable: u32,
    /// The answer was empty.
    pub empty: u32,
    /// The model refused.
    pub refused: u32,
    /// The answer was cut off at the bound on its tokens, before it named an action. Absent when there were none, and in
    /// earlier logs, which count such answers as unreadable.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub cut_off: u32,
}

impl Unread {
    /// Whether every answer was read.
    pub fn is_none(&self) -> bool {
        self.total() == 0
    }

    /// All of them.
    pub fn total(&self) -> u32 {
        let Self { unreadable, empty, refused, cut_off } = *self;
        [unreadable, empty, refused, cut_off].into_iter().fold(0, u32::saturating_add)
    }

    /// Counts an answer with this outcome.
    pub fn add(&mut self, outcome: Outcome) {
        let count = match outcome {
            Outcome::Acted => return,
            Outcome::Unreadable => &mut self.unreadable,
            Outcome::Empty => &mut self.empty,
            Outcome::Refused => &mut self.refused,
            Outcome::CutOff => &mut self.cut_off,
        };
        *count = count.saturating_add(1);
    }
}

/// Times of an episode; they depend on machine, lanes and chance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeTimings {
    /// The episode's key.
    pub key: String,
    /// The session it ended in, from 1.
    pub session: u32,
    /// The generation of processes in that session. 0 in logs of earlier versions.
    #[serde(default)]
    pub generation: u32,
    /// The episode id in that session, by which [`prompts`](domain::prompt_log) name it. 0 in logs of earlier versions.
    #[serde(default, alias = "ticket")]
    pub episode: u64,
    /// The number of the attempt, from 1.
    pub attempt: u32,
    /// The lane it ran in.
    pub lane: u32,
    /// When it was started, in nanoseconds since the session began.
    pub started_ns: u64,
    /// When it ended, likewise.
    pub ended_ns: u64,
    /// Steps taken.
    pub steps: u32,
    /// Invalid messages about it.
    #[serde(skip_serializing_if = "is_zero", default, alias = "rubbish")]
    pub invalid_messages: u32,
    /// Where the time went, summed over its steps.
    pub stages: Stages,
    /// What memory supplied, summed over its steps. Absent where no memory was asked, and in earlier logs.
    #[serde(skip_serializing_if = "RecallTotals::is_none", default)]
    pub recalls: RecallTotals,
}

/// What memory supplied in an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecallTotals {
    /// Requests that memory answered.
    pub requests: u32,
    /// Items that it supplied.
    pub items: u64,
    /// Images in them.
    pub images: u64,
    /// Bytes of text in them.
    pub text: u64,
    /// The largest size that it told for its store, in bytes. Absent if it told none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub store_bytes: Option<u64>,
    /// Nanoseconds that an external memory computed, by its own clock. Absent for a built-in one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub method_ns: Option<u64>,
    /// Nanoseconds from the query to the answer of an external memory. Absent for a built-in one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub answer_ns: Option<u64>,
    /// Tokens of its own requests to a model. Absent if it told none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub tokens: Option<u64>,
}

impl RecallTotals {
    /// Whether memory was never asked.
    pub fn is_none(&self) -> bool {
        self.requests == 0
    }
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

fn is_none(count: &u64) -> bool {
    *count == 0
}

/// One request to a model, of a finished episode or of an attempt that was given up. Its cost was spent either way,
/// unless it was `replayed`. A count is absent where it is unknown.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequestRecord {
    /// The episode's key.
    pub key: String,
    /// Steps taken before.
    pub step: u32,
    /// The session, from 1.
    pub session: u32,
    /// The outcome of the answer.
    #[serde(with = "outcome_word")]
    pub outcome: Outcome,
    /// Requests that were sent for it, including failed ones.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "measured")]
    pub attempts: Option<u32>,
    /// Whether the reply came from the response cache: it cost nothing this time.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub replayed: bool,
    /// Microseconds from the sending (of the last attempt) to the decision. Absent where nothing was sent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub latency_us: Option<u64>,
    /// Images that the request held.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "measured")]
    pub images_asked: Option<u32>,
    /// Images that the policy was shown.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "measured")]
    pub images: Option<u32>,
    /// Tokens of the prompt.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub prompt_tokens: Option<u32>,
    /// Tokens of the answer.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server took from its own cache.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are injected memory, an estimate.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub memory_tokens: Option<u32>,
    /// Tokens of the prompt that a server can reuse, since the previous prompt of the episode began with them too; an
    /// estimate.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reusable_tokens: Option<u32>,
    /// Why the reply ended, in the server's terms, such as `stop` or `length`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finish_reason: Option<String>,
    /// Whether the model reasoned before it answered, as far as the reply shows.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reasoned: Option<bool>,
    /// The model that the reply names.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model: Option<String>,
}

/// Reads a count. Earlier versions wrote the wire's mark for "not measured", the largest number, into the log.
fn measured<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    Ok(Option::<u32>::deserialize(from)?.filter(|count| *count != u32::MAX))
}

/// Writes an [`Outcome`] as its word.
mod outcome_word {
    use domain::Outcome;
    use serde::de::{Deserialize, Deserializer, Error};
    use serde::ser::Serializer;

    pub(super) fn serialize<S: Serializer>(outcome: &Outcome, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(outcome.word())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Outcome, D::Error> {
        let word = String::deserialize(from)?;
        let outcome = Outcome::ALL.iter().find(|outcome| outcome.word() == word);
        outcome.copied().ok_or_else(|| D::Error::custom(format!("unknown outcome `{word}`")))
    }
}

impl Stages {
    /// Nanoseconds of a recall: embedding, search and assembly.
    pub const fn recalling(&self) -> u64 {
        self.embed.saturating_add(self.search).saturating_add(self.assemble)
    }
}

/// Declares the stages of a step, in order.
macro_rules! stages {
    ($($(#[$attribute:meta])* $stage:ident,)*) => {
        /// Nanoseconds in each stage of a step, in the order of the stages: together the time from a command to the
        /// next one. Several lanes are in different stages at once, and waiting for a busy process counts for the
        /// stage that waits, so with many lanes the sum is a step's latency and not its cost.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Stages { $($(#[$attribute])* pub $stage: u64,)* }

        impl Stages {
            /// The names, in order.
            pub const NAMES: [&'static str; [$(stringify!($stage)),*].len()] =
                [$(stringify!($stage)),*];

            /// The values, in the order of [`Stages::NAMES`].
            pub const fn values(&self) -> [u64; Self::NAMES.len()] {
                [$(self.$stage),*]
            }
        }

        impl std::ops::AddAssign for Stages {
            fn add_assign(&mut self, other: Self) {
                $(self.$stage = self.$stage.saturating_add(other.$stage);)*
            }
        }
    };
}

stages! {
    /// From sending the command until the simulator received it.
    command,
    /// Applying the dynamics.
    dynamics,
    /// Until the view was resident.
    render,
    /// Until the observation was published.
    #[serde(default)]
    publish,
    /// Until memory received it.
    observation,
    /// Until the view's embedding was known.
    embed,
    /// Until the nearest remembered view was found.
    search,
    /// Until the recall was put together.
    #[serde(default)]
    assemble,
    /// Until the policy had observation and recall.
    recall,
    /// Until it began to decide.
    queue,
    /// Until it had decided.
    decide,
    /// Until the orchestrator received the decision.
    decision,
}

/// An episode that was given up because of a fault of the infrastructure. It is not scored; the same command runs it
/// again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeError {
    /// The episode's key.
    pub key: String,
    /// The session it was given up in.
    pub session: u32,
    /// What happened.
    pub error: String,
}

impl EpisodeError {
    /// Whether the same command does not help: the reason says what to do first.
    pub fn is_final(&self) -> bool {
        self.error.contains(SEQUENCE_ENDED)
    }
}

/// An event of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// The session, from 1: one for each invocation of the command.
    pub session: u32,
    /// Seconds since 1970.
    pub unix_s: u64,
    /// The event.
    #[serde(flatten)]
    pub event: SessionEvent,
}

/// The events of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "event")]
pub enum SessionEvent {
    /// The processes of a generation are ready.
    Ready {
        /// The generation.
        generation: u32,
        /// Lanes.
        lanes: u32,
        /// Frames that may be resident.
        frame_budget: u32,
        /// The facts that each process reported about itself.
        processes: BTreeMap<String, BTreeMap<String, String>>,
    },
    /// A process failed; all are restarted, and the episodes under way run again.
    Failed {
        /// The generation that failed.
        generation: u32,
        /// The process and its failure.
        reason: String,
    },
    /// An external memory takes part no longer.
    Excluded {
        /// The memory.
        memory: ExternalName,
        /// Why.
        reason: String,
    },
    /// The session is over.
    Ended {
        /// Episodes it finished.
        finished: u32,
        /// Episodes it gave up.
        errors: u32,
        /// Why it stopped: complete, or the signal.
        reason: String,
        /// The totals of each process of the last generation, from its shutdown report.
        #[serde(alias = "farewells")]
        shutdown_reports: BTreeMap<String, BTreeMap<String, u64>>,
    },
    /// A process has learned facts about itself or its server since it was ready.
    Learned {
        /// The process.
        process: String,
        /// The facts.
        facts: BTreeMap<String, String>,
    },
}
