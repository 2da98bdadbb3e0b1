//! Results as Markdown: the section of docs/performance.md that `memtransfer-bench page` writes.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::compare::Change;
use crate::figure::{BaselineFigure, Measurement, MeasurementSummary, shown};
use crate::results::{BenchOutcome, Results, write_whole};

/// Markers around the section of a page that [`insert`] replaces.
const MARKERS: [&str; 2] = ["<!-- written by memtransfer-bench page -->", "<!-- end -->"];

/// Results of a machine under its name in the tables.
#[derive(Debug, Clone, Copy)]
pub struct Column<'a> {
    /// Heading of its column.
    pub name: &'a str,
    /// What was measured there.
    pub results: &'a Results,
}

/// Renders the machines, a table of the targets with a column for each machine, every figure, and failures.
pub fn render(columns: &[Column<'_>]) -> String {
    let mut text = String::new();
    for Column { name, results } in columns {
        for outcome in &results.benches {
            if let Some(error) = &outcome.error {
                text += &format!("The bench `{}` failed on {name}: {error}\n\n", outcome.name);
            }
        }
    }
    for Column { name, results } in columns {
        let measured = measured_at(results);
        text += &format!("- {name}: {}.{measured}\n", results.machine.summary());
    }
    text += "\nA cell is ours / the baseline's = their ratio. Medians over rounds, with the range in parentheses; ours \
             and the baseline alternate on one machine.\n\n";
    let benches = benches_of(columns);
    let targets = benches.iter().flat_map(|(outcome, rows)| {
        let rows = rows.iter().filter(|row| row.first().target.is_some());
        rows.map(|row| row.target_line(&outcome.name))
    });
    text += &table(columns, &["what", "against", "target"], &["command"], targets);
    for (outcome, rows) in &benches {
        text += &format!("\n### `{}`: {}\n\n", outcome.name, outcome.about);
        if rows.is_empty() {
            text += "No figures.\n";
        } else {
            text += &table(columns, &["what"], &["id"], rows.iter().map(FigureRow::line));
        }
    }
    text
}

/// The commits at which these results were measured.
fn measured_at(results: &Results) -> String {
    let commits: BTreeSet<String> = results
        .benches
        .iter()
        .map(|outcome| {
            let commit = outcome.commit.as_deref().unwrap_or("no commit");
            let short: String = commit.chars().take(10).collect();
            let changed = if commit.ends_with('+') { "+" } else { "" };
            format!("{short}{changed} on {}", day(&outcome.began))
        })
        .collect();
    if commits.is_empty() {
        return String::new();
    }
    format!(" Measured at {}.", commits.into_iter().collect::<Vec<_>>().join("; "))
}

/// A figure on each machine; `None` where it was not measured.
struct FigureRow<'a>(Vec<Option<&'a Measurement>>);

