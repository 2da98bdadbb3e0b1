//! One run as the tables see it: its scores by condition beside the published ones; and how figures are written.

use std::collections::BTreeSet;

use conditions::Condition;
use domain::{ExternalName, MemoryKind, Representation};
use run_log::RunLog;
use scores::{ConditionScore, Interval, Scores, Spread};

use super::document::{Missing, RowGroup, TableCell, TableColumn, TableRow};
use super::published::{Published, PublishedCondition, PublishedFigure};

/// One run, scored.
#[derive(Debug)]
pub(super) struct ScoredRun<'a> {
    pub(super) log: &'a RunLog,
    pub(super) scores: Scores,
    pub(super) published: &'a Published,
    /// The prefix of ids of tables and figures; empty for a single run.
    pub(super) prefix: String,
}

impl ScoredRun<'_> {
    /// The id of a table, figure or section.
    pub(super) fn id(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    /// The run's scores of the condition called `name`.
    pub(super) fn score(&self, name: &str) -> Option<&ConditionScore> {
        let condition = Condition::logged(name).ok()?;
        self.scores.of(&condition)
    }

    /// The name of a memory of the run, with the author of its documents if that is not the run's model.
    pub(super) fn label(&self, memory: MemoryKind) -> String {
        self.log.manifest.memory_label(memory)
    }

    /// Whether one of the conditions was run.
    pub(super) fn has_any(&self, names: &[String]) -> bool {
        names.iter().any(|name| self.score(name).is_some())
    }

    /// The built-in representations, and after them the external memories of the run.
    pub(super) fn memories(&self) -> Vec<MemoryKind> {
        let built_in = Representation::ALL.iter().copied().map(MemoryKind::BuiltIn);
        built_in.chain(self.external_memories().into_iter().map(MemoryKind::External)).collect()
    }

    /// All memories but working memory.
    pub(super) fn historical(&self) -> Vec<MemoryKind> {
        self.memories().into_iter().filter(|memory| memory.uses_demonstrations()).collect()
    }

    /// The external memories that have a finished episode, by name.
    pub(super) fn external_memories(&self) -> Vec<ExternalName> {
        let conditions = self.scores.conditions.iter();
        let names: BTreeSet<ExternalName> =
            conditions.filter_map(|score| score.condition.memory.external()).collect();
        names.into_iter().collect()
    }

    /// A cell of this run: the `figure` of the condition called `name`, or that it was not run.
    pub(super) fn ours(
        &self,
        name: &str,
        figure: impl Fn(&ConditionScore) -> TableCell,
    ) -> TableCell {
        self.score(name).map_or(TableCell::Missing(Missing::NotRun), figure)
    }

    /// A published cell: the `figure` of the condition called `name`, or why there is none.
    pub(super) fn theirs(
        &self,
        name: &str,
        figure: impl Fn(&PublishedCondition) -> Option<String>,
    ) -> TableCell {
        let published = self.published.of(name).and_then(figure);
        published.map_or_else(|| self.unpublished(name), TableCell::Value)
    }

    /// Why no figure of the condition called `name` is published.
    fn unpublished(&self, name: &str) -> TableCell {
        let reason = if self.published.is_paper { not_in_the_paper(name) } else { NOT_IN_THE_FILE };
        TableCell::Missing(Missing::NotReported(reason))
    }

    /// Whether a published row stands beside this memory's: for a built-in one, or one that the publication has, where there
    /// are published figures.
    fn is_published(&self, memory: MemoryKind) -> bool {
        let mut conditions = self.published.conditions.iter();
        let is_of = |condition: &PublishedCondition| {
            condition.name.split('/').next() == Some(memory.to_string().as_str())
        };
        match memory.built_in() {
            Some(_) => conditions.next().is_some(),
            None => conditions.any(is_of),
        }
    }

    /// A row of this run for each of `memories`, and a published one where [`is_published`](Self::is_published).
    pub(super) fn pairs(
        &self,
        memories: &[MemoryKind],
        ours: impl Fn(MemoryKind) -> Vec<TableCell>,
        theirs: impl Fn(MemoryKind) -> Vec<TableCell>,
    ) -> Vec<RowGroup> {
        let group = |&memory: &MemoryKind| {
            let ours = TableRow::new(OURS, ours(memory));
            let theirs = self.is_published(memory).then(|| TableRow {
                label: THEIRS.to_owned(),
                published: true,
                cells: theirs(memory),
            });
            let rows = [ours].into_iter().chain(theirs).collect();
            RowGroup { label: Some(self.label(memory)), rows }
        };
        memories.iter().map(group).collect()
    }
}

/// The label of a row with a run's figures.
pub(super) const OURS: &str = "this run";
/// The label of a row with published figures.
pub(super) const THEIRS: &str = "published";

/// The headings of the two label columns of paired rows.
pub(super) fn pair_stubs() -> Vec<String> {
    vec!["Representation".to_owned(), "Source".to_owned()]
}

