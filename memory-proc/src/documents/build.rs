//! Taking part in a run to write documents: every view of the wanted demonstrations is asked of the simulator,
//! read, and let go of; then the documents are built and kept.
//!
//! A view is rendered and read once, however many demonstrations and documents it is in. There are no
//! episodes in such a run and no policy: the crew is the simulator and this process.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bytemuck::Zeroable;
use domain::{DocumentKind, Pose};
use shm_types::message::{
    Handshake, Heartbeat, NO_FRAME, Role, ShutdownReport, Stop, View, ViewRequest, ViewRequestKind,
};
use shm_types::process::die_with_parent;
use shm_types::{
    Attach, Bus, ErrorReporter, Frame, FrameError, FrameStore, Notifier, Receiver, Sender,
};
use warehouse::Demonstrations;

use super::sources::Sources;
use super::transcript::{Seen, sha256};
use super::{Builder, Built, DocumentFile, Provenance};

/// How long the loop sleeps when nobody rings. Only a look around; nothing waits for it.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// How often the orchestrator is told how far this is.
const PULSE_INTERVAL: Duration = Duration::from_millis(250);

/// How long to stay after saying why one cannot go on, so that it is heard.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// One document that is wanted.
pub type Wanted = (DocumentKind, Demonstrations);

/// What to build, and where.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The run's folder, which holds `attach.json`.
    pub attach: PathBuf,
    /// Folder of layout, catalogue and cases; `None`: those that are built in.
    pub assets: Option<PathBuf>,
    /// The folder that the documents are written to.
    pub documents: PathBuf,
    /// Which ones, in this order.
    pub wanted: Vec<Wanted>,
}

/// Builds what `settings` want with `builder`, as part of the run whose folder is `settings.attach`, and
/// stays until the orchestrator says stop.
///
/// The orchestrator is told of progress by [`Heartbeat`]: first of views, until none waits, then of the parts of
/// one document after the other. The [`ShutdownReport`] says that all are written.
///
/// # Errors
/// When the run cannot be joined, its transport or the simulator fails, the assets cannot be used, or a
/// document cannot be built or written. Those written before stay.
pub fn build(settings: &Settings, builder: &mut dyn Builder) -> Result<()> {
    let attach = Attach::read(&settings.attach).context("cannot take part in the run")?;
    die_with_parent(attach.orchestrator_pid).context("this process belongs to an orchestrator")?;
    let bus = Bus::join(attach, Role::Memory)?;
    let mut reporter = ErrorReporter::new(&bus)?;
    let done = Scribe::new(&bus).and_then(|mut scribe| {
        let sources = Sources::load(settings.assets.as_deref())?;
        bus.sender()?.send(&Handshake::new(
            Role::Memory,
            [("builder", builder.name().to_owned()), ("builder_version", builder.version())],
        )?)?;
        scribe.orchestrator.notify()?;
        let selections: BTreeSet<Demonstrations> =
            settings.wanted.iter().map(|&(_, selection)| selection).collect();
        let poses: BTreeSet<Pose> =
            selections.iter().flat_map(|&selection| sources.poses(selection)).collect();
        let seen = scribe.look(&poses.into_iter().collect::<Vec<_>>())?;
        for &wanted in &settings.wanted {
            scribe.write(wanted, &sources, &seen, &settings.documents, builder)?;
        }
        scribe.shutdown_report()
    });
    if let Err(error) = &done {
        reporter.report(format_args!("the documents cannot be built: {error:#}"));
        bus.notifier(Role::Orchestrator)?.notify()?;
        std::thread::sleep(LAST_WORDS);
    }
    done
}

/// The process's ends of the bus.
struct Scribe<'a> {
    bus: &'a Bus,
    views: Receiver<View>,
    stops: Receiver<Stop>,
    frames: FrameStore,
    requests: Sender<ViewRequest>,
    heartbeats: Sender<Heartbeat>,
    sim: Notifier,
    orchestrator: Notifier,
    /// When the orchestrator was last told how far this is.
    told: Option<Instant>,
}

