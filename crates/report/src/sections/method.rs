//! How the figures are defined.

use results::score::{RESAMPLES, SEED};

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
             rates. Negative: blocking costs more than it costs the baseline.",
        ),
        term(
            "Retention",
            "SR blocked / SR unchanged. Undefined when nothing succeeds on the unchanged route.",
        ),
        term(
            "Follow",
            "100/N · Σ bᵢ. bᵢ is 1 when the agent tried at least once to enter a newly closed cell; N are the episodes \
             that finished.",
        ),
        term(
            "Recovery",
            "100 · Σ bᵢsᵢ / Σ bᵢ, of each run in which an episode tried. A run without one has no recovery rate and does not \
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
    let intervals = format!(
        "Intervals are of 95 %. Of success and follow rates: Wilson's score interval over cases, for several runs with \
         the effective sample size between the number of cases and of episodes that the cases' own means show; it \
         has a width at 0 and 100 %, too. Of the other figures: percentile bootstrap from {RESAMPLES} resamples \
         (ChaCha8, seed {SEED}): cases are drawn with replacement, and for each case drawn its repetitions, again with \
         replacement; conditions that enter one figure together are drawn with the same cases. Where every case is \
         alike the bootstrap has no width: SPL and recovery then have Wilson's interval, a difference of success \
         rates Newcombe's, the others none. A figure that is undefined in more than one resample of twenty has no \
         interval either."
    );
    let missing = "Figures are over finished episodes. An episode that was given up because of a fault is not scored. \
                   Where episodes are missing the report says so, with the success rate and SPL if all of them failed \
                   and if all succeeded.";
    let marks = "In the tables: not run, the run has no such condition; n/m, not measured; —, not published; undef., \
                 undefined; n/a, does not exist. The reason stands below each table.";
    let blocks = vec![
        ReportBlock::Terms(terms),
        ReportBlock::Text(intervals),
        ReportBlock::Text(missing.to_owned()),
        ReportBlock::Text(marks.to_owned()),
    ];
    ReportSection::new("s-method", "Definitions", blocks)
}
