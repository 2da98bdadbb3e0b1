//! Table `tab:main`: six representations in the four settings of the three questions, with what they cost.

use domain::MemoryKind;
use scores::{ConditionScore, Interval};

use crate::document::{Missing, ReportBlock, Table, TableCell, TableColumn};
use crate::plot::{Dot, DotRow, dots};
use crate::view::{
    ScoredRun, name, our_rates, pair_stubs, plain_or, published_text, rate_columns, their_rates,
};

/// A heading, start and route, demonstrations.
pub(super) type Setting = (&'static str, &'static str, &'static str);

const SETTINGS: [Setting; 4] = [
    ("Original start, 1 demo", "original/unchanged", "original"),
    ("New start, 1 demo", "new/unchanged", "original"),
    ("New start, 4 demos", "new/unchanged", "4"),
    ("New start, blocked, 4 demos", "new/blocked", "4"),
];

pub(super) const NO_TOKENS: Missing =
    Missing::NotMeasured("this run's policy counts no tokens (a scripted policy has none)");
pub(super) const NO_REQUESTS: Missing =
    Missing::NotMeasured("no policy was asked: the expert replays the reference");

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let mut columns = vec![
        TableColumn::new("Img"),
        TableColumn::under("Mtok", "1 demo"),
        TableColumn::under("Mtok", "4 demos"),
    ];
    columns.extend(rate_columns(&SETTINGS.map(|(heading, _, _)| heading)));
    let ours = |memory| {
        let names = names(memory, SETTINGS);
        let [_, one, four, _] = &names;
        let mut cells = vec![images(view, one, four), mega(view, one), mega(view, four)];
        cells.extend(names.iter().flat_map(|name| our_rates(view, name)));
        cells
    };
    let theirs = |memory| {
        let names = names(memory, SETTINGS);
        let [original, one, four, _] = &names;
        let mut cells = vec![view.theirs(original, |p| Some(published_text(p.img?, 0)))];
        let mega = |name: &String| view.theirs(name, |p| Some(published_text(p.mtok?, 0)));
        cells.extend([one, four].map(mega));
        cells.extend(names.iter().flat_map(|name| their_rates(view, name)));
        cells
    };
    let table = Table {
        id: view.id("main"),
        caption: "Memory performance across the three questions (the paper's table “Memory performance across the three RQs”). SR: success rate \
                  in percent, mean ± sample standard deviation over runs, and its 95 % interval in brackets. SPL: \
                  success weighted by path length, mean. Img: images per request; this run's is the mean over all \
                  requests at the new start, where an episode's first steps have a shorter window; the paper's is the \
                  number at full window. Mtok: million prompt and completion tokens per 100 new-start cases. Working \
                  memory uses no demonstrations, so its new-start figures stand in both columns."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    let figure = rate_figure(
        view.id("main-figure"),
        "Success rate in the four settings. Filled: this run with its 95 % interval. Open: published, mean ± standard \
         deviation.",
        rates_by_memory(view, &view.memories(), SETTINGS),
    );
    table.pruned().map(ReportBlock::Table).into_iter().chain(figure).collect()
}

/// The plot of success rates, if it has rows.
pub(super) fn rate_figure(id: String, caption: &str, rows: Vec<DotRow>) -> Option<ReportBlock> {
    (!rows.is_empty()).then(|| ReportBlock::Figure(dots(&id, caption, &rows)))
}

/// The names of a memory's conditions in these settings.
pub(super) fn names<const N: usize>(memory: MemoryKind, settings: [Setting; N]) -> [String; N] {
    settings.map(|(_, rest, demonstrations)| name(memory, rest, demonstrations))
}

/// The rows of a plot of success rates: one for each setting in which a memory was run. Working memory has no demonstrations, so that
/// settings which differ in nothing else are one.
pub(super) fn rates_by_memory<const N: usize>(
    view: &ScoredRun<'_>,
    memories: &[MemoryKind],
    settings: [Setting; N],
) -> Vec<DotRow> {
    let rows = |&memory: &MemoryKind| {
        let label = |(heading, _, _): &Setting| match heading.rsplit_once(", ") {
            Some((without, _)) if !memory.uses_demonstrations() => without.to_owned(),
            _ => (*heading).to_owned(),
        };
        let mut conditions: Vec<_> =
            settings.iter().map(label).zip(names(memory, settings)).collect();
        conditions.dedup();
        rate_rows(view, &view.label(memory), &conditions)
    };
    memories.iter().flat_map(rows).collect()
}

/// The rows of a plot of success rates: one for each of the `conditions` (label, name) that was run, with the
/// published figure beside the run's.
pub(super) fn rate_rows(
    view: &ScoredRun<'_>,
    heading: &str,
    conditions: &[(String, String)],
) -> Vec<DotRow> {
    let run = conditions.iter().filter_map(|(label, name)| Some((label, name, view.score(name)?)));
    // The standard deviation is the error bar where there is no interval.
    let dot = |mean: f64, std: Option<f64>, interval: Option<Interval>| {
        let interval = interval.map(|interval| (interval.low, interval.high));
        Dot { value: mean, range: interval.or(std.map(|std| (mean - std, mean + std))) }
    };
    let row = |(index, (label, name, score)): (usize, (&String, &String, &ConditionScore))| {
        let published = view.published.of(name).and_then(|published| published.sr);
        DotRow {
            heading: (index == 0).then(|| heading.to_owned()),
            label: label.clone(),
            ours: dot(score.sr.mean, score.sr.std, score.sr.interval),
            published: published.map(|spread| dot(spread.mean, spread.std, None)),
        }
    };
    run.enumerate().map(row).collect()
}

fn images(view: &ScoredRun<'_>, one: &str, four: &str) -> TableCell {
    let score = view.score(one).or_else(|| view.score(four));
    score.map_or(TableCell::Missing(Missing::NotRun), |score| {
        plain_or(score.images_per_request.map(|images| images.mean), 1, NO_REQUESTS)
    })
}

/// Million tokens a hundred cases.
pub(super) fn mega(view: &ScoredRun<'_>, name: &str) -> TableCell {
    view.ours(name, |score| {
        plain_or(score.tokens_per_100.map(|tokens| tokens.mean / 1e6), 1, NO_TOKENS)
    })
}