impl<'a> Scribe<'a> {
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
            told: None,
        })
    }

    /// What is seen from each of `poses`: asked for, read, and let go of, as many at once as there is room.
    fn look(&mut self, poses: &[Pose]) -> Result<HashMap<Pose, Arc<Seen>>> {
        let attach = self.bus.attach();
        let pinned = u64::from(attach.lanes) * (u64::from(attach.window) + 2);
        let room = u64::from(attach.frame_capacity).saturating_sub(pinned) as usize;
        if room == 0 {
            bail!("there is no room for a view: raise --frame-budget");
        }
        let mut seen = HashMap::with_capacity(poses.len());
        let mut waiting = poses.iter();
        let mut asked = 0;
        loop {
            for &pose in waiting.by_ref().take(room - asked) {
                self.request(ViewRequestKind::Pin, NO_FRAME, pose)?;
                asked += 1;
            }
            self.sim.notify()?;
            self.tell(seen.len(), poses.len(), false)?;
            if asked == 0 {
                break;
            }
            self.bus.listener().wait(LONGEST_SLEEP)?;
            for View { frame: id, pose, .. } in self.views.drain()? {
                let pose = Pose::try_from(pose).context("a view of no pose")?;
                let Some(frame) = self.frames.get(id)?.cloned() else {
                    bail!("frame {id}, the view of {pose}, is not in the store");
                };
                seen.insert(pose, Arc::new(read(&frame, pose)));
                self.request(ViewRequestKind::Release, id, pose)?;
                asked -= 1;
            }
            self.let_go_of_frames()?;
        }
        self.tell(seen.len(), poses.len(), true)?;
        Ok(seen)
    }

    fn write(
        &mut self,
        (kind, selection): Wanted,
        sources: &Sources,
        seen: &HashMap<Pose, Arc<Seen>>,
        folder: &Path,
        builder: &mut dyn Builder,
    ) -> Result<()> {
        let transcripts = sources.transcripts(selection, |pose| seen.get(&pose).cloned());
        let transcripts = transcripts.context("a view of a demonstration was not looked at")?;
        let name = DocumentFile::name(kind, selection);
        let steps = folder.join(&name).with_extension("steps");
        let mut failure = None;
        let built = builder.build(kind, &transcripts, &steps, &mut |done, total| {
            let told = self.tell(done, total, false);
            failure = failure.take().or(told.err());
        });
        let Built { text, account } = built.with_context(|| format!("cannot build {name}"))?;
        if let Some(error) = failure {
            return Err(error);
        }
        let provenance = Provenance {
            kind,
            demonstrations: selection,
            builder: builder.name().to_owned(),
            builder_version: builder.version(),
            inputs_sha256: sha256(&transcripts),
            sources_sha256: sources.sha256(selection, self.bus.attach().frame),
            text_sha256: String::new(),
            trajectories: transcripts.len() as u64,
            views: sources.poses(selection).len() as u64,
            account,
        };
        DocumentFile::new(provenance, text).save(folder)?;
        Ok(())
    }

    fn request(&self, kind: ViewRequestKind, frame: u64, pose: Pose) -> Result<()> {
        let request = ViewRequest { frame, pose: pose.into(), kind: kind as u8, reserved: [0; 3] };
        Ok(self.requests.send(&request)?)
    }

    /// Tells the orchestrator how far this is, if it has not been told for a while or is to know at once.
    fn tell(&mut self, done: usize, total: usize, at_once: bool) -> Result<()> {
        if !at_once && self.told.is_some_and(|when| when.elapsed() < PULSE_INTERVAL) {
            return Ok(());
        }
        self.told = Some(Instant::now());
        self.heartbeats.send(&Heartbeat {
            role: Role::Memory as u32,
            done: done as u64,
            waiting: total.saturating_sub(done) as u64,
            ..Zeroable::zeroed()
        })?;
        Ok(self.orchestrator.notify()?)
    }

    fn let_go_of_frames(&mut self) -> Result<()> {
        loop {
            match self.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                // The store has dropped what it could not use: go on after it.
                Err(bad) => tracing::warn!(%bad, "a frame could not be used"),
            }
        }
    }

    /// Everything is written: says so, and waits to be told to stop.
    fn shutdown_report(mut self) -> Result<()> {
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Memory as u32,
            frames_received: self.frames.taken(),
            // Plates are read where the renderer wrote them.
            pixel_bytes_copied: 0,
            ..Zeroable::zeroed()
        })?;
        self.orchestrator.notify()?;
        while self.stops.next()?.is_none() {
            self.bus.listener().wait(LONGEST_SLEEP)?;
            self.let_go_of_frames()?;
        }
        Ok(())
    }
}

/// The plates in a frame that was taken from `pose`.
fn read(frame: &Frame, pose: Pose) -> Seen {
    let size = frame.size();
    let sightings = plates::read(size.width, size.height, frame.pixels());
    let landmarks = sightings.into_iter().filter_map(|sighting| sighting.seen_from(pose));
    Seen { frame: frame.content_hash(), landmarks: landmarks.collect() }
}
