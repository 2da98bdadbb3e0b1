//! How the figures are defined.

use crate::document::{ReportBlock, ReportSection};

/// The section with the definitions.
pub(crate) fn method() -> ReportSection {
    let term = |term: &str, meaning: &str| (term.to_owned(), meaning.to_owned());
    let terms = vec![
        term(
            "SR",
            "Success rate: 100/N · Σ sᵢ, in percent. sᵢ is 1 when every required standpoint was visited, in order where \
             the task orders, ending where it must, within the step limit.",
        ),
        term(
            "SPL",
            "Success weighted by path length: 1/N · Σ sᵢ · lᵢ / max(pᵢ, lᵢ), from 0 to 1. pᵢ: steps taken; lᵢ: length of \
             the reference from the episode's own start on its route. A success that is not longer than the reference \
             counts 1; references are up to 1.56 times as long as the shortest way with strafing.",
        ),
        term(
            "Δ",
            "(SR blocked − SR unchanged) minus the same of working memory, in percentage points, from mean success \
             rates over runs. Negative: blocking costs more than it costs the baseline.",
        ),
        term(
            "Retention",
            "SR blocked / SR unchanged, from mean success rates over runs. Undefined when nothing succeeds on the unchanged route.",
        ),
        term(
            "Follow",
            "100/N · Σ bᵢ. bᵢ is 1 when the agent ran at least once into what blocks the way; N are the episodes \
             that finished.",
        ),
        term(
            "Recovery",
            "100 · Σ bᵢsᵢ / Σ bᵢ, of each run in which an episode did. A run without one has no recovery rate and does not \
             enter its mean.",
        ),
        term(
            "Tokens",
            "Prompt and completion tokens together, per 100 cases. Absent if any episode was not measured.",
        ),
        term(
            "From other tasks",
            "Percentage of Episodic's retrievals that came from the demonstration of another case.",
        ),
        term(
            "±",
            "Sample standard deviation over runs. Every figure is computed for each run by itself, then averaged.",
        ),
    ];
    let intervals = "Intervals are of 95 %, one method for all figures: Student's t over cases, after two cases are added, one at each \
                     end of what a case can contribute: 0 and 100 % for a rate, 0 and 1 for SPL, a success under the one \
                     condition alone and one under the other alone for a difference, Δ and retention. So intervals have a width \
                     at 0 and 100 %, too. A case's repetitions are averaged first. Of streams: Student's t over streams, without \
                     added ones, because a stream is a mean over many episodes already. No interval: one case or stream, streams \
                     that are all alike, and a retention that may be arbitrarily large because little or nothing succeeds on the \
                     unchanged route. The specification, section 7, has the formulas.";
    let pairs = "Comparisons pair the episodes of the same case and repetition; others do not enter. Better and worse count cases with \
                 more successes under the first, or the second; p is the exact two-sided sign test on these counts. A section's \
                 comparisons are corrected together (Holm 1979), and the corrected p decides: it says better or worse below 5 %, and \
                 else that no difference is shown, which is not to say that there is none. The interval is of the size of the \
                 difference, the test of whether one of them succeeds in more cases, and the interval is not corrected; so it may \
                 exclude 0 where no difference is shown.";
    let missing = "Figures are over finished episodes. An episode that was given up because of a fault is not scored. \
                   Where episodes are missing the report says so, with the success rate and SPL if all of them failed \
                   and if all succeeded.";
    let marks = "In the tables: not run, the run has no such condition; n/m, not measured; —, not published; undef., \
                 undefined; n/a, does not exist. The reason stands below each table.";
    let blocks = vec![
        ReportBlock::Terms(terms),
        ReportBlock::Text(intervals.to_owned()),
        ReportBlock::Text(pairs.to_owned()),
        ReportBlock::Text(missing.to_owned()),
        ReportBlock::Text(marks.to_owned()),
    ];
    ReportSection::new("s-method", "Definitions", blocks)
}
