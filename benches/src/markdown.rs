//! Results as Markdown: the section of docs/performance.md that `--page` replaces.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::compare::Change;
use crate::figure::{Measurement, MeasurementSummary, shown};
use crate::results::{BenchOutcome, Results, write_whole};

/// Markers around the section of a page that [`insert`] replaces.
const MARKERS: [&str; 2] = ["<!-- written by memtransfer-bench --page -->", "<!-- end -->"];

/// Renders machine, table, every figure, and failures.
pub fn render(results: &Results) -> String {
    let mut text = String::new();
    for outcome in &results.benches {
        if let Some(error) = &outcome.error {
            text += &format!("The bench `{}` failed: {error}\n\n", outcome.name);
        }
    }
    text += &format!("Machine: {}.\n", results.machine.summary());
    let commits: Vec<String> = results
        .benches
        .iter()
        .map(|outcome| {
            let commit = outcome.commit.as_deref().unwrap_or("no commit");
            let short: String = commit.chars().take(10).collect();
            format!(
                "{short}{} on {}",
                if commit.ends_with('+') { "+" } else { "" },
                day(&outcome.began)
            )
        })
        .collect();
    let mut distinct = commits.clone();
    distinct.sort();
    distinct.dedup();
    if !distinct.is_empty() {
        text += &format!("Measured at {}.\n", distinct.join("; "));
    }
    text += "Medians over rounds with the range in parentheses; ours and the baseline alternate on one machine.\n\n";
    let targets: Vec<[String; 8]> = results
        .benches
        .iter()
        .flat_map(|outcome| outcome.figures.iter().filter_map(|figure| target_row(outcome, figure)))
        .collect();
    text += &rows(&TARGET_COLUMNS, &targets);
    for outcome in &results.benches {
        text += &format!("\n### `{}`: {}\n\n", outcome.name, outcome.about);
        if outcome.figures.is_empty() {
            text += "No figures.\n";
            continue;
        }
        let lines: Vec<[String; 5]> = outcome.figures.iter().map(figure_row).collect();
        text += &rows(&["what", "ours", "baseline", "ours / baseline", "id"], &lines);
    }
    text
}

/// Columns of the table of targets.
const TARGET_COLUMNS: [&str; 8] =
    ["what", "against", "target", "ours", "baseline", "ours / baseline", "target met", "command"];

/// The row of a figure in the table of targets; `None` if it has no target.
fn target_row(outcome: &BenchOutcome, figure: &Measurement) -> Option<[String; 8]> {
    let target = figure.target.as_ref()?;
    let [ours, baseline, ratio] = values(figure);
    let met = figure.meets_target().map(|met| if met { "yes" } else { "no" });
    Some([
        figure.what.clone(),
        baseline_name(figure).unwrap_or_default(),
        target.text.clone(),
        ours,
        baseline,
        ratio,
        met.unwrap_or(NONE).to_owned(),
        format!("`cargo xtask bench --only {}`", outcome.name),
    ])
}

/// The row of a figure in the table of its bench.
fn figure_row(figure: &Measurement) -> [String; 5] {
    let parameters: Vec<String> =
        figure.parameters.iter().map(|(name, value)| format!("{name} {value}")).collect();
    let about: Vec<String> = std::iter::once(figure.what.clone())
        .chain((!parameters.is_empty()).then(|| parameters.join(", ")))
        .chain(figure.note.clone())
        .collect();
    let [ours, mut baseline, ratio] = values(figure);
    if let Some(name) = baseline_name(figure) {
        baseline = format!("{name}: {baseline}");
    }
    [about.join("; "), ours, baseline, ratio, format!("`{}`", figure.id)]
}

/// What stands for a value that there is not.
const NONE: &str = "–";

/// Our value, the baseline's, and their ratio.
fn values(figure: &Measurement) -> [String; 3] {
    let unit = figure.unit.as_str();
    [(figure.summary(), unit), (figure.baseline_summary(), unit), (figure.ratio(), "")].map(
        |(summary, unit)| summary.map_or_else(|| NONE.to_owned(), |found| with_unit(found, unit)),
    )
}

