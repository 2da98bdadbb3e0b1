//! The process that builds documents: has the simulator render every view of the demonstrations, reads and releases
//! them, then builds and stores the documents.
//!
//! A view is rendered and read once, however many demonstrations and documents contain it. The run has no episodes and
//! no policy: its processes are the simulator and this one.

use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bytemuck::Zeroable;
use domain::{Appearance, Demonstrations, Pose};
use shm_types::message::{
    Handshake, Heartbeat, NO_FRAME, Role, ShutdownReport, Stop, View, ViewRequest, ViewRequestKind,
};
use shm_types::{Bus, ErrorReporter, Frame, FrameError, FrameStore, Notifier, Receiver, Sender};
use warehouse::{Elsewhere, Viewpoint};

use documents::{DocumentFile, DocumentFolder, DocumentName, Provenance, Recipe, Sources};

use super::transcript::sha256;
use super::{BuiltText, DocumentBuilder, FrameReading, transcripts};
use crate::serve::{LAST_WORDS, LONGEST_SLEEP, join, room_for_views};

/// How often progress is reported.
const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(250);

/// How long the simulator may take to start.
const SIM_TIMEOUT: Duration = Duration::from_secs(60);

/// What to build, and where.
#[derive(Debug, Clone)]
pub struct BuildSettings {
    /// The run's folder, which holds `attach.json`.
    pub attach: PathBuf,
    /// Folder of layout, catalogue and cases; `None`: those that are built in.
    pub assets: Option<PathBuf>,
    /// The file of the other warehouse in which tasks are demonstrated; `None`: there is none.
    pub elsewhere: Option<PathBuf>,
    /// How the world looks in the frames that they are built from.
    pub appearance: Appearance,
    /// The folder that the documents are written to.
    pub documents: PathBuf,
    /// The documents, in the order of building.
    pub wanted: Vec<DocumentName>,
    /// How they are built.
    pub recipe: Recipe,
}

/// Builds documents with `builder`, in the run whose folder is `settings.attach`, and stays until the orchestrator
/// stops it.
///
/// Progress is reported by [`Heartbeat`]: first the views, until none is left, then the parts of one document after the
/// other. A [`ShutdownReport`] reports that all documents are written.
///
/// # Errors
/// When the run cannot be joined, its transport or the simulator fails, the assets cannot be used, or a document cannot
/// be built or written. Documents that have been written are kept.
pub fn build(settings: &BuildSettings, builder: &mut dyn DocumentBuilder) -> Result<()> {
    let bus = join(&settings.attach)?;
    let mut reporter = ErrorReporter::new(&bus)?;
    let done = BuildProcess::new(&bus).and_then(|mut process| {
        let sources = Sources::load(settings.assets.as_deref())?.seen_with(settings.appearance);
        let read = |file: &PathBuf| Elsewhere::read(file, &sources.warehouse, &sources.cases);
        let elsewhere = settings.elsewhere.as_ref().map(read).transpose()?;
        let text = elsewhere.as_ref().map(Elsewhere::to_text);
        let sources = sources.with_elsewhere(text.as_deref())?;
        bus.sender()?.send(&Handshake::new(
            Role::Memory,
            [
                ("builder", settings.recipe.builder().to_owned()),
                ("builder_version", settings.recipe.version()),
            ],
        )?)?;
        process.orchestrator.notify()?;
        process.requests.wait_for_receivers(SIM_TIMEOUT).context("the simulator does not start")?;
        let selections: BTreeSet<Demonstrations> =
            settings.wanted.iter().map(|name| name.demonstrations).collect();
        let viewpoints: BTreeSet<Viewpoint> =
            selections.iter().flat_map(|&selection| sources.viewpoints(selection)).collect();
        let seen = process.read_views(&viewpoints.into_iter().collect::<Vec<_>>())?;
        for &name in &settings.wanted {
            process.write(name, settings, &sources, &seen, builder)?;
        }
        process.finish()
    });
    if let Err(error) = &done {
        reporter.report(format_args!("the documents cannot be built: {error:#}"));
        bus.notifier(Role::Orchestrator)?.notify()?;
        std::thread::sleep(LAST_WORDS);
    }
    done
}

/// The process's ends of the bus.
struct BuildProcess<'a> {
    bus: &'a Bus,
    views: Receiver<View>,
    stops: Receiver<Stop>,
    frames: FrameStore,
    requests: Sender<ViewRequest>,
    heartbeats: Sender<Heartbeat>,
    sim: Notifier,
    orchestrator: Notifier,
    last_report: Option<Instant>,
}

impl<'a> BuildProcess<'a> {
    fn new(bus: &'a Bus) -> Result<Self> {
        Ok(Self {
            bus,
            views: bus.receiver()?,
            stops: bus.receiver()?,
            frames: FrameStore::new(bus)?,
            requests: bus.sender()?,
            heartbeats: bus.sender()?,
            sim: bus.notifier(Role::Sim)?,
            orchestrator: bus.notifier(Role::Orchestrator)?,
            last_report: None,
        })
    }

