//! Taking part in a run: drain every queue, embed, answer whom one can, ring each neighbour once.
//!
//! The loop never waits for an embedding. Workers ring this process's own doorbell when they have one, so a
//! finished embedding wakes the loop like a message does.

use std::fmt::Display;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use bytemuck::Zeroable;
use domain::{Pose, Representation};
use shm_types::message::{
    FrameId, Handshake, Heartbeat, MemoryEpisodeConfig, Observation, Recall, RecallTrace, Role,
    ShutdownReport, Stop, View, ViewRequest,
};
use shm_types::process::{die_with_parent, monotonic_ns};
use shm_types::{
    Attach, Bus, BusError, DocumentPublisher, ErrorReporter, Frame, FrameError, FrameStore,
    Heartbeats, Notifier, Receiver, Sender, Spans,
};
use warehouse::case_file::CASES_FILE;
use warehouse::{CaseSet, Warehouse};

use crate::embedding_cache::{EmbeddingCache, Found};
use crate::encoder::{Embedded, Encoder, EncoderFacts, Image, ModelFile, Open, Picture, Prepared};
use crate::engine::Engine;
use crate::episode::{Unusable, unusable};
use crate::library::Library;
use crate::manifest::{Manifest, Precision};
use crate::paths::Cache;

/// How long the loop sleeps when nobody rings. Only a look around; nothing waits for it.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// How long to stay after saying why one cannot go on. Before an orchestrator has received this process's
/// hello, what was sent is lost with its sender unless the orchestrator looks in time.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// What a memory process is started with.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The run's folder, which holds `attach.json`.
    pub attach: PathBuf,
    /// Folder of layout, catalogue, cases and model manifest; `None`: those that are built in.
    pub assets: Option<PathBuf>,
    /// Folder of the documents that memories supply; `None`: no memory of the run supplies any.
    pub documents: Option<PathBuf>,
    /// Which encoder, and how it runs; `None`: no memory of the run compares views.
    pub encoder: Option<EncoderSettings>,
}

/// Which encoder runs, and how.
#[derive(Debug, Clone)]
pub struct EncoderSettings {
    /// Name in the manifest; `None`: the manifest's default.
    pub name: Option<String>,
    /// The model's file; `None`: where setup put it.
    pub file: Option<PathBuf>,
    /// Worker threads.
    pub threads: NonZeroUsize,
    /// What it computes with; `None`: the model's own precision, where the machine can.
    pub precision: Option<Precision>,
    /// Where the things that setup fetched lie, and where embeddings are kept.
    pub cache: Cache,
}

impl EncoderSettings {
    /// The encoder, ready to start.
    ///
    /// # Errors
    /// When there is no such encoder, or something it needs is missing or broken.
    pub fn prepare(&self, manifest: &Manifest) -> anyhow::Result<Prepared> {
        let model = manifest.model(self.name.as_ref().unwrap_or(&manifest.default))?;
        let file = ModelFile::read(model, self.file.as_deref(), &self.cache)?;
        Ok(Prepared::new(file, &self.cache.runtime(), self.threads, self.precision)?)
    }
}

/// Remembers for the run whose folder is `settings.attach`, until the orchestrator says stop.
///
/// Messages that cannot be used are complained about and dropped.
///
/// # Errors
/// When the run cannot be joined, its transport fails, the assets or the encoder cannot be used, or a document
/// that a memory supplies cannot be had. Once the run is joined, the orchestrator is told why.
pub fn serve(settings: &Settings) -> anyhow::Result<()> {
    let attach = Attach::read(&settings.attach).context("cannot take part in the run")?;
    die_with_parent(attach.orchestrator_pid).context("this process belongs to an orchestrator")?;
    let bus = Bus::join(attach, Role::Memory)?;
    let mut reporter = ErrorReporter::new(&bus)?;
    // Receivers first: what is sent while the encoder starts waits in their queues.
    let ports = Ports::new(&bus)?;
    let served = Server::start(settings, &bus, ports, &mut reporter).and_then(Server::run);
    if let Err(error) = &served {
        reporter.report(format_args!("the memory process cannot go on: {error:#}"));
        bus.notifier(Role::Orchestrator)?.notify()?;
        std::thread::sleep(LAST_WORDS);
    }
    served
}

