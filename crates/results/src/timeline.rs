//! What happened in an episode beside its moves.

use domain::Action;
use serde::Serialize;

use crate::log::EpisodeRecord;
use crate::score::Failure;

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

/// The events of an episode in the order of steps.
pub fn timeline(record: &EpisodeRecord) -> Vec<EpisodeEvent> {
    let mut events = Vec::new();
    let mut add = |step: u32, level: EventLevel, words: &str| {
        events.push(EpisodeEvent { step, level, words: words.to_owned() });
    };
    for (step, letter) in (1..).zip(record.actions.chars()) {
        if Action::from_letter(letter).is_none() {
            add(step, EventLevel::Warning, "no action could be read in the answer");
        }
    }
    for &step in &record.blocked_moves {
        add(step, EventLevel::Warning, "the move was blocked");
    }
    if let Some(step) = record.tried_closed_at {
        add(step, EventLevel::Warning, "tried to enter the closed passage");
    }
    for (met, &step) in (1..).zip(&record.sub_goals) {
        add(step, EventLevel::Info, &format!("sub-goal {met} of {} is met", record.required));
    }
    match Failure::of(record) {
        None => add(record.steps, EventLevel::Info, "the task is complete"),
        Some(failure) => {
            let words = format!("failed: {failure} ({})", failure.meaning());
            add(failure.decided_at(record), EventLevel::Error, &words);
        }
    }
    events.sort_by_key(|event| event.step);
    events
}

#[cfg(test)]
mod tests {
    use crate::log::testing::record;

    use super::*;

    #[test]
    fn events_are_in_the_order_of_steps() {
        let mut one = record("a", false);
        (one.actions, one.steps, one.required) = ("f?ff".to_owned(), 4, 2);
        (one.blocked_moves, one.tried_closed_at) = (vec![3], Some(3));
        one.sub_goals = vec![1];
        let shown: Vec<String> = timeline(&one)
            .into_iter()
            .map(|EpisodeEvent { step, level, words }| format!("{step} {level:?} {words}"))
            .collect();
        insta::assert_snapshot!(shown.join("\n"), @"
        1 Info sub-goal 1 of 2 is met
        2 Warning no action could be read in the answer
        3 Warning the move was blocked
        3 Warning tried to enter the closed passage
        3 Error failed: blocked (tried to enter a closed cell, then met no requirement and hardly went anywhere new)
        ");
        let last = EpisodeEvent {
            step: 10,
            level: EventLevel::Info,
            words: "the task is complete".to_owned(),
        };
        assert_eq!(timeline(&record("a", true)).pop(), Some(last));
    }
}