    /// Reads the views from `viewpoints`, as many at a time as fit into the frame store.
    fn read_views(
        &mut self,
        viewpoints: &[Viewpoint],
    ) -> Result<HashMap<Viewpoint, Arc<FrameReading>>> {
        let room = room_for_views(self.bus.attach());
        if room == 0 {
            bail!("the frame store has no room for a view: raise --frame-budget");
        }
        let mut seen = HashMap::with_capacity(viewpoints.len());
        let mut waiting = viewpoints.iter();
        let mut asked = 0;
        loop {
            for &viewpoint in waiting.by_ref().take(room - asked) {
                self.request(ViewRequestKind::Pin, NO_FRAME, viewpoint)?;
                asked += 1;
            }
            self.sim.notify()?;
            self.report_progress(seen.len(), viewpoints.len(), false)?;
            if asked == 0 {
                break;
            }
            self.bus.listener().wait(LONGEST_SLEEP)?;
            for View { frame: id, pose, variant } in self.views.drain()? {
                let pose = Pose::try_from(pose)
                    .context("the simulator sent a view with an invalid pose")?;
                let Some(frame) = self.frames.get(id)?.cloned() else {
                    bail!("frame {id}, the view of {pose}, is not in the store");
                };
                let viewpoint = Viewpoint { variant, pose };
                seen.insert(viewpoint, Arc::new(read_plates(&frame, pose)));
                self.request(ViewRequestKind::Release, id, viewpoint)?;
                asked -= 1;
            }
            self.release_frames()?;
        }
        self.report_progress(seen.len(), viewpoints.len(), true)?;
        Ok(seen)
    }

    fn write(
        &mut self,
        name: DocumentName,
        BuildSettings { documents, recipe, .. }: &BuildSettings,
        sources: &Sources,
        seen: &HashMap<Viewpoint, Arc<FrameReading>>,
        builder: &mut dyn DocumentBuilder,
    ) -> Result<()> {
        let DocumentName { kind, demonstrations } = name;
        let transcripts = transcripts(sources, demonstrations, |from| seen.get(&from).cloned());
        let transcripts = transcripts.context("a view of a demonstration was not read")?;
        let frame = self.bus.attach().frame;
        let sources_sha256 = sources.sha256(demonstrations, [frame.width, frame.height]);
        let address = recipe.address(name, &sources_sha256);
        let path = DocumentFolder::new(documents).file(name, &address);
        let mut failure = None;
        let steps = path.with_extension("steps");
        let built = builder.build(kind, &transcripts, &steps, &mut |done, total| {
            let reported = self.report_progress(done, total, false);
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
            inputs_sha256: sha256(&transcripts),
            sources_sha256,
            text_sha256: String::new(),
            trajectories: transcripts.len() as u64,
            views: sources.viewpoints(demonstrations).len() as u64,
            account,
        };
        Ok(DocumentFile::new(provenance, text).save(&path)?)
    }

    fn request(&self, kind: ViewRequestKind, frame: u64, of: Viewpoint) -> Result<()> {
        let Viewpoint { variant, pose } = of;
        let kind = kind as u8;
        let request = ViewRequest { frame, pose: pose.into(), variant, kind, ..Zeroable::zeroed() };
        Ok(self.requests.send(&request)?)
    }

    /// Reports progress, at most every [`HEARTBEAT_INTERVAL`] unless `at_once`.
    fn report_progress(&mut self, done: usize, total: usize, at_once: bool) -> Result<()> {
        if !at_once && self.last_report.is_some_and(|when| when.elapsed() < HEARTBEAT_INTERVAL) {
            return Ok(());
        }
        self.last_report = Some(Instant::now());
        self.heartbeats.send(&Heartbeat {
            role: Role::Memory as u32,
            done: done as u64,
            waiting: total.saturating_sub(done) as u64,
            ..Zeroable::zeroed()
        })?;
        Ok(self.orchestrator.notify()?)
    }

    fn release_frames(&mut self) -> Result<()> {
        loop {
            match self.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                // The store has dropped the frame that it could not use.
                Err(bad) => tracing::warn!(%bad, "a frame could not be used"),
            }
        }
    }

    /// Reports that all documents are written, and waits for the stop message.
    fn finish(mut self) -> Result<()> {
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Memory as u32,
            frames_received: self.frames.received(),
            // Plates are read from shared memory.
            pixel_bytes_copied: 0,
            ..Zeroable::zeroed()
        })?;
        self.orchestrator.notify()?;
        while self.stops.next()?.is_none() {
            self.bus.listener().wait(LONGEST_SLEEP)?;
            self.release_frames()?;
        }
        Ok(())
    }
}

/// Reads the plates in a frame that was rendered from `pose`.
fn read_plates(frame: &Frame, pose: Pose) -> FrameReading {
    let size = frame.size();
    let sightings = plates::read(size.width, size.height, frame.pixels());
    let landmarks = sightings.into_iter().filter_map(|sighting| sighting.seen_from(pose));
    FrameReading { frame: frame.content_hash(), landmarks: landmarks.collect() }
}
