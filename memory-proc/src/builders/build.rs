//! Builds documents, one after the other, from the demonstrations of a book.

use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use documents::{DocumentFile, DocumentFolder, DocumentName, Provenance, Recipe, Sources};

use super::{BuiltText, DocumentBuilder};

/// How often progress is reported.
const REPORT_INTERVAL: Duration = Duration::from_millis(250);

/// What to build, and where.
#[derive(Debug, Clone)]
pub struct BuildSettings {
    /// What they are built from.
    pub sources: Sources,
    /// The folder that the documents are written to.
    pub documents: PathBuf,
    /// The documents, in the order of building.
    pub wanted: Vec<DocumentName>,
    /// How they are built.
    pub recipe: Recipe,
}

/// Builds documents with `builder`. Progress goes to `out`, a line `parts DONE TOTAL` each time: the parts of one document
/// after the other.
///
/// # Errors
/// When a document cannot be built or written. Documents that have been written are kept.
pub fn build(
    settings: &BuildSettings,
    builder: &mut dyn DocumentBuilder,
    out: impl Write,
) -> Result<()> {
    let mut progress = Progress { out, last_report: None };
    let mut each = settings.wanted.iter();
    each.try_for_each(|&name| write(name, settings, builder, &mut progress))
}

fn write(
    name: DocumentName,
    BuildSettings { sources, documents, recipe, .. }: &BuildSettings,
    builder: &mut dyn DocumentBuilder,
    progress: &mut Progress<impl Write>,
) -> Result<()> {
    let DocumentName { kind, demonstrations } = name;
    let listed = sources.demonstrations(demonstrations);
    let sources_sha256 = sources.sha256(demonstrations);
    let address = recipe.address(name, &sources_sha256);
    let path = DocumentFolder::new(documents).file(name, &address);
    let mut failure = None;
    let steps = path.with_extension("steps");
    let built = builder.build(kind, &sources.book().world, &listed, &steps, &mut |done, total| {
        let reported = progress.report(done, total);
        failure = failure.take().or(reported.err());
    });
    let BuiltText { text, account } =
        built.with_context(|| format!("cannot build {}", path.display()))?;
    if let Some(error) = failure {
        return Err(error);
    }
    let provenance = Provenance {
        kind,
        demonstrations,
        builder: recipe.builder().to_owned(),
        builder_version: recipe.version(),
        sources_sha256,
        text_sha256: String::new(),
        trajectories: listed.len() as u64,
        views: sources.views(demonstrations).len() as u64,
        account,
    };
    Ok(DocumentFile::new(provenance, text).save(&path)?)
}

struct Progress<W> {
    out: W,
    last_report: Option<Instant>,
}

impl<W: Write> Progress<W> {
    /// Reports progress, at most every [`REPORT_INTERVAL`].
    fn report(&mut self, done: usize, total: usize) -> Result<()> {
        if self.last_report.is_some_and(|when| when.elapsed() < REPORT_INTERVAL) {
            return Ok(());
        }
        self.last_report = Some(Instant::now());
        writeln!(self.out, "parts {done} {total}").context("cannot report progress")
    }
}
