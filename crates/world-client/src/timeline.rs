//! An episode step by step.

use anyhow::Result;
use case_book::act::{ActedEpisode, ActedReference, EpisodeParts, EpisodeScenery};
use case_book::{FailureFact, WorldFacts};
use domain::{FeedbackCode, State};
use run_log::EpisodeRecord;
use scores::{FailurePoints, Successes, failure_of, steps_alike};
use serde::Serialize;

use crate::frames::ViewKey;
use crate::world::RunWorld;

/// A recorded episode, acted out by its world. `show`, pages, tables, recordings and the Python package are views of it.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeTimeline<'a> {
    /// What the log has.
    pub record: &'a EpisodeRecord,
    /// The instruction.
    pub instruction: String,
    /// The world variant in which it takes place.
    pub variant: u32,
    /// The begin, and the moment after each step.
    pub steps: Vec<TimelineStep<'a>>,
    /// What happened beside the moves, in the order of steps.
    pub events: Vec<EpisodeEvent>,
    /// Why it failed; `None` for a success.
    pub failure: Option<FailureFact>,
    /// Since when it failed; `None` for a success.
    pub points: Option<FailurePoints>,
    /// Where it first acts unlike the reference: for a failure without a success to compare with, if the reference was asked for.
    pub unlike_reference_at: Option<u32>,
    /// What the expert does, if it was asked for and there is something.
    pub reference: Option<ActedReference>,
    /// What a map shows, if it was asked for.
    pub scenery: Option<EpisodeScenery>,
}

/// A moment of an episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimelineStep<'a> {
    /// Steps taken before.
    #[serde(skip)]
    pub step: u32,
    /// The agent's state.
    #[serde(skip)]
    pub state: State,
    /// The state in words, with commas between its numbers.
    #[serde(rename = "state")]
    pub state_text: String,
    /// The feedback on the last action, in words.
    pub feedback: String,
    /// The same, as a code.
    #[serde(skip)]
    pub feedback_code: FeedbackCode,
    /// What the agent did next, in words; `None` at the end and where the answer could not be read.
    pub action: Option<String>,
    /// The sub-goals met so far.
    #[serde(skip)]
    pub sub_goals: usize,
    /// The retrieval, as the log writes it: `o12`, `t03-07:o4`, `-`. `None` where nothing is retrieved.
    pub retrieved: Option<&'a str>,
    /// The distances, as the log writes them. `None` where none is known.
    pub distances: Option<&'a str>,
    /// The view that the policy was shown.
    #[serde(skip)]
    pub view: ViewKey,
}

impl<'a> EpisodeTimeline<'a> {
    /// The episode of `record`, which took place in `world`, with these parts. A failure is compared with `successes` of its run.
    ///
    /// # Errors
    /// When it does not fit the world.
    pub fn new(
        world: &RunWorld,
        record: &'a EpisodeRecord,
        successes: &Successes,
        parts: EpisodeParts,
    ) -> Result<Self> {
        let variant = world.variant(record)?;
        let acted = world.act(record, parts)?;
        let views = world.seen_in(record, variant, &acted.states)?;
        let points = FailurePoints::of(record, successes);
        let (_, case) = world.case(record)?;
        let acted = ActedEpisode {
            instruction: case.instruction_with(record.mismatch).to_owned(),
            ..acted
        };
        Ok(Self::of(record, &world.description().world, variant, (acted, points), views))
    }

    fn of(
        record: &'a EpisodeRecord,
        world: &WorldFacts,
        variant: u32,
        (acted, points): (ActedEpisode, Option<FailurePoints>),
        views: Vec<ViewKey>,
    ) -> Self {
        let words =
            |column: &'a Option<String>| column.as_deref().unwrap_or_default().split_whitespace();
        let (mut retrieved, mut distances) = (words(&record.retrieved), words(&record.distances));
        let mut actions = record.actions.chars();
        let failure = failure_of(record, world);
        let declaration = &world.declaration;
        let is_alone = points.as_ref().is_some_and(|points| points.divergence.is_none());
        let unlike_reference_at = acted.reference.as_ref().filter(|_| is_alone).map(|reference| {
            let actions = reference.actions.iter().copied().map(Some);
            steps_alike(&record.actions, &declaration.letters(actions))
        });
        let mut events = events(record, world, failure.as_ref(), &acted);
        if let Some(points) = &points {
            events.extend(point_events(points, unlike_reference_at));
            events.sort_by_key(|event| event.step);
        }
        let in_words = |action| declaration.action_words(action).to_owned();
        let moments = (0..).zip(acted.states).zip(acted.feedback).zip(views);
        let steps = moments.map(|(((step, state), feedback), view)| TimelineStep {
            step,
            state,
            state_text: declaration.state_text(&state),
            feedback: declaration.feedback_sentence(feedback).to_owned(),
            feedback_code: feedback,
            action: actions.next().and_then(|letter| declaration.action_of(letter)).map(in_words),
            sub_goals: record.sub_goals.iter().filter(|met| **met <= step).count(),
            retrieved: retrieved.next(),
            distances: distances.next(),
            view,
        });
        Self {
            record,
            variant,
            steps: steps.collect(),
            events,
            failure,
            points,
            unlike_reference_at,
            instruction: acted.instruction,
            reference: acted.reference,
            scenery: acted.scenery,
        }
    }

    /// The moments at which the agent decided: all but the end.
    pub fn decisions(&self) -> &[TimelineStep<'a>] {
        &self.steps[..self.steps.len() - 1]
    }
}

