//! Who wrote the documents of summary, semantic and hybrid memory, and what that took.

use std::collections::{BTreeMap, BTreeSet};

use domain::{MemoryKind, Representation};
use run_log::memory_label::{DocumentAuthor, author_words, memory_title};
use scores::DocumentScore;

use crate::view::ScoredRun;

/// Documents that are named; of more, the number is told.
const MOST_NAMED: usize = 4;

/// What models took to write documents of the run.
pub(super) fn accounts(view: &ScoredRun<'_>) -> Vec<String> {
    let prices = view.log.manifest.prices.as_ref();
    let account = |score: &DocumentScore| {
        let DocumentScore { model, built, documents, usage, cost } = score;
        let when = if *built { "for this run" } else { "before this run" };
        let documents = match documents.len() {
            many if many > MOST_NAMED => format!("{many} documents"),
            _ => documents.join(", "),
        };
        let requests = match usage.requests {
            1 => "1 request".to_owned(),
            many => format!("{many} requests"),
        };
        let tokens = match usage.unknown {
            0 => format!("{} tokens", usage.tokens()),
            _ => "an unknown number of tokens".to_owned(),
        };
        let cost = cost.zip(prices).map(|(cost, prices)| format!(" ({cost} {})", prices.currency));
        format!(
            "{model} wrote {documents} {when}, in {requests} with {tokens}{}; tokens per 100 cases leave these out, as the \
             paper's do.",
            cost.unwrap_or_default()
        )
    };
    view.scores.documents.iter().map(account).collect()
}

/// What a reader must know who compares documents of the run with the paper's; `None` where they are by the run's model, too.
pub(super) fn beside_the_paper(view: &ScoredRun<'_>) -> Option<String> {
    let of_others: BTreeSet<String> = with_documents()
        .filter(|memory| has(view, *memory))
        .map(|memory| (memory_title(memory), view.label(memory)))
        .filter(|(title, label)| title != label)
        .map(|(_, label)| label)
        .collect();
    let labels = Vec::from_iter(of_others).join(", ");
    let is_shown = !labels.is_empty() && view.published.is_paper;
    is_shown.then(|| {
        format!(
            "The paper's documents were written by its own model, the one that decides; those of {labels} were not, so the \
             published figures beside these rows are of other documents."
        )
    })
}

/// A sentence for each memory whose documents have other authors in one of the runs than in another.
pub(super) fn other_authors(views: &[&ScoredRun<'_>]) -> Vec<String> {
    let sentence = |memory: MemoryKind| {
        let mut runs: BTreeMap<BTreeSet<DocumentAuthor>, Vec<&str>> = BTreeMap::new();
        for view in views.iter().filter(|view| has(view, memory)) {
            let authors = view.log.manifest.document_authors(memory);
            runs.entry(authors).or_default().push(&view.log.name);
        }
        let by = |(authors, names): (&BTreeSet<DocumentAuthor>, &Vec<&str>)| {
            let authors =
                if authors.is_empty() { "unknown".to_owned() } else { author_words(authors) };
            format!("{authors} in {}", names.join(", "))
        };
        let differ = runs.len() > 1;
        differ.then(|| {
            format!(
                "The documents of {} memory have different authors: {}.",
                memory,
                runs.iter().map(by).collect::<Vec<_>>().join("; ")
            )
        })
    };
    with_documents().filter_map(sentence).collect()
}

/// The memories that supply documents.
fn with_documents() -> impl Iterator<Item = MemoryKind> {
    let all = Representation::ALL.iter();
    all.filter(|one| !one.describe().documents.is_empty()).map(|one| MemoryKind::BuiltIn(*one))
}

/// Whether the run has figures of this memory.
fn has(view: &ScoredRun<'_>, memory: MemoryKind) -> bool {
    let streams = view.scores.streams.iter().flat_map(|streams| &streams.conditions);
    let conditions = view.scores.conditions.iter().map(|score| score.condition);
    conditions.chain(streams.map(|score| score.condition)).any(|of| of.memory == memory)
}
