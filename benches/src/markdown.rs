//! Results as Markdown: the section of docs/performance.md that `--page` replaces.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::compare::Change;
use crate::figure::shown;
use crate::results::{Results, write_whole};
use crate::table::{self, spread, with_unit};

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
    text += &rows(&table::HEADER, &table::rows(results));
    for outcome in &results.benches {
        text += &format!("\n### `{}`: {}\n\n", outcome.name, outcome.about);
        if outcome.figures.is_empty() {
            text += "No figures.\n";
            continue;
        }
        let lines: Vec<[String; 5]> = outcome
            .figures
            .iter()
            .map(|measured| {
                let figure = &measured.figure;
                let none = || "–".to_owned();
                let parameters: Vec<String> = figure
                    .parameters
                    .iter()
                    .map(|(name, value)| format!("{name} {value}"))
                    .collect();
                let about: Vec<String> = std::iter::once(figure.what.clone())
                    .chain((!parameters.is_empty()).then(|| parameters.join(", ")))
                    .chain(figure.note.clone())
                    .collect();
                let baseline = figure.baseline.as_ref().zip(measured.baseline_summary);
                [
                    about.join("; "),
                    measured.summary.map_or_else(none, |s| with_unit(s, &figure.unit)),
                    baseline.map_or_else(none, |(baseline, s)| {
                        let name = format!("{} {}", baseline.name, baseline.version);
                        format!("{}: {}", name.trim(), with_unit(s, &figure.unit))
                    }),
                    measured.ratio.map_or_else(none, spread),
                    format!("`{}`", figure.id),
                ]
            })
            .collect();
        text += &rows(&["what", "ours", "baseline", "ours / baseline", "id"], &lines);
    }
    text
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
                change.baseline_ratio.map_or_else(|| "–".to_owned(), shown),
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
        assert!(text.contains("not measured yet") && !text.contains("written before"), "{text}");
        fs::write(&path, "no marks").unwrap();
        assert!(insert(&path, &Results::here()).is_err());
    }
}
