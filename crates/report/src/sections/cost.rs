//! Images, tokens and answers, for each representation.

use conditions::Variation;
use domain::MemoryKind;
use scores::RequestScore;

use super::main_table::{NO_REQUESTS, mega};
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, name, pair_stubs, plain_or, published_text};

const SETTINGS: [(&str, &str, &str); 2] = [
    ("New start, 1 demo", "new/unchanged", "original"),
    ("New start, 4 demos", "new/unchanged", "4"),
];

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let settings = &view.log.manifest.settings;
    let columns = SETTINGS.iter().flat_map(|(over, _, _)| {
        ["Images", "Mtok", "Unreadable %"].map(|name| TableColumn::under(*over, name))
    });
    let mut columns: Vec<TableColumn> = columns.collect();
    columns.insert(0, TableColumn::new("Full window"));
    let names = |representation| {
        SETTINGS.map(|(_, rest, demonstrations)| name(representation, rest, demonstrations))
    };
    let ours = |representation: MemoryKind| {
        let most = 1 + Variation::STANDARD.window + settings.memory_images_of(representation);
        let was_run = names(representation).iter().any(|name| view.score(name).is_some());
        let full = if was_run {
            TableCell::Value(most.to_string())
        } else {
            TableCell::Missing(Missing::NotRun)
        };
        let mut cells = vec![full];
        for name in names(representation) {
            cells.push(view.ours(&name, |score| {
                plain_or(score.images_per_request.map(|images| images.mean), 2, NO_REQUESTS)
            }));
            cells.push(mega(view, &name));
            cells.push(view.ours(&name, |score| {
                plain_or(score.unread.map(|unread| unread.mean), 2, NO_REQUESTS)
            }));
        }
        cells
    };
    let theirs = |representation| {
        let original = name(representation, "original/unchanged", "original");
        let mut cells = vec![view.theirs(&original, |p| Some(published_text(p.img?, 0)))];
        for name in names(representation) {
            cells.push(view.theirs(&name, |_| None));
            cells.push(view.theirs(&name, |p| Some(published_text(p.mtok?, 0))));
            cells.push(view.theirs(&name, |_| None));
        }
        cells
    };
    let table = Table {
        id: view.id("cost"),
        caption: "Images, tokens and unreadable answers. Full window: images of a request with a full window (the current \
                  view, the window and what memory supplies). Images: the mean over all requests, which is lower \
                  because the window fills up during an episode's first steps. Mtok: million prompt and completion \
                  tokens per 100 cases. Unreadable: percentage of answers in which no action could be read."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    ReportBlock::tables([table.pruned(), requests_table(view)])
}

/// Figures of the requests, a column for each memory; `None` where no model was asked.
pub(crate) fn requests_table(view: &ScoredRun<'_>) -> Option<Table> {
    let all = RequestScore::of_run(view.log)?;
    let by_memory = RequestScore::by_memory(view.log);
    let scores: Vec<&RequestScore> =
        by_memory.iter().map(|(_, score)| score).chain([&all]).collect();
    type Figure = fn(&RequestScore) -> TableCell;
    let mut figures: Vec<(String, Figure)> = [
        ("Requests", (|s| TableCell::Value(s.usage.requests.to_string())) as Figure),
        ("From the response cache", |s| TableCell::Value(s.usage.replayed.to_string())),
        ("Retries", |s| TableCell::Value(s.usage.retries().to_string())),
        ("Tokens of a prompt", |s| plain_or(s.prompt_tokens_each, 0, UNKNOWN)),
        ("of which memory, %", |s| plain_or(s.memory_share, 1, UNKNOWN)),
        ("of which reusable, %", |s| plain_or(s.reusable_share, 1, UNKNOWN)),
        ("of which cached, %", |s| plain_or(s.cached_share, 1, UNKNOWN)),
        ("Images left out", |s| TableCell::Value(s.images_dropped.to_string())),
        ("Unreadable answers", |s| TableCell::Value(s.unread.unreadable.to_string())),
        ("Empty answers", |s| TableCell::Value(s.unread.empty.to_string())),
        ("Answers cut off at the token bound", |s| TableCell::Value(s.unread.cut_off.to_string())),
        ("Refusals", |s| TableCell::Value(s.unread.refused.to_string())),
        ("Latency p50, ms", |s| plain_or(s.latency_p50_ms, 0, NOTHING_SENT)),
        ("Latency p90, ms", |s| plain_or(s.latency_p90_ms, 0, NOTHING_SENT)),
        ("Million tokens", |s| {
            let tokens = (s.usage.unknown == 0).then(|| s.usage.tokens() as f64 / 1e6);
            plain_or(tokens, 3, UNKNOWN)
        }),
    ]
    .map(|(label, figure)| (label.to_owned(), figure))
    .to_vec();
    if let Some(prices) = &view.log.manifest.prices {
        let cost: Figure = |s| {
            s.cost.map_or(TableCell::Missing(UNKNOWN), |cost| TableCell::Value(cost.to_string()))
        };
        figures.push((format!("Cost, {}", prices.currency), cost));
    }
    let row = |(label, figure): (String, Figure)| {
        TableRow::new(label, scores.iter().map(|score| figure(score)).collect())
    };
    let columns = by_memory.iter().map(|(memory, _)| view.label(*memory)).chain(["All".to_owned()]);
    Some(Table {
        id: view.id("requests"),
        caption: "Requests to the model over all conditions of a memory, including those of episodes that were \
                  repeated. Answers from the response cache cost nothing and count only for images and answers. \
                  Memory: the part of the prompts that is injected memory, an estimate. Cached: the part that the \
                  server took from its own cache. Images left out: those beyond the image budget. Latency: of the \
                  attempt that was answered. Million tokens: prompts and completions together."
            .to_owned(),
        stubs: vec!["Figure".to_owned()],
        columns: columns.map(TableColumn::new).collect(),
        groups: vec![RowGroup { label: None, rows: figures.into_iter().map(row).collect() }],
    })
}

const UNKNOWN: Missing = Missing::NotMeasured("unknown for some requests");
const NOTHING_SENT: Missing = Missing::NotMeasured("every answer came from the response cache");
