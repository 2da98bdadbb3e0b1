//! Table `tab:main`: six representations in the four settings of the three questions, with what they cost.

use results::score::{ConditionScore, Spread};

use crate::document::{Missing, ReportBlock, Table, TableCell, TableColumn};
use crate::plot::{Dot, DotRow, Dots, dots};
use crate::view::{
    OURS, ScoredRun, THEIRS, name, our_rates, pair_stubs, rate_columns, their_rates, title,
};

/// The four settings: heading, start and route, demonstrations.
const SETTINGS: [(&str, &str, &str); 4] = [
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
    let of = |representation, (_, rest, demonstrations): (&str, &str, &str)| {
        name(representation, rest, demonstrations)
    };
    let ours = |representation| {
        let [_, one, four, _] = SETTINGS.map(|setting| of(representation, setting));
        let mut cells = vec![images(view, &one, &four), mega(view, &one), mega(view, &four)];
        let settings = SETTINGS.map(|setting| of(representation, setting));
        cells.extend(settings.iter().flat_map(|name| our_rates(view, name)));
        cells
    };
    let theirs = |representation| {
        let [original, one, four, _] = SETTINGS.map(|setting| of(representation, setting));
        let mut cells = vec![view.theirs(&original, |p| p.img.map(|img| format!("{img:.0}")))];
        let mega = |name: &String| view.theirs(name, |p| p.mtok.map(|mtok| format!("{mtok:.0}")));
        cells.extend([&one, &four].map(mega));
        let settings = SETTINGS.map(|setting| of(representation, setting));
        cells.extend(settings.iter().flat_map(|name| their_rates(view, name)));
        cells
    };
    let table = Table {
        id: view.id("main"),
        caption: "Memory performance across the three questions (the paper's table “Memory performance across the three RQs”). SR: success rate \
                  in percent, mean ± standard deviation over runs, and its 95 % interval in brackets. SPL: \
                  success weighted by path length, mean. Img: images per request; this run's is the mean over all \
                  requests at the new start, where an episode's first steps have a shorter window, and the paper's the \
                  number at full window. Mtok: million prompt and completion tokens per 100 new-start cases. Working \
                  memory uses no demonstrations, so its new-start figures stand in both columns."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    let settings = |representation| {
        SETTINGS.map(|setting| (setting.0.to_owned(), of(representation, setting)))
    };
    let memories = view.memories();
    let rows =
        memories.iter().flat_map(|&memory| rate_rows(view, &title(memory), &settings(memory)));
    let figure = dots_if_any(Dots {
        id: view.id("main-figure"),
        caption: "Success rate in the four settings. Filled: this run with its 95 % interval. Open: published, \
                  mean ± standard deviation."
            .to_owned(),
        axis: "Success rate, %",
        range: (0.0, 100.0),
        series: vec![OURS.to_owned(), THEIRS.to_owned()],
        rows: rows.collect(),
    });
    table.pruned().map(ReportBlock::Table).into_iter().chain(figure).collect()
}

/// The plot, if it has rows.
pub(super) fn dots_if_any(plot: Dots) -> Option<ReportBlock> {
    (!plot.rows.is_empty()).then(|| ReportBlock::Figure(dots(&plot)))
}

/// The rows of a plot of success rates: one for each of the `conditions` (label, name) that was run, with the
/// published figure beside the run's.
pub(super) fn rate_rows(
    view: &ScoredRun<'_>,
    heading: &str,
    conditions: &[(String, String)],
) -> Vec<DotRow> {
    let run = conditions.iter().filter_map(|(label, name)| Some((label, name, view.score(name)?)));
    let row = |(index, (label, name, score)): (usize, (&String, &String, &ConditionScore))| {
        let ours = dot(0, score.sr);
        let published = view.published.of(name).and_then(|published| published.sr);
        let theirs = published.map(|spread| Dot {
            series: 1,
            value: spread.mean,
            range: spread.std.map(|std| (spread.mean - std, spread.mean + std)),
        });
        DotRow {
            heading: (index == 0).then(|| heading.to_owned()),
            label: label.clone(),
            dots: [ours].into_iter().chain(theirs).collect(),
        }
    };
    run.enumerate().map(row).collect()
}

/// A figure with its interval as the error bar, or its standard deviation where there is none.
pub(super) fn dot(series: usize, spread: Spread) -> Dot {
    let interval = spread.interval.map(|interval| (interval.low, interval.high));
    let deviation = spread.std.map(|std| (spread.mean - std, spread.mean + std));
    Dot { series, value: spread.mean, range: interval.or(deviation) }
}

fn images(view: &ScoredRun<'_>, one: &str, four: &str) -> TableCell {
    let Some(score) = view.score(one).or_else(|| view.score(four)) else {
        return TableCell::Missing(Missing::NotRun);
    };
    score.images_per_request.map_or(TableCell::Missing(NO_REQUESTS), |images| {
        TableCell::Value(format!("{:.1}", images.mean))
    })
}

/// Million tokens a hundred cases.
pub(super) fn mega(view: &ScoredRun<'_>, name: &str) -> TableCell {
    view.ours(name, |score| {
        let tokens = score.tokens_per_100.map(|tokens| format!("{:.1}", tokens.mean / 1e6));
        tokens.map_or(TableCell::Missing(NO_TOKENS), TableCell::Value)
    })
}