/// The condition's name: `rest` is `start/route`, and working memory has no demonstrations.
pub(super) fn name(memory: MemoryKind, rest: &str, demonstrations: &str) -> String {
    let demonstrations = if memory.uses_demonstrations() { demonstrations } else { "none" };
    format!("{memory}/{rest}/{demonstrations}")
}

const NOT_IN_THE_FILE: &str = "the publication does not have this figure";

/// Why the paper prints no figure of the condition called `name`.
fn not_in_the_paper(name: &str) -> &'static str {
    let has = |part: &str| name.split('/').any(|word| word == part);
    let memory = name.split('/').next().and_then(|memory| memory.parse().ok());
    let is_external = memory.is_some_and(|memory: MemoryKind| memory.external().is_some());
    if is_external {
        "the paper has no such memory"
    } else if has("hybrid") && (has("4") || has("blocked")) {
        "Hybrid with four demonstrations was not evaluated (serving constraints, section Limitations)"
    } else if has("irrelevant") || has("confusable") {
        "success under mixed histories is printed as a figure without numbers, and retrieval is reported for \
         Episodic only"
    } else if has("no-hint") {
        "of the run without the hint it says only that Full-context changed by two percentage points"
    } else {
        "this figure is not printed"
    }
}

/// A figure with its interval below, if it has one.
pub(super) fn with_interval(
    figure: String,
    interval: Option<Interval>,
    digits: usize,
) -> TableCell {
    match interval {
        Some(found) => TableCell::Sure { figure, interval: interval_text(found, digits) },
        None => TableCell::Value(figure),
    }
}

/// `95.3 ± 0.6` with its interval below.
pub(super) fn sure(spread: Spread, digits: usize) -> TableCell {
    with_interval(spread_text(spread, digits), spread.interval, digits)
}

/// A figure with its interval below, or the reason why there is none.
pub(super) fn sure_or(spread: Option<Spread>, digits: usize, missing: Missing) -> TableCell {
    spread.map_or(TableCell::Missing(missing), |spread| sure(spread, digits))
}

/// A plain figure, or the reason why there is none.
pub(super) fn plain_or(value: Option<f64>, digits: usize, missing: Missing) -> TableCell {
    value.map_or(TableCell::Missing(missing), |value| TableCell::Value(format!("{value:.digits$}")))
}

/// Mean and sample standard deviation over runs.
pub(super) fn spread_text(spread: Spread, digits: usize) -> String {
    match spread.std {
        Some(std) => format!("{:.digits$} ± {std:.digits$}", spread.mean),
        None => format!("{:.digits$}", spread.mean),
    }
}

/// An interval in brackets.
pub(super) fn interval_text(Interval { low, high }: Interval, digits: usize) -> String {
    format!("[{low:.digits$}, {high:.digits$}]").replace('-', "−")
}

/// A published figure with its standard deviation, if it has one.
pub(super) fn published_text(
    PublishedFigure { mean, std }: PublishedFigure,
    digits: usize,
) -> String {
    let deviation = std.map(|std| format!(" ± {std:.digits$}")).unwrap_or_default();
    format!("{mean:.digits$}{deviation}").replace('-', "−")
}

/// A typographic minus before negative numbers, a plus before others.
pub(super) fn signed(value: f64, digits: usize) -> String {
    // Rounded first, so that nothing is printed as -0.0.
    let shown = format!("{:.digits$}", value.abs());
    let is_zero = shown.chars().all(|c| matches!(c, '0' | '.'));
    match (is_zero, value < 0.0) {
        (true, _) => shown,
        (false, true) => format!("−{shown}"),
        (false, false) => format!("+{shown}"),
    }
}

/// Columns of success rate and SPL for each of `settings`.
pub(super) fn rate_columns(settings: &[&str]) -> Vec<TableColumn> {
    let both = |over: &&str| [TableColumn::under(*over, "SR %"), TableColumn::under(*over, "SPL")];
    settings.iter().flat_map(both).collect()
}

/// The run's cells under those columns, of the condition called `name`.
pub(super) fn our_rates(view: &ScoredRun<'_>, name: &str) -> [TableCell; 2] {
    [
        view.ours(name, |score| sure(score.sr, 1)),
        view.ours(name, |score| TableCell::Value(format!("{:.3}", score.spl.mean))),
    ]
}

/// The published cells under those columns.
pub(super) fn their_rates(view: &ScoredRun<'_>, name: &str) -> [TableCell; 2] {
    [
        view.theirs(name, |published| Some(published_text(published.sr?, 1))),
        view.theirs(name, |published| Some(published_text(published.spl?, 3))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_typographic_and_zero_has_none() {
        for (value, shown) in [(-7.66, "−7.7"), (14.3, "+14.3"), (0.0, "0.0"), (-0.04, "0.0")] {
            assert_eq!(signed(value, 1), shown);
        }
    }
}
