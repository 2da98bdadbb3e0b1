//! Whether a model's answers have actions. Answers without one are scored as the model's, so a server that cuts every
//! answer off gives a success rate of 0 %: a reader of the figure has to know.

use std::collections::BTreeMap;

use domain::{Outcome, ReasoningRequest};

use crate::{RequestRecord, RunLog, Unread};
use conditions::settings::ModelSettings;

/// Counts of answers, by what they lack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AnswerCounts {
    /// All answers.
    pub answers: u64,
    /// Those without an action.
    pub unread: Unread,
    /// Those whose reply shows that the model reasoned.
    pub reasoned: u64,
}

impl AnswerCounts {
    /// Counts an answer.
    pub fn add(&mut self, request: &RequestRecord) {
        self.answers += 1;
        self.unread.add(request.outcome);
        self.reasoned += u64::from(request.reasoned == Some(true));
    }

    fn merge(&mut self, other: &Self) {
        let Self { answers, unread, reasoned } = other;
        self.answers += answers;
        self.reasoned += reasoned;
        let sum = &mut self.unread;
        sum.unreadable = sum.unreadable.saturating_add(unread.unreadable);
        sum.empty = sum.empty.saturating_add(unread.empty);
        sum.refused = sum.refused.saturating_add(unread.refused);
        sum.cut_off = sum.cut_off.saturating_add(unread.cut_off);
    }

    /// Why the answers have no action, with counts: `12 were cut off at 30 tokens, 3 are empty`.
    fn reasons(&self, model: Option<&ModelSettings>) -> String {
        let Unread { unreadable, empty, refused, cut_off } = self.unread;
        let bound = match model {
            Some(model) => format!("{} tokens", model.answer_tokens),
            None => "the bound on their tokens".to_owned(),
        };
        let reasons = [
            (cut_off, format!("were cut off at {bound}")),
            (unreadable, "name no action".to_owned()),
            (empty, "are empty".to_owned()),
            (refused, "are refusals".to_owned()),
        ];
        let given = reasons.into_iter().filter(|(count, _)| *count > 0);
        given.map(|(count, reason)| format!("{count} {reason}")).collect::<Vec<_>>().join(", ")
    }

    /// What to do about answers without an action.
    fn advice(&self, model: Option<&ModelSettings>) -> String {
        let mostly_cut_off = u64::from(self.unread.cut_off) * 2 > self.answers;
        let is_asked = model.is_some_and(|model| model.reasoning != ReasoningRequest::Off);
        let advice = match (mostly_cut_off, self.reasoned > 0) {
            (true, _) if is_asked => "The bound counts reasoning too: raise it (--answer-tokens).",
            (true, true) => {
                "The model reasons although it was asked not to: turn reasoning off at the server, or raise the bound \
                 (--answer-tokens)."
            }
            (true, false) => {
                "The model may reason although it was asked not to: turn reasoning off at the server, or raise the bound \
                 (--answer-tokens)."
            }
            (false, _) => "`--log-prompts` and `memtransfer show` show the answers.",
        };
        match model {
            Some(_) => format!("{advice} `memtransfer doctor --policy openai` checks the server."),
            None => advice.to_owned(),
        }
    }

    /// That none of the answers has an action, why, and what to do.
    pub fn described(&self, model: Option<&ModelSettings>) -> String {
        let Self { answers, .. } = self;
        let (reasons, advice) = (self.reasons(model), self.advice(model));
        format!("{answers} of {answers} answers have no action: {reasons}. {advice}")
    }
}

/// The episodes of a run in which no answer of the model has an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WithoutAction {
    /// Their number.
    pub episodes: usize,
    /// Episodes in which the model was asked.
    pub of: usize,
    /// Their answers.
    pub counts: AnswerCounts,
}

impl WithoutAction {
    /// Those of a run; `None` where each episode in which the model was asked has an action.
    pub fn of_run(log: &RunLog) -> Option<Self> {
        let mut by_episode = BTreeMap::<&str, (AnswerCounts, bool)>::new();
        for request in &log.requests {
            let (counts, acted) = by_episode.entry(&request.key).or_default();
            counts.add(request);
            *acted |= request.outcome == Outcome::Acted;
        }
        let of = by_episode.len();
        by_episode.retain(|_, (_, acted)| !*acted);
        let mut counts = AnswerCounts::default();
        by_episode.values().for_each(|(episode, _)| counts.merge(episode));
        let episodes = by_episode.len();
        (episodes > 0).then_some(Self { episodes, of, counts })
    }

    /// Whether the run has no action at all.
    pub fn is_all(&self) -> bool {
        self.episodes == self.of
    }

    /// A sentence for readers of the run's figures.
    pub fn described(&self, model: Option<&ModelSettings>) -> String {
        if self.is_all() {
            return self.counts.described(model);
        }
        let Self { episodes, of, counts } = self;
        let (answers, reasons, advice) =
            (counts.answers, counts.reasons(model), counts.advice(model));
        format!(
            "{episodes} of {of} episodes have no action: of their {answers} answers, {reasons}. {advice}"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::{log, request};

    #[test]
    fn episodes_without_an_action_are_counted_by_reason() {
        let answer = |key: &str, outcome| RequestRecord { outcome, ..request(key, 0) };
        let of = |requests: &[RequestRecord]| {
            WithoutAction::of_run(&RunLog { requests: requests.to_vec(), ..log(Vec::new()) })
        };
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[answer("a", Outcome::CutOff), answer("a", Outcome::Acted)]), None);
        let silent = [
            answer("a", Outcome::CutOff),
            RequestRecord { reasoned: Some(true), ..answer("a", Outcome::CutOff) },
            answer("b", Outcome::Empty),
        ];
        insta::assert_snapshot!(of(&silent).unwrap().described(None), @"3 of 3 answers have no action: 2 were cut off at the bound on their tokens, 1 are empty. The model reasons although it was asked not to: turn reasoning off at the server, or raise the bound (--answer-tokens).");
        let some = [&silent[..], &[answer("c", Outcome::Acted), answer("d", Outcome::Unreadable)]];
        let some = of(&some.concat()).unwrap();
        assert!(!some.is_all());
        insta::assert_snapshot!(some.described(None), @"3 of 4 episodes have no action: of their 4 answers, 2 were cut off at the bound on their tokens, 1 name no action, 1 are empty. `--log-prompts` and `memtransfer show` show the answers.");
    }
}
