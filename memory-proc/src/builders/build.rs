//! Builds documents: reads the views of the demonstrations, which the world renders (`sim-proc views`), then writes one
//! document after the other.
//!
//! A view is rendered and read once, however many demonstrations and documents contain it. In other worlds than the warehouse no view
//! is: documents are written from the words of the book.

use std::collections::{BTreeMap, HashMap};
use std::ffi::OsString;
use std::io::{BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use case_book::{BookFile, DemonstrationBook, ViewPlace, WAREHOUSE};
use documents::{DocumentFile, DocumentFolder, DocumentName, Provenance, Recipe, Sources};
use domain::{Appearance, Pose};
use search::ContentHash;

use super::transcript::sha256;
use super::{BuiltText, DocumentBuilder, FrameReading, transcripts};

/// How often progress is reported.
const REPORT_INTERVAL: Duration = Duration::from_millis(250);

/// The program that renders views.
const RENDERER: &str = "sim-proc";

/// What to build, and where.
#[derive(Debug, Clone)]
pub struct BuildSettings {
    /// The file of demonstrations.
    pub demonstrations: PathBuf,
    /// The arguments of `sim-proc views` that say what the world is.
    pub world: Vec<OsString>,
    /// Width and height of the frames that they are built from, in pixels.
    pub frame_size: u32,
    /// How the world looks in the frames.
    pub appearance: Appearance,
    /// The folder that the documents are written to.
    pub documents: PathBuf,
    /// The documents, in the order of building.
    pub wanted: Vec<DocumentName>,
    /// How they are built.
    pub recipe: Recipe,
}

/// Builds documents with `builder`. Progress goes to `out`, a line `views DONE TOTAL` or `parts DONE TOTAL` each time: first the
/// views, until all are read, then the parts of one document after the other.
///
/// # Errors
/// When the demonstrations cannot be read, the renderer fails, or a document cannot be built or written. Documents that have
/// been written are kept.
pub fn build(
    settings: &BuildSettings,
    builder: &mut dyn DocumentBuilder,
    out: impl Write,
) -> Result<()> {
    let book = BookFile::<DemonstrationBook>::read(&settings.demonstrations)?.book;
    let sources = Sources::new(book.clone(), settings.frame_size, settings.appearance);
    let mut views = BTreeMap::new();
    for name in &settings.wanted {
        views.extend(sources.views(name.demonstrations));
    }
    let mut progress = Progress { out, last_report: None };
    // Documents of other worlds are written from the book alone.
    let is_warehouse = book.world.name == WAREHOUSE;
    let seen = is_warehouse.then(|| read_views(settings, &book, &views, &mut progress));
    let seen = seen.transpose()?;
    settings.wanted.iter().try_for_each(|&name| {
        write(name, settings, &sources, seen.as_ref(), builder, &mut progress)
    })
}

/// Has the world render `views` and reads them.
fn read_views(
    settings: &BuildSettings,
    book: &DemonstrationBook,
    views: &BTreeMap<u32, ViewPlace>,
    progress: &mut Progress<impl Write>,
) -> Result<HashMap<u32, Arc<FrameReading>>> {
    let size = settings.frame_size;
    let program = std::env::current_exe()?.with_file_name(RENDERER);
    let mut child = Command::new(&program)
        .args(["views", "--size", &format!("{size}x{size}"), "--demonstrations"])
        .arg(&settings.demonstrations)
        .args(&settings.world)
        .args(
            settings.appearance.flags().into_iter().flat_map(|(flag, value)| [flag.into(), value]),
        )
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))?;
    let pipes = child.stdin.take().zip(child.stdout.take());
    let (mut requests, pixels) = pipes.context("a child process without pipes")?;
    let mut pixels = BufReader::new(pixels);
    let seen = thread::scope(|scope| {
        // From another thread, so that rendering and reading overlap. A renderer that ends early is noticed where pixels
        // are missing.
        let ask = move || {
            let mut each = views.values();
            let _ = each.try_for_each(|of| writeln!(requests, "{} {}", of.demonstration, of.step));
        };
        thread::Builder::new().spawn_scoped(scope, ask).context("cannot start a thread")?;
        let mut seen = HashMap::with_capacity(views.len());
        let mut rgba = vec![0; size as usize * size as usize * 4];
        for (&view, &ViewPlace { demonstration, step }) in views {
            progress.report("views", seen.len(), views.len())?;
            pixels.read_exact(&mut rgba).map_err(|_| anyhow!("{RENDERER} ended early"))?;
            let state = book.demonstrations[demonstration as usize].states[step as usize];
            let pose = Pose::try_from(state).context("a state of the warehouse is no pose")?;
            seen.insert(view, Arc::new(read_plates(size, &rgba, pose)));
        }
        Ok::<_, anyhow::Error>(seen)
    });
    if seen.is_err() {
        let _ = child.kill();
    }
    child.wait().with_context(|| format!("cannot wait for {RENDERER}"))?;
    let seen = seen?;
    progress.last_report = None;
    progress.report("views", seen.len(), views.len())?;
    Ok(seen)
}

fn write(
    name: DocumentName,
    BuildSettings { documents, recipe, .. }: &BuildSettings,
    sources: &Sources,
    seen: Option<&HashMap<u32, Arc<FrameReading>>>,
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
    let (built, inputs_sha256) = match seen {
        Some(seen) => {
            let read = transcripts(sources, demonstrations, |view| seen.get(&view).cloned());
            let read = read.context("a view of a demonstration was not read")?;
            let built = builder.build(kind, &read, &steps, &mut |done, total| {
                let reported = progress.report("parts", done, total);
                failure = failure.take().or(reported.err());
            });
            (built, sha256(&read))
        }
        // The sources are all that it reads.
        None => (
            builder.build_of_any_world(kind, &sources.book().world, &listed),
            sources_sha256.clone(),
        ),
    };
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
        inputs_sha256,
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
    fn report(&mut self, stage: &str, done: usize, total: usize) -> Result<()> {
        if self.last_report.is_some_and(|when| when.elapsed() < REPORT_INTERVAL) {
            return Ok(());
        }
        self.last_report = Some(Instant::now());
        writeln!(self.out, "{stage} {done} {total}").context("cannot report progress")
    }
}

/// Reads the plates in a frame of red, green, blue and alpha that was rendered from `pose`.
fn read_plates(size: u32, rgba: &[u8], pose: Pose) -> FrameReading {
    let sightings = plates::read(size, size, rgba);
    let landmarks = sightings.into_iter().filter_map(|sighting| sighting.seen_from(pose));
    FrameReading { frame: content_hash(rgba), landmarks: landmarks.collect() }
}

/// As frames of a run have it: the first 16 bytes of the BLAKE3 hash of the pixels.
fn content_hash(rgba: &[u8]) -> ContentHash {
    let mut hash = ContentHash::default();
    hash.copy_from_slice(&blake3::hash(rgba).as_bytes()[..size_of::<ContentHash>()]);
    hash
}