impl Picture for Arc<Frame> {
    fn image(&self) -> Image<'_> {
        let size = self.size();
        Image { width: size.width, height: size.height, rgba: self.pixels() }
    }
}

/// The process's ends of the bus.
struct Ports {
    configs: Receiver<MemoryEpisodeConfig>,
    observations: Receiver<Observation>,
    views: Receiver<View>,
    stops: Receiver<Stop>,
    frames: FrameStore,
    recalls: Sender<Recall>,
    traces: Sender<RecallTrace>,
    requests: Sender<ViewRequest>,
    heartbeats: Heartbeats,
    sim: Notifier,
    policy: Notifier,
    orchestrator: Notifier,
}

impl Ports {
    fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            configs: bus.receiver()?,
            observations: bus.receiver()?,
            views: bus.receiver()?,
            stops: bus.receiver()?,
            frames: FrameStore::new(bus)?,
            recalls: bus.sender()?,
            traces: bus.sender()?,
            requests: bus.sender()?,
            heartbeats: Heartbeats::new(bus)?,
            sim: bus.notifier(Role::Sim)?,
            policy: bus.notifier(Role::Policy)?,
            orchestrator: bus.notifier(Role::Orchestrator)?,
        })
    }
}

struct Server<'a> {
    bus: &'a Bus,
    ports: Ports,
    reporter: &'a mut ErrorReporter,
    engine: Engine<Arc<Frame>>,
    library: Library,
    encoder: Option<Encoder>,
    /// Images embedded so far.
    embedded: u64,
    spans: Spans,
}

impl<'a> Server<'a> {
    fn start(
        settings: &Settings,
        bus: &'a Bus,
        ports: Ports,
        reporter: &'a mut ErrorReporter,
    ) -> anyhow::Result<Self> {
        let library = Library::new(settings.documents.clone(), DocumentPublisher::new(bus)?);
        let assets = settings.assets.as_deref();
        let (warehouse, cases) = match assets {
            None => (Warehouse::shipped(), CaseSet::shipped()),
            Some(folder) => {
                let warehouse = Warehouse::load(folder)?;
                let cases = CaseSet::load(&folder.join(CASES_FILE), &warehouse)?;
                (warehouse, cases)
            }
        };
        let (encoder, embeddings) = match &settings.encoder {
            None => (None, EmbeddingCache::in_memory()),
            Some(chosen) => {
                let manifest = assets.map_or_else(Manifest::shipped, Manifest::load)?;
                let own_notifier = Arc::new(bus.notifier(Role::Memory)?);
                let encoder = chosen.prepare(&manifest)?;
                let embeddings = open_cache(&chosen.cache, encoder.facts(), reporter);
                // Where embeddings are known, they may be all there will be.
                let open = if embeddings.is_empty() { Open::AtOnce } else { Open::WhenNeeded };
                let encoder = encoder.start(open, move || {
                    if let Err(error) = own_notifier.notify() {
                        tracing::debug!(%error, "an encoder worker cannot wake the loop");
                    }
                });
                (Some(encoder), embeddings)
            }
        };
        let attach = bus.attach();
        let room = room_for_views(attach);
        let engine = Engine::new(warehouse, cases, attach.lanes, room, embeddings);
        let spans = Spans::open(attach, Role::Memory).context("cannot keep spans of the work")?;
        let facts = encoder.as_ref().map_or_else(Vec::new, |encoder| facts(encoder.facts()));
        bus.sender()?.send(&Handshake::new(Role::Memory, facts)?)?;
        ports.orchestrator.notify()?;
        Ok(Self { bus, ports, reporter, engine, library, encoder, embedded: 0, spans })
    }

