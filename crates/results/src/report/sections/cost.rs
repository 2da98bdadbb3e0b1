//! What the policy was given and what it answered, for each representation.

use domain::Representation;

use super::main_table::{NO_REQUESTS, mega};
use crate::conditions::Variation;
use crate::report::document::{Block, Cell, Column, Group, Missing, Row, Table};
use crate::report::plot::PlotError;
use crate::report::view::{View, name, pair_stubs, plain_or, title};
use crate::score::RequestScore;

const SETTINGS: [(&str, &str, &str); 2] = [
    ("New start, 1 demo", "new/unchanged", "original"),
    ("New start, 4 demos", "new/unchanged", "4"),
];

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let settings = &view.log.manifest.settings;
    let columns = SETTINGS.iter().flat_map(|(over, _, _)| {
        ["Images", "Mtok", "Unreadable %"].map(|name| Column::under(*over, name))
    });
    let mut columns: Vec<Column> = columns.collect();
    columns.insert(0, Column::new("Full window"));
    let names = |representation| {
        SETTINGS.map(|(_, rest, demonstrations)| name(representation, rest, demonstrations))
    };
    let ours = |representation: Representation| {
        let window = Variation::STANDARD.window;
        let most = representation.images(window, settings.horizon, settings.keyframes);
        let mut cells = vec![Cell::Value(most.to_string())];
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
        let mut cells = vec![view.theirs(&original, |p| p.img.map(|img| format!("{img:.0}")))];
        for name in names(representation) {
            cells.push(view.theirs(&name, |_| None));
            cells.push(view.theirs(&name, |p| p.mtok.map(|mtok| format!("{mtok:.0}"))));
            cells.push(view.theirs(&name, |_| None));
        }
        cells
    };
    let table = Table {
        id: view.id("cost"),
        caption: "What a request held and what came back. Full window: most images of a request, which are the \
                  current view, the window and what memory supplies. Images: the mean over all requests, which is lower \
                  because the window fills up during an episode's first steps. Mtok: million prompt and completion \
                  tokens per 100 cases. Unreadable: percentage of answers in which no action could be read."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(Representation::ALL, ours, theirs),
    };
    let mut blocks = vec![Block::Table(table)];
    blocks.extend(requests(view).map(Block::Table));
    Ok(blocks)
}

/// What questions to a model took, by memory; `None` where none was asked.
fn requests(view: &View<'_>) -> Option<Table> {
    let prices = view.log.manifest.prices.as_ref();
    let mut columns =
        ["Requests", "Kept", "Retries", "Tokens", "Memory %", "Cached %"].map(Column::new).to_vec();
    columns.push(Column::new("Images left out"));
    columns.extend(["Unreadable", "Empty", "Refused"].map(|name| Column::under("Answers", name)));
    columns.extend(["p50", "p90"].map(|name| Column::under("Latency, ms", name)));
    columns.push(Column::new("Mtok"));
    columns.extend(prices.map(|prices| Column::new(format!("Cost, {}", prices.currency))));
    let row = |label: &str, found: &RequestScore| {
        let count = |count: u64| Cell::Value(count.to_string());
        let answers = |kind: u32| Cell::Value(kind.to_string());
        let spent = &found.spent;
        let tokens = (spent.unknown == 0).then(|| spent.tokens() as f64 / 1e6);
        let mut cells = vec![
            count(spent.requests),
            count(spent.replayed),
            count(spent.attempts.saturating_sub(spent.requests)),
            plain_or(found.prompt_tokens_each, 0, UNTOLD),
            plain_or(found.memory_share, 1, UNTOLD),
            plain_or(found.cached_share, 1, UNTOLD),
            count(found.images_dropped),
            answers(found.unread.unreadable),
            answers(found.unread.empty),
            answers(found.unread.refused),
            plain_or(found.latency_p50_ms, 0, NOTHING_SENT),
            plain_or(found.latency_p90_ms, 0, NOTHING_SENT),
            plain_or(tokens, 3, UNTOLD),
        ];
        cells.extend(prices.map(|_| match found.cost {
            Some(cost) => Cell::Value(cost.to_string()),
            None => Cell::Missing(UNTOLD),
        }));
        Row { label: label.to_owned(), published: false, cells }
    };
    let all = RequestScore::of_run(view.log)?;
    let by_memory = RequestScore::by_memory(view.log);
    let rows = by_memory.iter().map(|(memory, found)| row(title(*memory), found));
    Some(Table {
        id: view.id("requests"),
        caption: "What questions to the model took, over all conditions of a memory, those of episodes that were walked \
                  again included. Requests: questions that the server answered. Kept: questions that were answered \
                  from the response cache; they cost nothing and are in no other figure but the images and answers. Retries: \
                  further attempts. Tokens: mean of a prompt. Memory: the part of the prompts that is injected memory, an \
                  estimate. Cached: the part that the server took from its own cache. Images left out: those beyond the image \
                  budget. Latency: from sending to decision, for half and nine of ten of the requests. Mtok: million tokens \
                  of prompts and answers together, as spent."
            .to_owned(),
        stubs: vec!["Representation".to_owned()],
        columns,
        groups: vec![Group { label: None, rows: rows.chain([row("All", &all)]).collect() }],
    })
}

const UNTOLD: Missing = Missing::NotMeasured("not told for every request");
const NOTHING_SENT: Missing = Missing::NotMeasured("every answer came from the response cache");