/// A median with its unit, and the range unless it is a single value.
fn with_unit(MeasurementSummary { median, min, max }: MeasurementSummary, unit: &str) -> String {
    let range = (min != max).then(|| format!("({} to {})", shown(min), shown(max)));
    let parts = [shown(median), unit.to_owned(), range.unwrap_or_default()];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ")
}

fn baseline_name(figure: &Measurement) -> Option<String> {
    let baseline = figure.baseline.as_ref()?;
    Some(format!("{} {}", baseline.name, baseline.version).trim().to_owned())
}

/// Renders changes since earlier results.
pub fn changes(changes: &[Change]) -> String {
    let lines: Vec<[String; 6]> = changes
        .iter()
        .map(|change| {
            [
                format!("`{}`", change.id),
                with_unit(change.before, &change.unit),
                with_unit(change.now, &change.unit),
                shown(change.ratio),
                change.baseline_ratio.map_or_else(|| NONE.to_owned(), shown),
                change.verdict.words().to_owned(),
            ]
        })
        .collect();
    rows(&["figure", "before", "now", "now / before", "baseline, now / before", "verdict"], &lines)
}

/// Replaces the section between the markers of the page in `path`.
///
/// # Errors
/// When the page cannot be read or written, or has no markers.
pub fn insert(path: &Path, results: &Results) -> Result<()> {
    let page =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let parts = page
        .split_once(MARKERS[0])
        .and_then(|(before, rest)| rest.split_once(MARKERS[1]).map(|(_, after)| (before, after)));
    let Some((before, after)) = parts else {
        bail!("{} has no line {:?} with {:?} after it", path.display(), MARKERS[0], MARKERS[1]);
    };
    let text = format!("{before}{}\n\n{}\n{}{after}", MARKERS[0], render(results), MARKERS[1]);
    write_whole(path, &text)
}

/// Day of an HTTP date.
fn day(date: &str) -> String {
    date.split_whitespace().skip(1).take(3).collect::<Vec<_>>().join(" ")
}

/// Renders a table.
fn rows<const N: usize>(header: &[&str; N], rows: &[[String; N]]) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let cells = |row: &[String; N]| row.iter().map(|cell| cell.replace('|', "\\|")).collect();
    let mut text = line(header.iter().map(|name| (*name).to_owned()).collect());
    text += &line(vec!["---".to_owned(); N]);
    for row in rows {
        text += &line(cells(row));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Better, FigureBound};

    #[test]
    fn a_figure_with_a_target_has_a_row() {
        let hop = Measurement::new("hop.round-trip", "a round trip", "ns", Better::Lower)
            .ours([500.0, 510.0, 490.0])
            .baseline("iceoryx2", "0.10", [400.0, 400.0, 400.0])
            .target(FigureBound::Ratio(1.5), "within 1.5 x");
        let floor = Measurement::new("hop.floor", "no target", "ns", Better::Lower).ours([1.0]);
        let outcome = BenchOutcome {
            name: "hop".to_owned(),
            about: String::new(),
            began: String::new(),
            commit: None,
            seconds: 0.0,
            error: None,
            figures: vec![hop, floor],
        };
        let rows = outcome.figures.iter().map(|figure| target_row(&outcome, figure));
        let rows: Vec<Option<String>> = rows.map(|row| Some(row?.join(" | "))).collect();
        let expected = "a round trip | iceoryx2 0.10 | within 1.5 x | 500 ns (490 to 510) | 400 ns | \
                        1.25 (1.23 to 1.27) | yes | `cargo xtask bench --only hop`";
        assert_eq!(rows, [Some(expected.to_owned()), None]);
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
        insert(&path, &Results::here()).unwrap();
        insert(&path, &Results::here()).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert!(
            text.starts_with("Before.\n<!--") && text.ends_with("<!-- end -->\nAfter.\n"),
            "{text}"
        );
        assert!(text.contains("Machine: ") && !text.contains("written before"), "{text}");
        fs::write(&path, "no marks").unwrap();
        assert!(insert(&path, &Results::here()).is_err());
    }
}
