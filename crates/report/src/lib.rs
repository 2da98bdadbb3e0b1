//! Reports about runs, from their logs alone.
//!
//! Three steps: [`score`](results::score) computes, `sections/` arranges figures into a [`ReportDocument`] of sections, tables
//! and plots, and one file for each format writes it: `html.rs`, `markdown.rs`, `csv.rs`, `parquet.rs`, `terminal.rs`.
//! The published figures are data ([`Published`], `assets/published.toml`).
//!
//! The same logs give the same files, byte for byte.

mod csv;
mod data;
mod document;
mod frame;
mod html;
mod markdown;
mod parquet;
mod plot;
mod published;
mod sections;
mod steps;
pub mod table;
mod terminal;
mod view;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub use data::{episodes_frame, timings_frame};
pub use document::{
    Missing, ReportBlock, ReportDocument, ReportFigure, ReportSection, RowGroup, Table, TableCell,
    TableColumn, TableRow,
};
pub use frame::{DataFrame, Series, Values};
pub use plot::{Curve, Curves, curves};
pub use plot::{Stack, StackRow, stack};
pub use published::{Published, PublishedCondition, PublishedSpread};
pub use steps::steps_frame;
pub use terminal::{compared_runs, comparison, summary};

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use results::log::RunLog;
use results::score::score;
use view::ScoredRun;

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The system refused.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A page could not be rendered from its template.
    #[error("cannot make {page}: {source}; this is a mistake in the program, please report it")]
    Template {
        /// The page.
        page: &'static str,
        /// The template engine's error.
        source: askama::Error,
    },
    /// The built-in figures of the paper cannot be read.
    #[error("assets/published.toml: {0}")]
    Published(#[from] toml::de::Error),
}

/// The report about `logs` as a document.
pub fn document(logs: &[RunLog], published: &Published) -> ReportDocument {
    arrange(&views(logs, published))
}

/// `document` as one self-contained HTML page.
///
/// # Errors
/// When the template fails, which would be a bug.
pub fn page(document: &ReportDocument) -> Result<String, ReportError> {
    let template = |source| ReportError::Template { page: "the page", source };
    html::render(document).map_err(template)
}

fn views<'a>(logs: &'a [RunLog], published: &'a Published) -> Vec<ScoredRun<'a>> {
    let prefix = |place: usize| match logs {
        [_] => String::new(),
        _ => format!("run{place}-"),
    };
    let view =
        |(place, log)| ScoredRun { log, scores: score(log), published, prefix: prefix(place) };
    (1..).zip(logs).map(view).collect()
}

fn arrange(views: &[ScoredRun<'_>]) -> ReportDocument {
    let mut sections = Vec::new();
    let policy = |view: &ScoredRun<'_>| view.log.manifest.policy_label();
    match views {
        [view] => {
            let found = sections::sections(view).into_iter();
            sections.extend(found.map(|section| section.of_policy(&policy(view))));
        }
        _ => {
            let policies = views.iter().map(|view| (view.log.name.as_str(), policy(view)));
            sections.push(sections::runs(views).of_policies(policies));
        }
    }
    sections.push(sections::method());
    let provenance = |view| sections::provenance(view).of_policy(&policy(view));
    sections.extend(views.iter().map(provenance));
    let names: Vec<String> = views.iter().map(|view| view.log.name.clone()).collect();
    ReportDocument { title: format!("MemTransfer: {}", names.join(", ")), sections }
}

/// Writes the report about `logs` into the folder `dir`, which is made if need be; files of an earlier report there
/// are replaced. Returns the page to open.
///
/// | file | holds |
/// |---|---|
/// | `report.html` | everything, in one page |
/// | `report.md`, `figures/` | the same as Markdown, with its figures |
/// | `tables/` | each table as it is printed, as CSV |
/// | `conditions.csv`, `conditions.parquet` | a row for each condition with every figure, in full |
/// | `episodes.csv`, `episodes.parquet` | a row for each episode |
/// | `streams.csv`, `streams.parquet` | of streams: a row for each condition with every figure, in full |
///
/// # Errors
/// When an operation of the system fails.
pub fn write(logs: &[RunLog], dir: &Path) -> Result<PathBuf, ReportError> {
    let published = Published::load()?;
    let views = views(logs, &published);
    let document = arrange(&views);
    let template = |page| move |source| ReportError::Template { page, source };
    let text =
        |name: &str, text: &str| write_file(dir.join(name), |file| file.write_all(text.as_bytes()));
    let page = text("report.html", &html::render(&document).map_err(template("report.html"))?)?;
    text("report.md", &markdown::render(&document).map_err(template("report.md"))?)?;
    for figure in document.figures() {
        text(&format!("figures/{}.svg", figure.id), &figure.svg())?;
    }
    for section in &document.sections {
        for table in section.tables() {
            write_file(dir.join(format!("tables/{}.csv", table.id)), |file| {
                let policy = section.policy.as_deref();
                csv::write_table(table, policy, file).map_err(io::Error::other)
            })?;
        }
    }
    let mut frames =
        vec![("conditions", data::conditions(&views)), ("episodes", data::episodes_frame(logs))];
    if views.iter().any(|view| view.scores.streams.is_some()) {
        frames.push(("streams", data::streams(&views)));
    }
    for (name, frame) in frames {
        write_file(dir.join(format!("{name}.csv")), |file| frame.write_csv(file))?;
        write_file(dir.join(format!("{name}.parquet")), |file| frame.write_parquet(file))?;
    }
    Ok(page)
}

/// Writes the file `path`, and makes its folder.
fn write_file(
    path: PathBuf,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<PathBuf, ReportError> {
    let written = || {
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let mut file = BufWriter::new(File::create(&path)?);
        write(&mut file)?;
        file.flush()
    };
    match written() {
        Ok(()) => Ok(path),
        Err(source) => Err(ReportError::Write { path, source }),
    }
}