    fn run(mut self) -> anyhow::Result<()> {
        while self.ports.stops.next()?.is_none() {
            if !self.turn()? {
                self.bus.listener().wait(LONGEST_SLEEP)?;
            }
        }
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Memory as u32,
            frames_received: self.ports.frames.taken(),
            // Workers read pixels where the renderer wrote them; what leaves this process are ids.
            pixel_bytes_copied: 0,
            error_reports: self.reporter.count().into(),
            ..Zeroable::zeroed()
        })?;
        Ok(self.ports.orchestrator.notify()?)
    }

    /// Does what there is to do now; says whether there may be more.
    fn turn(&mut self) -> anyhow::Result<bool> {
        let error_reports = self.reporter.count();
        let more = self.take_messages()?;
        self.take_embeddings()?;
        self.answer()?;
        let requests = self.engine.take_view_requests();
        for request in &requests {
            self.ports.requests.send(request)?;
        }
        if !requests.is_empty() {
            self.ports.sim.notify()?;
        }
        self.feed_the_encoder()?;
        let told = self.beat();
        if told || self.reporter.count() != error_reports {
            self.ports.orchestrator.notify()?;
        }
        self.let_go_of_frames()?;
        Ok(more)
    }

    /// Reads all queues, of observations as many as belong into a turn; returns whether there may be more. A
    /// message that refers to another one was sent after it: queues are therefore emptied effect first, and what
    /// was in them is looked at cause first.
    fn take_messages(&mut self) -> anyhow::Result<bool> {
        let most = self.bus.attach().batch_len();
        let observations = self.ports.observations.drain_some(most)?;
        let more = observations.len() == most;
        let received_ns = monotonic_ns();
        let views = self.ports.views.drain()?;
        for config in self.ports.configs.drain()? {
            let outcome = self.can_serve(&config).and_then(|()| self.engine.config(&config));
            self.complain(outcome);
        }
        for View { frame, pose, .. } in views {
            match Pose::try_from(pose) {
                Err(error) => self.reporter.report(format_args!("view as frame {frame}: {error}")),
                Ok(pose) => {
                    if let Some(picture) =
                        self.find_frame(frame, &format_args!("view of {pose}"))?
                    {
                        let content = picture.content_hash();
                        let outcome = self.engine.view(pose, frame, content, picture);
                        self.complain(outcome);
                    }
                }
            }
        }
        for seen in observations {
            let Observation { episode, lane, step, .. } = seen;
            match self.engine.observe(&seen, received_ns) {
                Err(unusable) => self.reporter.report(unusable),
                Ok(None) => {}
                Ok(Some(frame)) => {
                    let what = format_args!("observation of episode {episode}, step {step}");
                    if let Some(picture) = self.find_frame(frame, &what)? {
                        self.engine.show(lane, picture.content_hash(), picture);
                    }
                }
            }
        }
        Ok(more)
    }

    /// Whether this process was started with what a brief's memory needs.
    fn can_serve(&self, config: &MemoryEpisodeConfig) -> Result<(), Unusable> {
        match Representation::try_from(config.representation) {
            Ok(asked) if asked.matches_views() && self.encoder.is_none() => Err(unusable!(
                "brief of episode {}: {asked} memory compares views, and this process was started with \
                 --no-encoder",
                config.episode
            )),
            // What is none is the engine's to refuse.
            Ok(_) | Err(_) => Ok(()),
        }
    }

    /// The frame that a message names. What cannot be found or used is complained about.
    fn find_frame(
        &mut self,
        id: FrameId,
        message: &dyn Display,
    ) -> Result<Option<Arc<Frame>>, BusError> {
        loop {
            match self.ports.frames.get(id) {
                Ok(Some(frame)) => return Ok(Some(frame.clone())),
                Ok(None) => {
                    self.reporter.report(format_args!(
                        "{message}: frame {id} is not in the store, so it was evicted too early or never \
                         published"
                    ));
                    return Ok(None);
                }
                Err(FrameError::Bus(error)) => return Err(error),
                // The store has dropped what it could not use: go on after it.
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn take_embeddings(&mut self) -> anyhow::Result<()> {
        let mut poll = || self.encoder.as_mut().and_then(Encoder::poll);
        while let Some(Embedded { content, embedding, worker, span_ns }) = poll() {
            let track = format!("encoder {worker}");
            self.spans.add(span_ns.start, span_ns.end, &track, "embed", 1);
            if let Err(error) = self.engine.embedded(content, embedding?) {
                self.reporter.report(format_args!("{error}; this run goes on without it"));
            }
            self.embedded += 1;
        }
        Ok(())
    }

    /// Tells the orchestrator that images wait, among other things.
    fn beat(&mut self) -> bool {
        let (engine, done) = (&self.engine, self.embedded);
        let (held, room) = engine.views_held();
        self.ports.heartbeats.beat(|| Heartbeat {
            done,
            waiting: engine.waiting() as u64,
            held: held as u64,
            room: room as u64,
            ..Zeroable::zeroed()
        })
    }

    fn answer(&mut self) -> anyhow::Result<()> {
        let began = self.spans.begin();
        let mut answers = self.engine.answers(monotonic_ns, &mut self.library)?;
        for (recall, trace) in &mut answers {
            recall.sent_ns = monotonic_ns();
            trace.sent_ns = recall.sent_ns;
            // The recall sets the policy going; its decision should not overtake the account of it.
            self.ports.traces.send(trace)?;
            self.ports.recalls.send(recall)?;
        }
        if !answers.is_empty() {
            // The orchestrator reads the accounts when the policy wakes it.
            self.ports.policy.notify()?;
        }
        self.spans.end(began, "memory", "recall", answers.len());
        Ok(())
    }

    fn feed_the_encoder(&mut self) -> anyhow::Result<()> {
        let Some(encoder) = &mut self.encoder else { return Ok(()) };
        while encoder.has_room()
            && let Some((content, frame)) = self.engine.next_picture()
        {
            encoder.submit(content, frame)?;
        }
        Ok(())
    }

    fn let_go_of_frames(&mut self) -> Result<(), BusError> {
        loop {
            match self.ports.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error),
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn complain(&mut self, outcome: Result<(), Unusable>) {
        if let Err(unusable) = outcome {
            self.reporter.report(unusable);
        }
    }
}

/// Demonstration views that may be held: the frame store's room less what running episodes pin, the
/// current view, the one before it and the window of each lane.
fn room_for_views(attach: &Attach) -> usize {
    let pinned = u64::from(attach.lanes) * (u64::from(attach.window) + 2);
    u64::from(attach.frame_capacity).saturating_sub(pinned) as usize
}

fn open_cache(cache: &Cache, facts: &EncoderFacts, reporter: &mut ErrorReporter) -> EmbeddingCache {
    let folder = cache.embeddings();
    match EmbeddingCache::open(&folder, &facts.fingerprint, facts.dimension) {
        Ok((cache, found)) => {
            let Found { embeddings, damaged, torn_bytes, restarted } = found;
            tracing::debug!(embeddings, "embedding cache read");
            if damaged > 0 || torn_bytes > 0 || restarted {
                let folder = folder.display();
                tracing::warn!(damaged, torn_bytes, restarted, %folder, "embedding cache was damaged");
            }
            cache
        }
        Err(error) => {
            reporter.report(format_args!("{error}; this run goes on without it"));
            EmbeddingCache::in_memory()
        }
    }
}

/// What the orchestrator is told of the encoder. A run without one says nothing of it.
fn facts(facts: &EncoderFacts) -> Vec<(&'static str, String)> {
    vec![
        ("encoder", facts.model.clone()),
        ("encoder_sha256", facts.sha256.clone()),
        ("encoder_trained", facts.trained.to_string()),
        ("encoder_threads", facts.threads.to_string()),
        ("encoder_provider", facts.provider.to_owned()),
        ("encoder_precision", facts.precision.word().to_owned()),
        ("onnxruntime", facts.runtime.clone()),
    ]
}
