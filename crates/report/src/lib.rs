//! Reports about runs, from their logs alone.
//!
//! Three steps: [`score`](scores) computes, `sections/` arranges figures into a [`ReportDocument`] of sections, tables
//! and plots, and one file for each format writes it: `html.rs`, `csv.rs`, `parquet.rs`, `latex.rs`, `terminal.rs`.
//! Published figures are data ([`Published`], `assets/published.toml`).
//!
//! The same logs give the same files, byte for byte.

mod csv;
mod data;
mod document;
mod frame;
mod frame_file;
mod gates;
mod html;
mod latex;
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

pub use data::{episodes_frame, timings_frame, world_facts};
pub use document::{
    Missing, ReportBlock, ReportDocument, ReportSection, RowGroup, Table, TableCell, TableColumn,
    TableRow,
};
pub use frame::{DataFrame, Series, Value, Values};
pub use frame_file::{FrameFile, TableFormat};
pub use gates::gates;
pub use plot::{Curve, Curves, ReportFigure, Stack, StackRow, curves, stack};
pub use published::{Published, PublishedCondition, PublishedError, PublishedFigure};
pub use steps::steps_frame;
pub use terminal::{compared_runs, comparison, summary};

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use durable::{FolderDraft, KnownNames};
use run_log::{REPORT_FOLDER, RunLog, report_names};
use scores::{Successes, score};
use view::ScoredRun;

/// The page.
const PAGE: &str = "report.html";

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
    /// The folder holds something else.
    #[error("{} is no part of a report, and is not removed: choose another --out", .0.display())]
    NotAReport(PathBuf),
    /// A page could not be rendered from its template.
    #[error("cannot make {page}: {source}; this is a mistake in the program, please report it")]
    Template {
        /// The page.
        page: &'static str,
        /// The template engine's error.
        source: askama::Error,
    },
    /// The built-in figures of the paper cannot be read.
    #[error(transparent)]
    Published(#[from] PublishedError),
}

/// The report about `logs` as a document, with the `published` figures in its tables.
pub fn document(logs: &[RunLog], published: &Published) -> ReportDocument {
    arrange(&views(logs, published), false)
}

/// `document` as one self-contained HTML page.
///
/// # Errors
/// When the template fails, which would be a bug.
pub fn page(document: &ReportDocument) -> Result<String, ReportError> {
    let template = |source| ReportError::Template { page: "the page", source };
    html::render(document).map_err(template)
}

/// What a report has beside its own figures.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options<'a> {
    /// Figures that the run is set beside; without them, those of the paper.
    pub against: Option<&'a Published>,
    /// Whether tables are written as LaTeX as well.
    pub latex: bool,
}

static NOTHING_PUBLISHED: LazyLock<Published> = LazyLock::new(Published::default);

fn views<'a>(logs: &'a [RunLog], published: &'a Published) -> Vec<ScoredRun<'a>> {
    let prefix = |place: usize| match logs {
        [_] => String::new(),
        _ => format!("run{place}-"),
    };
    let view = |(place, log): (usize, &'a RunLog)| {
        // What the paper prints is about the warehouse.
        let is_elsewhere = log.manifest.settings.own_world().is_some();
        let published =
            if is_elsewhere && published.is_paper { &*NOTHING_PUBLISHED } else { published };
        ScoredRun { log, scores: score(log), published, prefix: prefix(place) }
    };
    (1..).zip(logs).map(view).collect()
}

