//! How the figures are defined.

use crate::report::document::{Block, Section};
use crate::score::{RESAMPLES, SEED};

/// The section with the definitions.
pub(in crate::report) fn method() -> Section {
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
             the reference from the episode's own start on its route.",
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
            "100 · Σ bᵢsᵢ / Σ bᵢ, of each run in which somebody tried. A run in which nobody did has no recovery rate and \
             does not enter its mean.",
        ),
        term(
            "Tokens",
            "Prompt and completion tokens together, a hundred cases. Absent as soon as one episode was not measured.",
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
        "Intervals in brackets are 95 % percentile bootstrap intervals from {RESAMPLES} resamples (ChaCha8, seed {SEED}): \
         cases are drawn with replacement, and for each case drawn its repetitions, again with replacement; conditions \
         that enter one figure together are drawn with the same cases. Where every episode succeeds, or none does, the \
         interval has no width, and says nothing about cases that were not tried."
    );
    let given_up = "An episode that was given up because of a fault is an attempt that did not succeed: it counts in SR, SPL \
                    and the task groups, and has no steps, images, tokens or answers.";
    let marks = "In the tables: not run, the run has no such condition; n/m, not measured; —, not in the paper; undef., \
                 undefined; n/a, there is no such thing. The reason stands below each table.";
    Section {
        id: "s-method".to_owned(),
        level: 2,
        title: "Definitions".to_owned(),
        blocks: vec![
            Block::Terms(terms),
            Block::Text(intervals),
            Block::Text(given_up.to_owned()),
            Block::Text(marks.to_owned()),
        ],
    }
}