/// Every bench with its figures, in the order of the first machine that has it.
fn benches_of<'a>(columns: &[Column<'a>]) -> Vec<(&'a BenchOutcome, Vec<FigureRow<'a>>)> {
    let mut benches: Vec<(&BenchOutcome, Vec<FigureRow<'_>>)> = Vec::new();
    for (number, column) in columns.iter().enumerate() {
        for outcome in &column.results.benches {
            let known = benches.iter().position(|(known, _)| known.name == outcome.name);
            let place = known.unwrap_or_else(|| {
                benches.push((outcome, Vec::new()));
                benches.len() - 1
            });
            let rows = &mut benches[place].1;
            for figure in &outcome.figures {
                let known = rows.iter().position(|row| row.first().id == figure.id);
                let row = known.unwrap_or_else(|| {
                    rows.push(FigureRow(vec![None; columns.len()]));
                    rows.len() - 1
                });
                rows[row].0[number] = Some(figure);
            }
        }
    }
    benches
}

impl<'a> FigureRow<'a> {
    /// The figure on the first machine that has it.
    fn first(&self) -> &'a Measurement {
        let first = self.0.iter().flatten().next();
        first.unwrap_or_else(|| unreachable!("a row is made for a figure"))
    }

    /// The line in the table of targets.
    fn target_line(&self, bench: &str) -> Vec<String> {
        let first = self.first();
        let target = first.target.as_ref().map(|target| target.text.clone());
        let against = first.baseline.as_ref().map(|baseline| baseline.name.clone());
        let mut line =
            vec![first.what.clone(), against.unwrap_or_default(), target.unwrap_or_default()];
        line.extend(self.0.iter().map(|figure| match figure {
            Some(figure) => values(figure) + missed(figure),
            None => NONE.to_owned(),
        }));
        line.push(format!("`cargo xtask bench --only {bench}`"));
        line
    }

    /// The line in the table of its bench. Parameters that differ between the machines are in their cells.
    fn line(&self) -> Vec<String> {
        let first = self.first();
        let about = self.0.iter().flatten().map(|figure| parameters(figure));
        let common = about.reduce(|mut common, other| {
            common.retain(|parameter| other.contains(parameter));
            common
        });
        let common = common.unwrap_or_default();
        let mut line = vec![
            std::iter::once(first.what.clone())
                .chain((!common.is_empty()).then(|| common.join(", ")))
                .chain(first.note.clone())
                .collect::<Vec<_>>()
                .join("; "),
        ];
        line.extend(self.0.iter().map(|figure| match figure {
            Some(figure) => {
                let own = parameters(figure).into_iter().filter(|one| !common.contains(one));
                std::iter::once(values(figure)).chain(own).collect::<Vec<_>>().join("; ")
            }
            None => NONE.to_owned(),
        }));
        line.push(format!("`{}`", first.id));
        line
    }
}

/// What a figure was measured with, its baseline among it.
fn parameters(figure: &Measurement) -> Vec<String> {
    let parameters = figure.parameters.iter().map(|(name, value)| format!("{name} {value}"));
    let baseline = figure.baseline.as_ref().map(|BaselineFigure { name, version, .. }| {
        format!("against {name} {version}").trim_end().to_owned()
    });
    baseline.into_iter().chain(parameters).collect()
}

/// What stands for a figure that was not measured.
const NONE: &str = "–";

/// Our value; with a baseline, its value and their ratio, too.
fn values(figure: &Measurement) -> String {
    let with_unit = |summary: Option<MeasurementSummary>, unit: &str| {
        summary.map_or_else(|| NONE.to_owned(), |found| with_unit(found, unit))
    };
    let ours = with_unit(figure.summary(), &figure.unit);
    if figure.baseline.is_none() {
        return ours;
    }
    let baseline = with_unit(figure.baseline_summary(), &figure.unit);
    format!("{ours} / {baseline} = {}", with_unit(figure.ratio(), ""))
}

/// Says so where a target is missed.
fn missed(figure: &Measurement) -> &'static str {
    if figure.meets_target() == Some(false) { "; **missed**" } else { "" }
}

/// A median with its unit, and the range unless it is a single value.
fn with_unit(MeasurementSummary { median, min, max }: MeasurementSummary, unit: &str) -> String {
    let range = (min != max).then(|| format!("({} to {})", shown(min), shown(max)));
    let parts = [shown(median), unit.to_owned(), range.unwrap_or_default()];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ")
}

/// Renders changes since earlier results.
pub fn changes(changes: &[Change]) -> String {
    let lines = changes.iter().map(|change| {
        vec![
            format!("`{}`", change.id),
            with_unit(change.before, &change.unit),
            with_unit(change.now, &change.unit),
            shown(change.ratio),
            change.baseline_ratio.map_or_else(|| NONE.to_owned(), shown),
            change.verdict.words().to_owned(),
        ]
    });
    rows(&["figure", "before", "now", "now / before", "baseline, now / before", "verdict"], lines)
}

