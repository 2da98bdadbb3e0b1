//! Images, tokens, unreadable answers and retrievals (specification, section 7).

use super::mean::{mean, percentage};
use run_log::EpisodeRecord;

/// Mean images of a request of one run. The window fills up during the first steps of an episode, so the mean is
/// below the number at full window that section 5 of the specification gives.
pub(super) fn images_per_request(records: &[&EpisodeRecord]) -> Option<f64> {
    let measured = records.iter().filter_map(|record| Some((record.images?, record.requests?)));
    let (images, requests) = measured.fold((0.0, 0), |(images, requests), (more, asked)| {
        (images + more as f64, requests + u64::from(asked))
    });
    (requests > 0).then(|| images / requests as f64)
}

/// Prompt and completion tokens of a hundred cases of one run. `None` if any finished episode was not measured:
/// a sum over some would look like one over all.
pub(super) fn tokens_per_100(records: &[&EpisodeRecord]) -> Option<f64> {
    let tokens: Option<Vec<f64>> = records
        .iter()
        .map(|record| Some(record.prompt_tokens? as f64 + record.completion_tokens? as f64))
        .collect();
    Some(mean(tokens?.into_iter())? * 100.0)
}

/// Percentage of the answers of one run in which no action could be read: unreadable, empty, refused or cut off.
pub(super) fn unread(records: &[&EpisodeRecord]) -> Option<f64> {
    let requests: u64 = records.iter().filter_map(|record| record.requests).map(u64::from).sum();
    let unread: u64 = records.iter().map(|record| u64::from(record.unread.total())).sum();
    (requests > 0).then(|| 100.0 * unread as f64 / requests as f64)
}

/// Percentage of one run's retrievals that came from another task's history (paper, section `sec:rq3`). `None`
/// where nothing was retrieved; requests without a match are not retrievals, and each of several sources is one.
pub(super) fn from_other_cases(records: &[&EpisodeRecord]) -> Option<f64> {
    let retrieved = records.iter().filter_map(|record| record.retrieved.as_deref());
    let matches = retrieved.flat_map(|words| words.split([' ', '+'])).filter(|word| *word != "-");
    percentage(matches.map(|word| word.contains(':')))
}
