//! Results as one HTML page: the table, every bench's figures, curves.

use anyhow::Result;
use results::report::{Block, Curve, Curves, Document, Section, Table, curves, page};

use crate::compare::Change;
use crate::figure::shown;
use crate::results::{Outcome, Results};
use crate::table::{self, spread, with_unit};

/// The page.
///
/// # Errors
/// When a figure cannot be drawn.
pub fn render(results: &Results, changes: Option<&[Change]>) -> Result<String> {
    let mut sections = vec![overview(results)];
    sections.extend(changes.map(compared));
    for outcome in &results.benches {
        sections.push(bench(outcome)?);
    }
    Ok(page(&Document { title: "MemTransfer: benches".to_owned(), sections })?)
}

fn overview(results: &Results) -> Section {
    let mut blocks = vec![Block::Text(format!("Machine: {}.", results.machine.summary()))];
    for outcome in &results.benches {
        if let Some(error) = &outcome.error {
            blocks.push(Block::Notice(format!("The bench {} failed: {error}", outcome.name)));
        }
    }
    let caption = "Targets and what was measured: medians over rounds, the range in brackets; ours and the peer's \
                   in turns.";
    let rows = table::rows(results).into_iter().map(|[label, cells @ ..]| (label, cells.to_vec()));
    blocks.push(Block::Table(Table::of_text(
        "t-targets",
        caption,
        table::HEADER.split_at(1),
        rows,
    )));
    Section::new("s-targets", "Targets", blocks)
}

fn compared(changes: &[Change]) -> Section {
    let caption = "Figures that both files have. A change is called better or worse only where no round of one lies \
                   among the rounds of the other; the peer's own change shows what the machine did meanwhile.";
    let header = ["figure", "before", "now", "now / before", "the peer's", "verdict"];
    let rows = changes.iter().map(|change| {
        let cells = vec![
            with_unit(change.before, &change.unit),
            with_unit(change.now, &change.unit),
            shown(change.ratio),
            change.peer_ratio.map_or_else(|| "–".to_owned(), shown),
            change.verdict.words().to_owned(),
        ];
        (change.id.clone(), cells)
    });
    let table = Table::of_text("t-changes", caption, header.split_at(1), rows);
    Section::new("s-changes", "Since the earlier file", vec![Block::Table(table)])
}

fn bench(outcome: &Outcome) -> Result<Section> {
    let mut blocks = vec![Block::Text(format!(
        "{}. Measured on {} in {} s, commit {}.",
        outcome.about,
        outcome.began,
        shown(outcome.seconds),
        outcome.commit.as_deref().unwrap_or("unknown"),
    ))];
    let header = ["what", "ours", "peer", "peer's", "ours / peer", "parameters", "note"];
    let none = || "–".to_owned();
    let rows = outcome.figures.iter().map(|measured| {
        let figure = &measured.figure;
        let parameters = figure.parameters.iter().map(|(name, value)| format!("{name} {value}"));
        let cells = vec![
            measured.summary.map_or_else(none, |summary| with_unit(summary, &figure.unit)),
            figure
                .peer
                .as_ref()
                .map_or_else(none, |peer| format!("{} {}", peer.name, peer.version)),
            measured.peer_summary.map_or_else(none, |summary| with_unit(summary, &figure.unit)),
            measured.ratio.map_or_else(none, spread),
            parameters.collect::<Vec<_>>().join(", "),
            figure.note.clone().unwrap_or_default(),
        ];
        (figure.what.clone(), cells)
    });
    let id = format!("t-{}", outcome.name);
    blocks.push(Block::Table(Table::of_text(
        id.as_str(),
        outcome.about.as_str(),
        header.split_at(1),
        rows,
    )));
    for plot in plots(outcome) {
        blocks.push(Block::Figure(curves(&plot)?));
    }
    Ok(Section::new(format!("s-{}", outcome.name), outcome.name.as_str(), blocks))
}

/// The curves that a bench's figures are points of, and those of its peers.
fn plots(outcome: &Outcome) -> Vec<Curves> {
    let mut plots: Vec<Curves> = Vec::new();
    for measured in &outcome.figures {
        let figure = &measured.figure;
        let Some(point) = &figure.point else { continue };
        let at = plots.iter().position(|plot| plot.caption == point.plot).unwrap_or_else(|| {
            plots.push(Curves {
                id: format!("f-{}-{}", outcome.name, plots.len()),
                caption: point.plot.clone(),
                across: point.axis.clone(),
                up: figure.unit.clone(),
                curves: Vec::new(),
            });
            plots.len() - 1
        });
        let curves = &mut plots[at].curves;
        let mut add = |name: String, y: f64| {
            let at = curves.iter().position(|curve| curve.name == name).unwrap_or_else(|| {
                curves.push(Curve { name, is_bound: false, points: Vec::new() });
                curves.len() - 1
            });
            curves[at].points.push((point.x, y));
        };
        if let Some(summary) = measured.summary {
            add(point.line.clone(), summary.median);
        }
        if let (Some(peer), Some(summary)) = (&figure.peer, measured.peer_summary) {
            add(format!("{} ({})", point.line, peer.name), summary.median);
        }
    }
    plots
}