/// How much attention an event deserves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum EventLevel {
    /// The episode goes on as it should.
    Info,
    /// Something went wrong.
    Warning,
    /// The episode fails.
    Error,
}

/// An event of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EpisodeEvent {
    /// Steps taken when it happened.
    pub step: u32,
    /// How much attention it deserves.
    pub level: EventLevel,
    /// It in words.
    pub words: String,
}

/// The events of an episode in `world` with this failure, which was acted out, in the order of steps.
fn events(
    record: &EpisodeRecord,
    world: &WorldFacts,
    failure: Option<&FailureFact>,
    acted: &ActedEpisode,
) -> Vec<EpisodeEvent> {
    let declaration = &world.declaration;
    let mut events = Vec::new();
    let mut add = |step: u32, level: EventLevel, words: &str| {
        events.push(EpisodeEvent { step, level, words: words.to_owned() });
    };
    for (step, letter) in (1..).zip(record.actions.chars()) {
        if declaration.action_of(letter).is_none() {
            add(step, EventLevel::Warning, "no action could be read in the answer");
        }
    }
    let states = acted.states.windows(2).zip(acted.feedback.iter().skip(1));
    for (step, (states, feedback)) in (1..).zip(states) {
        if states[0] == states[1] && *feedback != declaration.not_understood() {
            add(step, EventLevel::Warning, declaration.feedback_sentence(*feedback));
        }
    }
    if let Some(step) = record.conflict_at {
        add(step, EventLevel::Warning, "ran into what blocks the way");
    }
    for (met, &step) in (1..).zip(&record.sub_goals) {
        add(step, EventLevel::Info, &format!("sub-goal {met} of {} is met", record.required));
    }
    match failure {
        None => add(record.steps, EventLevel::Info, "the task is complete"),
        Some(FailureFact { kind, step }) => {
            let words = format!("failed: {kind} ({})", world.failure_words(kind));
            add(*step, EventLevel::Error, &words);
        }
    }
    events.sort_by_key(|event| event.step);
    events
}

/// The points since when an episode failed, as events. Its last progress is the last sub-goal that is met.
fn point_events(points: &FailurePoints, unlike_reference_at: Option<u32>) -> Vec<EpisodeEvent> {
    let warning = |step, words| EpisodeEvent { step, level: EventLevel::Warning, words };
    let loops = points.loops.iter().flatten().map(|found| {
        let until = found.to;
        warning(found.from, format!("in a loop from here until step {until}"))
    });
    let unlike_success = points.divergence.iter().map(|found| {
        let success = &found.success;
        warning(found.step, format!("acts from here unlike {success}, which succeeded"))
    });
    let unlike_reference = unlike_reference_at.into_iter().map(|step| {
        warning(
            step,
            "acts from here unlike the reference; no episode like it succeeded".to_owned(),
        )
    });
    unlike_success.chain(unlike_reference).chain(loops).collect()
}

#[cfg(test)]
mod tests {
    use case_book::LoopFact;
    use rigs::records::{record, tell_failure, world};
    use scores::Divergence;

    use super::*;

    fn acted() -> ActedEpisode {
        ActedEpisode {
            task: 1,
            instruction: String::new(),
            states: Vec::new(),
            feedback: Vec::new(),
            sub_goals: Vec::new(),
            required: 2,
            facts: None,
            conflict_at: None,
            reference: None,
            scenery: None,
        }
    }

    #[test]
    fn events_are_in_the_order_of_steps() {
        let mut one = record("a", false);
        (one.actions, one.steps, one.required) = ("f?ff".to_owned(), 4, 2);
        one.conflict_at = Some(3);
        tell_failure(&mut one, "blocked", 3);
        one.sub_goals = vec![1];
        let moved = ActedEpisode {
            states: [0.0, 1.0, 1.0, 1.0, 2.0]
                .map(|row| State::new(&[0.0, row, 0.0]).unwrap())
                .to_vec(),
            feedback: [0, 1, 4, 3, 1].map(FeedbackCode).to_vec(),
            ..acted()
        };
        let failure = failure_of(&one, &world());
        let shown: Vec<String> = events(&one, &world(), failure.as_ref(), &moved)
            .into_iter()
            .map(|EpisodeEvent { step, level, words }| format!("{step} {level:?} {words}"))
            .collect();
        insta::assert_snapshot!(shown.join("\n"), @"
        1 Info sub-goal 1 of 2 is met
        2 Warning no action could be read in the answer
        3 Warning Something blocks the way: you did not move.
        3 Warning ran into what blocks the way
        3 Error failed: blocked (tried to enter a closed cell, then met no requirement and hardly went anywhere new)
        ");
        let points = FailurePoints {
            last_progress: 1,
            loops: Some(vec![LoopFact { from: 22, to: 80 }]),
            divergence: Some(Divergence { step: 4, success: "KEY".to_owned() }),
        };
        let lone = FailurePoints { loops: None, divergence: None, ..points.clone() };
        let shown = point_events(&points, None).into_iter().chain(point_events(&lone, Some(0)));
        let shown: Vec<String> = shown.map(|one| format!("{} {}", one.step, one.words)).collect();
        insta::assert_snapshot!(shown.join("\n"), @"
        4 acts from here unlike KEY, which succeeded
        22 in a loop from here until step 80
        0 acts from here unlike the reference; no episode like it succeeded
        ");
        let last = EpisodeEvent {
            step: 10,
            level: EventLevel::Info,
            words: "the task is complete".to_owned(),
        };
        assert_eq!(events(&record("a", true), &world(), None, &acted()).pop(), Some(last));
    }
}