/// The report, of a single run with a section about the published figures if `is_reproduction`.
fn arrange(views: &[ScoredRun<'_>], is_reproduction: bool) -> ReportDocument {
    let mut sections = Vec::new();
    let policy = |view: &ScoredRun<'_>| view.log.manifest.policy_label();
    match views {
        [view] => {
            let mut found = sections::sections(view);
            if is_reproduction {
                // After the overview.
                found.insert(found.len().min(1), sections::reproduction(view));
            }
            sections.extend(found.into_iter().map(|section| section.of_policy(&policy(view))));
        }
        _ => {
            let policies = views.iter().map(|view| (view.log.name.as_str(), policy(view)));
            sections.push(sections::ranking(views).of_policies(policies.clone()));
            sections.push(sections::runs(views).of_policies(policies));
        }
    }
    sections.push(sections::method());
    let provenance = |view| sections::provenance(view).of_policy(&policy(view));
    sections.extend(views.iter().map(provenance));
    let names: Vec<String> = views.iter().map(|view| view.log.name.clone()).collect();
    ReportDocument { title: format!("MemTransfer: {}", names.join(", ")), sections }
}

/// Writes the report about `logs` as the folder `dir`, in place of an earlier report there: a kill at any moment leaves one
/// or the other. Returns the page to open. `against` are published figures to set beside those of a single run, with a section
/// about each of them; without them, the tables have the paper's.
///
/// | file | holds |
/// |---|---|
/// | `report.html` | everything, in one page |
/// | `figures/` | its figures, as SVG and as PDF |
/// | `tables/` | each table as it is printed, as CSV and, if asked for, as LaTeX |
/// | `conditions.csv`, `conditions.parquet` | a row for each condition with every figure, in full |
/// | `episodes.csv`, `episodes.parquet` | a row for each episode |
/// | `published.toml` | of a single run: its figures in the format of published ones, for others to set theirs beside |
/// | `streams.csv`, `streams.parquet` | of streams: a row for each condition with every figure, in full |
///
/// # Errors
/// When the folder holds something else, or an operation of the system fails.
pub fn write(logs: &[RunLog], dir: &Path, options: Options<'_>) -> Result<PathBuf, ReportError> {
    // Without the page, the files are someone else's, whatever their names are.
    let has_page = fs::symlink_metadata(dir.join(PAGE)).is_ok();
    let names = if has_page { report_names() } else { KnownNames::new([]) };
    let others = names.and_then(|names| others_in(dir, &names)).map_err(failed(dir))?;
    if let Some(other) = others.first() {
        return Err(ReportError::NotAReport(dir.join(other)));
    }
    replace(logs, dir, options, &[])
}

/// Writes the report about the run `log` into the run's folder, as [`write()`]. Returns the page to open, and what is in the report's
/// folder and no part of a report, which stays there.
///
/// # Errors
/// When an operation of the system fails.
pub fn write_in_place(
    log: &RunLog,
    options: Options<'_>,
) -> Result<(PathBuf, Vec<PathBuf>), ReportError> {
    let dir = log.dir.join(REPORT_FOLDER);
    let names = report_names().map_err(failed(&dir))?;
    let others = others_in(&dir, &names).map_err(failed(&dir))?;
    let page = replace(std::slice::from_ref(log), &dir, options, &others)?;
    Ok((page, others.iter().map(|path| dir.join(path)).collect()))
}

fn replace(
    logs: &[RunLog],
    dir: &Path,
    options: Options<'_>,
    others: &[PathBuf],
) -> Result<PathBuf, ReportError> {
    let draft = FolderDraft::new(dir).map_err(failed(dir))?;
    write_files(logs, draft.path(), options)?;
    draft.keep(others).and_then(|()| draft.finish()).map_err(failed(dir))?;
    Ok(dir.join(PAGE))
}

fn failed(dir: &Path) -> impl Fn(io::Error) -> ReportError {
    move |source| ReportError::Write { path: dir.to_owned(), source }
}

/// What is in the folder `dir` and has none of the `names`. A symbolic link is replaced, not what it points to.
fn others_in(dir: &Path, names: &KnownNames) -> io::Result<Vec<PathBuf>> {
    match fs::symlink_metadata(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Ok(found) if found.is_symlink() => Ok(Vec::new()),
        _ => names.others_in(dir),
    }
}

/// Writes the files of the report into the folder `dir`.
fn write_files(logs: &[RunLog], dir: &Path, options: Options<'_>) -> Result<(), ReportError> {
    let paper = Published::paper()?;
    let Options { against, latex } = options;
    let views = views(logs, against.unwrap_or(&paper));
    let document = arrange(&views, against.is_some());
    let text =
        |name: &str, text: &str| write_file(dir.join(name), |file| file.write_all(text.as_bytes()));
    text(PAGE, &page(&document)?)?;
    for figure in document.figures() {
        text(&format!("figures/{}.svg", figure.id), &figure.svg())?;
        let pdf = figure.pdf();
        write_file(dir.join(format!("figures/{}.pdf", figure.id)), |file| file.write_all(&pdf))?;
    }
    for section in &document.sections {
        for table in section.tables() {
            write_file(dir.join(format!("tables/{}.csv", table.id)), |file| {
                let policy = section.policy.as_deref();
                csv::write_table(table, policy, file).map_err(io::Error::other)
            })?;
            if latex {
                text(&format!("tables/{}.tex", table.id), &latex::table(table))?;
            }
        }
    }
    let successes: Vec<Successes> = logs.iter().map(|log| log.episodes.iter().collect()).collect();
    let runs: Vec<(&RunLog, &Successes)> = logs.iter().zip(&successes).collect();
    let facts = world_facts(logs.iter().flat_map(|log| &log.episodes));
    let episodes = data::episodes_frame(&runs, &facts);
    let mut frames = vec![("conditions", data::conditions(&views)), ("episodes", episodes)];
    if views.iter().any(|view| view.scores.streams.is_some()) {
        frames.push(("streams", data::streams(&views)));
    }
    if let [view] = &views[..]
        && let Some(figures) = published::of_run(view.log, &view.scores)
    {
        text("published.toml", &figures)?;
    }
    for (name, frame) in frames {
        for format in [TableFormat::Csv, TableFormat::Parquet] {
            let path = dir.join(format!("{name}.{}", format.extension()));
            write_file(path, |file| frame.write(format, file))?;
        }
    }
    Ok(())
}

/// Writes the file `path`, and makes its folder.
fn write_file(
    path: PathBuf,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ReportError> {
    let written = || {
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let mut file = BufWriter::new(File::create(&path)?);
        write(&mut file)?;
        file.flush()
    };
    written().map_err(|source| ReportError::Write { path, source })
}

#[cfg(test)]
mod folder_tests {
    use std::os::unix::fs::symlink;

    use rigs::records::{log, record};

    use super::*;

    #[test]
    fn a_report_replaces_a_report_and_nothing_else() {
        let base = tempfile::tempdir().unwrap();
        let logs = [log(vec![record("t01-01", true)])];
        let dir = base.path().join("report");
        let page = write(&logs, &dir, Options::default()).unwrap();
        let text = fs::read(&page).unwrap();
        // What the page links to stays as it is, and so does what the folder links to.
        let mine = base.path().join("mine");
        fs::create_dir(&mine).unwrap();
        fs::write(mine.join("report.html"), "mine").unwrap();
        fs::remove_file(&page).unwrap();
        symlink(mine.join("report.html"), &page).unwrap();
        fs::remove_file(dir.join("episodes.csv")).unwrap();
        write(&logs, &dir, Options::default()).unwrap();
        assert!(
            fs::symlink_metadata(&page).unwrap().is_file() && dir.join("episodes.csv").exists()
        );
        fs::remove_dir_all(&dir).unwrap();
        symlink(&mine, &dir).unwrap();
        write(&logs, &dir, Options::default()).unwrap();
        assert!(fs::symlink_metadata(&dir).unwrap().is_dir());
        assert_eq!(fs::read(&page).unwrap(), text);
        assert_eq!(fs::read(mine.join("report.html")).unwrap(), b"mine");
        assert_eq!(fs::read_dir(&mine).unwrap().count(), 1);

        for (file, is_page) in [("notes.txt", true), ("conditions.csv", false)] {
            fs::write(mine.join(file), "mine").unwrap();
            let problem = write(&logs, &mine, Options::default()).unwrap_err().to_string();
            assert!(problem.contains(&format!("{file} is no part of a report")), "{problem}");
            assert_eq!(mine.join("report.html").exists(), is_page);
            fs::remove_file(mine.join(file)).unwrap();
            let _ = fs::remove_file(mine.join("report.html"));
        }
        // Neither in the folders of a report.
        fs::write(dir.join("figures/mine.svg"), "mine").unwrap();
        let problem = write(&logs, &dir, Options::default()).unwrap_err().to_string();
        assert!(problem.contains("report/figures/mine.svg is no part of a report"), "{problem}");
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 2, "no draft is left");
    }

    #[test]
    fn a_report_in_place_keeps_files_of_the_user() {
        let base = tempfile::tempdir().unwrap();
        let log = RunLog { dir: base.path().to_owned(), ..log(vec![record("t01-01", true)]) };
        let (page, others) = write_in_place(&log, Options::default()).unwrap();
        assert!(page.is_file() && others.is_empty());
        let dir = base.path().join("report");
        let mine = ["figures/main-figure.png", "my.html", "notes/a/b.txt", "tables/mine.csv"];
        fs::create_dir_all(dir.join("notes/a")).unwrap();
        for name in mine {
            fs::write(dir.join(name), name).unwrap();
        }
        // Not of this run.
        let earlier = dir.join("tables/stream-cost.csv");
        fs::write(&earlier, "").unwrap();
        fs::write(&page, "").unwrap();
        let (page, others) = write_in_place(&log, Options::default()).unwrap();
        assert_ne!(fs::read(page).unwrap(), b"");
        assert!(!earlier.exists());
        for name in mine {
            assert_eq!(fs::read_to_string(dir.join(name)).unwrap(), name);
        }
        let said = ["figures/main-figure.png", "my.html", "notes", "tables/mine.csv"];
        assert_eq!(others, said.map(|name| dir.join(name)));
        // Where there is no report yet.
        fs::remove_file(dir.join("report.html")).unwrap();
        assert!(write_in_place(&log, Options::default()).unwrap().0.is_file());
    }
}