/// Replaces the section between the markers of the page in `path`.
///
/// # Errors
/// When the page cannot be read or written, or has no markers.
pub fn insert(path: &Path, columns: &[Column<'_>]) -> Result<()> {
    let page =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let parts = page
        .split_once(MARKERS[0])
        .and_then(|(before, rest)| rest.split_once(MARKERS[1]).map(|(_, after)| (before, after)));
    let Some((before, after)) = parts else {
        bail!("{} has no line {:?} with {:?} after it", path.display(), MARKERS[0], MARKERS[1]);
    };
    let text = format!("{before}{}\n\n{}\n{}{after}", MARKERS[0], render(columns), MARKERS[1]);
    write_whole(path, &text)
}

/// Day of an HTTP date.
fn day(date: &str) -> String {
    date.split_whitespace().skip(1).take(3).collect::<Vec<_>>().join(" ")
}

/// Renders a table with a column for each machine between these.
fn table(
    columns: &[Column<'_>],
    before: &[&str],
    after: &[&str],
    lines: impl Iterator<Item = Vec<String>>,
) -> String {
    let names = columns.iter().map(|column| column.name);
    let header: Vec<&str> =
        before.iter().copied().chain(names).chain(after.iter().copied()).collect();
    rows(&header, lines)
}

/// Renders a table.
fn rows(header: &[&str], lines: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let mut text = line(header.iter().map(|name| (*name).to_owned()).collect());
    text += &line(vec!["---".to_owned(); header.len()]);
    for cells in lines {
        text += &line(cells.iter().map(|cell| cell.replace('|', "\\|")).collect());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Better, FigureBound};

    fn results(figures: Vec<Measurement>) -> Results {
        let outcome = BenchOutcome {
            name: "hop".to_owned(),
            about: "hops".to_owned(),
            began: String::new(),
            commit: None,
            seconds: 0.0,
            error: None,
            figures,
        };
        Results { benches: vec![outcome], ..Results::here() }
    }

    #[test]
    fn machines_stand_side_by_side() {
        let hop = |theirs: f64| {
            Measurement::new("hop.round-trip", "a round trip", "ns", Better::Lower)
                .ours([500.0, 510.0, 490.0])
                .baseline("iceoryx2", "0.10", [theirs; 3])
                .target(FigureBound::Ratio(1.5), "within 1.5 x")
                .parameter("bytes", 40)
                .parameter("cores", theirs)
        };
        let floor = Measurement::new("hop.floor", "the floor", "ns", Better::Lower).ours([1.0]);
        let (one, two) = (results(vec![hop(400.0)]), results(vec![floor, hop(200.0)]));
        let columns = [Column { name: "A", results: &one }, Column { name: "B", results: &two }];
        let text = render(&columns);
        for line in [
            "| what | against | target | A | B | command |",
            "| a round trip | iceoryx2 | within 1.5 x | 500 ns (490 to 510) / 400 ns = 1.25 (1.23 to 1.27) | 500 ns \
             (490 to 510) / 200 ns = 2.50 (2.45 to 2.55); **missed** | `cargo xtask bench --only hop` |",
            "| a round trip; against iceoryx2 0.10, bytes 40 | 500 ns (490 to 510) / 400 ns = 1.25 (1.23 to 1.27); cores \
             400 | 500 ns (490 to 510) / 200 ns = 2.50 (2.45 to 2.55); cores 200 | `hop.round-trip` |",
            "| the floor | – | 1.00 ns | `hop.floor` |",
        ] {
            assert!(text.lines().any(|found| found == line), "no line {line:?} in\n{text}");
        }
    }

    #[test]
    fn text_outside_the_markers_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("page.md");
        fs::write(
            &path,
            format!("Before.\n{}\nwritten before\n{}\nAfter.\n", MARKERS[0], MARKERS[1]),
        )
        .unwrap();
        let here = Results::here();
        let columns = [Column { name: "this machine", results: &here }];
        insert(&path, &columns).unwrap();
        insert(&path, &columns).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert!(
            text.starts_with("Before.\n<!--") && text.ends_with("<!-- end -->\nAfter.\n"),
            "{text}"
        );
        assert!(text.contains("- this machine: ") && !text.contains("written before"), "{text}");
        fs::write(&path, "no marks").unwrap();
        assert!(insert(&path, &columns).is_err());
    }
}
