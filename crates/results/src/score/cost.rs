//! What the policy was given and what it answered (SPEC section 7): images a request, tokens a hundred
//! cases, unreadable answers.

use super::spread::{mean, percentage};
use super::trial::Trial;

/// Images in a request, on average over the requests of one run. The first steps of an episode have a shorter
/// window behind them, so the mean lies below the number at full window that SPEC section 5 gives.
pub(super) fn images_per_request(trials: &[&Trial<'_>]) -> Option<f64> {
    let records = trials.iter().filter_map(|trial| trial.record);
    let measured = records.filter_map(|record| Some((record.images?, record.requests?)));
    let (images, requests) = measured.fold((0, 0), |(images, requests), (more, asked)| {
        (images + more, requests + u64::from(asked))
    });
    (requests > 0).then(|| images as f64 / requests as f64)
}

/// Tokens of prompts and completions together, a hundred cases of one run. Absent as soon as one finished
/// episode was not measured: a sum over some would look like one over all.
pub(super) fn tokens_per_100(trials: &[&Trial<'_>]) -> Option<f64> {
    let records = trials.iter().filter_map(|trial| trial.record);
    let tokens: Option<Vec<f64>> = records
        .map(|record| Some((record.prompt_tokens? + record.completion_tokens?) as f64))
        .collect();
    Some(mean(tokens?.into_iter())? * 100.0)
}

/// Percentage of the answers of one run in which no action could be read: unreadable, empty or refused.
pub(super) fn unread(trials: &[&Trial<'_>]) -> Option<f64> {
    let records = || trials.iter().filter_map(|trial| trial.record);
    let requests: u64 = records().filter_map(|record| record.requests).map(u64::from).sum();
    let unread: u64 = records().map(|record| u64::from(record.unread.total())).sum();
    (requests > 0).then(|| 100.0 * unread as f64 / requests as f64)
}

/// Percentage of one run's retrievals that came from another task's history (paper, section `sec:rq3`).
/// Absent where nothing was retrieved; requests without a match are no retrievals.
pub(super) fn from_other_cases(trials: &[&Trial<'_>]) -> Option<f64> {
    let records = trials.iter().filter_map(|trial| trial.record);
    let retrieved = records.filter_map(|record| record.retrieved.as_deref());
    let matches = retrieved.flat_map(str::split_whitespace).filter(|word| *word != "-");
    percentage(matches.map(|word| word.contains(':')))
}
