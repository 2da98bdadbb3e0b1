//! The document model: sections of text, tables and figures, rendered as HTML, CSV and in a terminal.
//!
//! A [`TableCell`] cannot be empty: where there is no figure, it gives the reason.

use run_log::policy::PolicyLabel;

use super::plot::ReportFigure;

/// A whole report.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportDocument {
    /// The title.
    pub title: String,
    /// The sections, in order.
    pub sections: Vec<ReportSection>,
}

impl ReportDocument {
    /// All tables, in order.
    pub fn tables(&self) -> impl Iterator<Item = &Table> {
        self.sections.iter().flat_map(ReportSection::tables)
    }

    /// All figures, in order.
    pub fn figures(&self) -> impl Iterator<Item = &ReportFigure> {
        let blocks = self.sections.iter().flat_map(|section| &section.blocks);
        blocks.filter_map(|block| match block {
            ReportBlock::Figure(figure) => Some(figure),
            _ => None,
        })
    }
}

/// A section.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportSection {
    /// Unique in the document; usable in a link.
    pub id: String,
    /// 2 for a section, 3 for one inside the section before it.
    pub level: u8,
    /// Its heading.
    pub title: String,
    /// The content.
    pub blocks: Vec<ReportBlock>,
    /// Whose figures it holds; `None` where they are not a policy's.
    pub policy: Option<String>,
}

impl ReportSection {
    /// Makes a top-level section.
    pub fn new(id: impl Into<String>, title: impl Into<String>, blocks: Vec<ReportBlock>) -> Self {
        Self { id: id.into(), level: 2, title: title.into(), blocks, policy: None }
    }

    /// The section with figures of `policy`, a policy's label. The caption of every table and figure and every image name it: each
    /// of them can be shown without the rest of the report.
    fn with_policy(mut self, policy: &str) -> Self {
        self.policy = Some(policy.to_owned());
        for block in &mut self.blocks {
            match block {
                ReportBlock::Table(table) => table.caption += &policy_note(policy),
                ReportBlock::Figure(figure) => figure.add_note(&policy_note(policy)),
                ReportBlock::Text(_) | ReportBlock::Notice(_) | ReportBlock::Terms(_) => {}
            }
        }
        self
    }

    /// The section with figures of one run's policy.
    pub(super) fn of_policy(self, policy: &PolicyLabel) -> Self {
        self.with_policy(&policy.to_string())
    }

    /// The section with figures of several runs, each with the label of its policy.
    pub(super) fn of_policies<'a>(
        self,
        runs: impl Iterator<Item = (&'a str, PolicyLabel)>,
    ) -> Self {
        let labels: Vec<String> = runs.map(|(run, policy)| format!("{run}: {policy}")).collect();
        self.with_policy(&labels.join("; "))
    }

    /// The tables, in order.
    pub(super) fn tables(&self) -> impl Iterator<Item = &Table> {
        self.blocks.iter().filter_map(|block| match block {
            ReportBlock::Table(table) => Some(table),
            _ => None,
        })
    }
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum ReportBlock {
    /// A paragraph.
    Text(String),
    /// A paragraph that must not be missed.
    Notice(String),
    /// Terms and what they mean.
    Terms(Vec<(String, String)>),
    /// A table.
    Table(Table),
    /// A figure.
    Figure(ReportFigure),
}

impl ReportBlock {
    /// The tables that there are.
    pub(super) fn tables(tables: impl IntoIterator<Item = Option<Table>>) -> Vec<Self> {
        tables.into_iter().flatten().map(Self::Table).collect()
    }
}

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Unique in the document; the name of its CSV file.
    pub id: String,
    /// The caption.
    pub caption: String,
    /// The headings of the label columns: two where rows come in groups, else one.
    pub stubs: Vec<String>,
    /// The other columns.
    pub columns: Vec<TableColumn>,
    /// The rows.
    pub groups: Vec<RowGroup>,
}

/// A column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableColumn {
    /// A heading shared with its neighbours, or empty.
    pub over: String,
    /// Its own heading.
    pub name: String,
    /// Whether its cells are text, which is aligned to the left; figures are aligned to the right.
    pub is_text: bool,
}

/// Rows that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct RowGroup {
    /// Their common label; `None` in tables with one label column.
    pub label: Option<String>,
    /// The rows.
    pub rows: Vec<TableRow>,
}

/// A row.
#[derive(Debug, Clone, PartialEq)]
pub struct TableRow {
    /// The label.
    pub label: String,
    /// Whether the figures are the published ones, not a run's.
    pub published: bool,
    /// One cell per column.
    pub cells: Vec<TableCell>,
}

impl TableRow {
    /// Makes a row that is not of published figures.
    pub fn new(label: impl Into<String>, cells: Vec<TableCell>) -> Self {
        Self { label: label.into(), published: false, cells }
    }
}

/// A cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TableCell {
    /// A figure or a word.
    Value(String),
    /// A figure with an interval.
    Sure {
        /// The figure.
        figure: String,
        /// Its interval.
        interval: String,
    },
    /// No figure.
    Missing(Missing),
}

