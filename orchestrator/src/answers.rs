//! Notices that no answer of a model has an action, as when each is cut off at the bound on its tokens, and stops the run
//! where that goes on (`--stop-without-action`).
//!
//! Only the start of a session counts: once an answer has had an action, answers without one are the model's, however many.
//! Which episodes have answered by then depends on lanes and chance, so the stop says nothing about any of them: those that
//! are finished are in the log as they would be without it, and the others run again.

use std::collections::BTreeSet;

use conditions::settings::ModelSettings;
use domain::Outcome;
use run_log::RequestRecord;
use run_log::answers::AnswerCounts;

/// Answers without an action after which the user is warned.
const WARN_AFTER: u64 = 10;

/// Episodes that the answers have to belong to before the run stops: one episode may be stuck, since a model without
/// memory sees the same again where it did not move.
const STOP_EPISODES: usize = 3;

/// Watches the answers of a session.
#[derive(Debug, Default)]
pub(crate) struct AnswerWatch {
    model: Option<ModelSettings>,
    /// Until the first action.
    counts: AnswerCounts,
    /// Keys of the first episodes that were answered.
    episodes: BTreeSet<String>,
    acted: bool,
}

/// What the user has to know.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum AnswerNotice {
    /// No answer so far has an action.
    Warning(String),
    /// That goes on, and the run stops.
    Stop(String),
}

impl AnswerWatch {
    /// A watch of the answers of `model`; without its settings, as of a policy of the user's, it warns and never stops.
    pub(crate) fn new(model: Option<&ModelSettings>) -> Self {
        Self { model: model.cloned(), ..Self::default() }
    }

    /// Counts an answer. Returns what the user has to know now.
    pub(crate) fn add(&mut self, request: &RequestRecord) -> Option<AnswerNotice> {
        self.acted |= request.outcome == Outcome::Acted;
        if self.acted {
            return None;
        }
        self.counts.add(request);
        if self.episodes.len() < STOP_EPISODES {
            self.episodes.insert(request.key.clone());
        }
        let model = self.model.as_ref();
        let limit = model.map_or(0, |model| model.stop_without_action);
        let goes_on = limit > 0 && self.counts.answers >= limit.into();
        if goes_on && self.episodes.len() >= STOP_EPISODES {
            let described = self.counts.described(model);
            return Some(AnswerNotice::Stop(format!(
                "{described} With --stop-without-action 0 the run goes on all the same"
            )));
        }
        (self.counts.answers == WARN_AFTER)
            .then(|| AnswerNotice::Warning(self.counts.described(model)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigs::records::request;

    fn model() -> ModelSettings {
        let settings = serde_json::json!({
            "model": "m", "image-format": "png", "image-budget": 50, "answer-tokens": 30, "max-connections": 1,
            "max-retries": 0, "request-timeout": 1, "response-cache": "off",
        });
        serde_json::from_value(settings).unwrap()
    }

    fn answer(episode: u64, outcome: Outcome) -> RequestRecord {
        RequestRecord { outcome, ..request(&format!("episode {episode}"), 0) }
    }

    /// The notices of a session whose answers go round in `episodes`, with their number.
    fn notices(
        limit: u32,
        episodes: u64,
        outcome: impl Fn(u64) -> Outcome,
    ) -> Vec<(u64, AnswerNotice)> {
        let settings = ModelSettings { stop_without_action: limit, ..model() };
        let mut watch = AnswerWatch::new(Some(&settings));
        let add = |number| Some((number, watch.add(&answer(number % episodes, outcome(number)))?));
        (1..=300).filter_map(add).collect()
    }

    #[test]
    fn a_session_without_an_action_is_warned_of_and_stopped() {
        let found = notices(100, 4, |_| Outcome::CutOff);
        let [(10, AnswerNotice::Warning(warning)), (100, AnswerNotice::Stop(stop)), ..] =
            &found[..]
        else {
            panic!("{found:?}")
        };
        insta::assert_snapshot!(warning, @"10 of 10 answers have no action: 10 were cut off at 30 tokens. The model may reason although it was asked not to: turn reasoning off at the server, or raise the bound (--answer-tokens). `memtransfer doctor --policy openai` checks the server.");
        insta::assert_snapshot!(stop, @"100 of 100 answers have no action: 100 were cut off at 30 tokens. The model may reason although it was asked not to: turn reasoning off at the server, or raise the bound (--answer-tokens). `memtransfer doctor --policy openai` checks the server. With --stop-without-action 0 the run goes on all the same");
    }

    #[test]
    fn an_action_two_stuck_episodes_or_no_limit_keep_the_run_going() {
        let stops = |found: Vec<(u64, AnswerNotice)>| {
            found.iter().any(|(_, notice)| matches!(notice, AnswerNotice::Stop(_)))
        };
        let first_acts = |number| if number == 1 { Outcome::Acted } else { Outcome::Refused };
        assert_eq!(notices(100, 4, first_acts), []);
        assert!(!stops(notices(100, 2, |_| Outcome::Empty)), "two episodes may be stuck");
        assert!(!stops(notices(0, 4, |_| Outcome::Unreadable)), "there is no limit");
        let mut of_a_user = AnswerWatch::new(None);
        let found: Vec<_> = (0..300)
            .filter_map(|number| of_a_user.add(&answer(number, Outcome::Unreadable)))
            .collect();
        assert!(matches!(&found[..], [AnswerNotice::Warning(_)]), "{found:?}");
    }
}