/// Why there is no figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Missing {
    /// The run has no episode of the condition.
    NotRun,
    /// The run did not measure it: why.
    NotMeasured(&'static str),
    /// The paper does not print it: why.
    NotReported(&'static str),
    /// It is not defined for what happened: why.
    Undefined(&'static str),
    /// There is no such thing there: why.
    NotApplicable(&'static str),
}

impl Missing {
    /// The mark in the cell.
    pub const fn mark(&self) -> &'static str {
        match self {
            Self::NotRun => "not run",
            Self::NotMeasured(_) => "n/m",
            Self::NotReported(_) => "—",
            Self::Undefined(_) => "undef.",
            Self::NotApplicable(_) => "n/a",
        }
    }

    /// The note below the table that explains the mark.
    pub fn reason(&self) -> Option<String> {
        match self {
            Self::NotRun => None,
            Self::NotMeasured(why) => Some(format!("n/m, not measured: {why}")),
            Self::NotReported(why) => Some(format!("—, not published: {why}")),
            Self::Undefined(why) => Some(format!("undef., undefined: {why}")),
            Self::NotApplicable(why) => Some(format!("n/a, does not exist: {why}")),
        }
    }
}

impl TableCell {
    /// The cell as one line of text.
    pub fn text(&self) -> String {
        match self {
            Self::Value(value) => value.clone(),
            Self::Sure { figure, interval } => format!("{figure} {interval}"),
            Self::Missing(missing) => missing.mark().to_owned(),
        }
    }
}

/// What a caption says about the policy whose figures it is about.
fn policy_note(policy: &str) -> String {
    format!(" Policy: {policy}.")
}

impl Table {
    /// Makes a table whose cells are text: the headings of the label columns and of the others, and for each row a
    /// label and its cells.
    pub fn of_text(
        id: impl Into<String>,
        caption: impl Into<String>,
        (stubs, columns): (&[&str], &[&str]),
        rows: impl IntoIterator<Item = (String, Vec<String>)>,
    ) -> Self {
        let row = |(label, cells): (String, Vec<String>)| {
            TableRow::new(label, cells.into_iter().map(TableCell::Value).collect())
        };
        Self {
            id: id.into(),
            caption: caption.into(),
            stubs: stubs.iter().map(|stub| (*stub).to_owned()).collect(),
            columns: columns.iter().map(|name| TableColumn::new(*name)).collect(),
            groups: vec![RowGroup { label: None, rows: rows.into_iter().map(row).collect() }],
        }
    }

    /// Makes the columns with these headings columns of text.
    pub fn with_text(mut self, headings: &[&str]) -> Self {
        for column in &mut self.columns {
            column.is_text |= headings.contains(&column.name.as_str());
        }
        self
    }

    /// Removes what was not run: rows of the run without a figure, published rows whose group has no other row, and
    /// columns without a figure. `None` when nothing is left.
    pub fn pruned(mut self) -> Option<Self> {
        for group in &mut self.groups {
            group.rows.retain(|row| row.published || row.cells.iter().any(TableCell::is_figure));
        }
        self.groups.retain(|group| group.rows.iter().any(|row| !row.published));
        let rows = || self.groups.iter().flat_map(|group| &group.rows);
        let was_run = |column: usize| {
            rows().any(|row| {
                !row.published
                    && row.cells.get(column) != Some(&TableCell::Missing(Missing::NotRun))
            })
        };
        let kept: Vec<bool> = (0..self.columns.len()).map(was_run).collect();
        for row in self.groups.iter_mut().flat_map(|group| &mut group.rows) {
            keep(&mut row.cells, &kept);
        }
        keep(&mut self.columns, &kept);
        (!self.groups.is_empty()).then_some(self)
    }

    /// The reasons for its missing figures, each once, in order.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for cell in self.cells() {
            if let Some(reason) = cell.missing().and_then(Missing::reason)
                && !notes.contains(&reason)
            {
                notes.push(reason);
            }
        }
        notes
    }

    /// The number of the cell's reason in [`Table::notes`], from 1.
    pub fn note_of(&self, cell: &TableCell) -> Option<usize> {
        let reason = cell.missing()?.reason()?;
        Some(1 + self.notes().iter().position(|note| *note == reason)?)
    }

    /// All cells, row by row.
    pub fn cells(&self) -> impl Iterator<Item = &TableCell> {
        self.groups.iter().flat_map(|group| &group.rows).flat_map(|row| &row.cells)
    }

    /// The headings that neighbouring columns share, each with its number of columns.
    pub fn spans(&self) -> Vec<(&str, usize)> {
        let mut spans: Vec<(&str, usize)> = Vec::new();
        for column in &self.columns {
            match spans.last_mut() {
                Some((over, count)) if *over == column.over && !over.is_empty() => *count += 1,
                _ => spans.push((&column.over, 1)),
            }
        }
        spans
    }

    /// The headings of all columns, with those that they share before them.
    pub(super) fn headings(&self) -> impl Iterator<Item = String> {
        let columns = self.columns.iter().map(|column| match column.over.as_str() {
            "" => column.name.clone(),
            over => format!("{over}: {}", column.name),
        });
        self.stubs.iter().cloned().chain(columns)
    }

    /// Whether columns share a heading.
    pub fn has_spans(&self) -> bool {
        self.columns.iter().any(|column| !column.over.is_empty())
    }
}

fn keep<T>(list: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    list.retain(|_| kept.next().is_none_or(|kept| *kept));
}

impl TableCell {
    /// Whether it is a figure, or would be one if it had been measured or defined.
    pub(super) fn is_figure(&self) -> bool {
        !matches!(self, Self::Missing(Missing::NotRun | Missing::NotApplicable(_)))
    }

    fn missing(&self) -> Option<&Missing> {
        match self {
            Self::Missing(missing) => Some(missing),
            Self::Value(_) | Self::Sure { .. } => None,
        }
    }
}

impl TableColumn {
    /// A column of its own.
    pub fn new(name: impl Into<String>) -> Self {
        Self { over: String::new(), name: name.into(), is_text: false }
    }

    /// A column under a heading that it shares with its neighbours.
    pub fn under(over: impl Into<String>, name: impl Into<String>) -> Self {
        Self { over: over.into(), name: name.into(), is_text: false }
    }

    /// A column of text.
    pub fn text(name: impl Into<String>) -> Self {
        Self { is_text: true, ..Self::new(name) }
    }
}
