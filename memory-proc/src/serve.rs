//! The memory process in a run: drains its queues, submits images to the encoder, answers what it can, notifies each
//! neighbour once.
//!
//! The loop never waits for an embedding. A worker notifies this process's own listener when it has one, so that a
//! finished embedding wakes the loop as a message does.

mod encoder;
mod ports;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use bytemuck::Zeroable;
use case_book::{BookFile, DemonstrationBook};
use domain::Representation;
use shm_types::clock::{Instant, sleep};
use shm_types::description::memory_folder;
use shm_types::message::{
    FrameId, Handshake, Heartbeat, MAX_EMBEDDING, MemoryEpisodeConfig, Observation, Role,
    ShutdownReport, View,
};
use shm_types::process::{die_with_parent, monotonic_ns};
use shm_types::{
    Attach, AttachError, Bus, BusError, DocumentPublisher, ErrorReporter, Frame, FrameError,
    MemoryDescription, Spans,
};

use crate::demonstrations::{DemonstrationLibrary, ViewId};
use crate::document_loader::DocumentLoader;
use crate::embedding_cache::EmbeddingCache;
use crate::encoder::{Embedded, Encoder};
use crate::engine::{Engine, EpisodeFailure};
use crate::external::{ExternalLimits, ExternalMemories};
use crate::snapshots::SnapshotFolder;
use encoder::{facts, open_encoder};
use ports::Ports;

pub use encoder::EncoderSettings;

/// The longest wait for an event. Nothing depends on it; it bounds the time until a lost event is noticed.
pub(crate) const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// How long to wait for the description of an external memory: longer than the orchestrator waits for the memory.
const DESCRIPTION_TIMEOUT: Duration = Duration::from_secs(3600);

/// How often to look for it.
const DESCRIPTION_POLL: Duration = Duration::from_millis(20);

/// How long to stay after reporting an error, so that the report is received.
pub(crate) const LAST_WORDS: Duration = Duration::from_millis(500);

/// How the memory process is started.
#[derive(Debug, Clone)]
pub struct ServeSettings {
    /// The run's folder, which holds `attach.json`.
    pub attach: PathBuf,
    /// The file of the run's demonstrations.
    pub demonstrations: PathBuf,
    /// Folder of the model manifest; `None`: the built-in one.
    pub assets: Option<PathBuf>,
    /// The run's documents; `None`: no memory of the run supplies any.
    pub documents: Option<PathBuf>,
    /// The encoder; `None`: no memory of the run matches views.
    pub encoder: Option<EncoderSettings>,
    /// The file of embeddings that came with a plan; `None`: there is none.
    pub shipped_embeddings: Option<PathBuf>,
    /// The folder of the snapshots of memories that learn; `None`: no memory of the run learns.
    pub snapshots: Option<PathBuf>,
    /// How long external memories may take.
    pub limits: ExternalLimits,
}

/// Serves the run whose folder is `settings.attach` until the orchestrator stops it.
///
/// Messages that cannot be used are reported and dropped.
///
/// # Errors
/// When the run cannot be joined, its transport fails, the demonstrations or the encoder cannot be used, or a document is
/// missing. Errors after joining are reported to the orchestrator as well.
pub fn serve(settings: &ServeSettings) -> anyhow::Result<()> {
    let bus = join(&settings.attach)?;
    serve_with(settings, &bus, |wake, reporter| open_encoder(settings, wake, reporter))
}

/// Joins the run in the folder `run`.
pub(crate) fn join(run: &Path) -> anyhow::Result<Bus> {
    let attach = Attach::read(run).context("cannot join the run")?;
    die_with_parent(attach.orchestrator_pid)
        .context("cannot tie this process to its orchestrator")?;
    Ok(Bus::join(attach, Role::Memory)?)
}

/// As [`serve`], in the run that `bus` has joined, with the encoder and the known embeddings that `open` returns. The
/// encoder calls the first argument of `open` when it has embedded an image.
///
/// # Errors
/// As [`serve`].
pub fn serve_with(
    settings: &ServeSettings,
    bus: &Bus,
    open: impl FnOnce(Wake, &mut ErrorReporter) -> anyhow::Result<(Option<Encoder>, EmbeddingCache)>,
) -> anyhow::Result<()> {
    let mut reporter = ErrorReporter::new(bus)?;
    // Receivers first: messages sent while the encoder starts wait in their queues.
    let ports = Ports::new(bus)?;
    let own_notifier = bus.notifier(Role::Memory)?;
    let wake = move || {
        if let Err(error) = own_notifier.notify() {
            tracing::debug!(%error, "an encoder worker cannot wake the loop");
        }
    };
    let served = open(Arc::new(wake), &mut reporter)
        .and_then(|opened| MemoryServer::start(settings, bus, ports, opened, &mut reporter))
        .and_then(MemoryServer::run);
    if let Err(error) = &served {
        reporter.report(format_args!("the memory process failed: {error:#}"));
        bus.notifier(Role::Orchestrator)?.notify()?;
        sleep(LAST_WORDS);
    }
    served
}

/// Wakes the serve loop.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

struct MemoryServer<'a> {
    bus: &'a Bus,
    ports: Ports,
    reporter: &'a mut ErrorReporter,
    engine: Engine<Arc<Frame>>,
    documents: DocumentLoader,
    encoder: Option<Encoder>,
    /// Number of images embedded so far.
    embedded: u64,
    /// Episodes whose failure has not been reported.
    failures: Vec<EpisodeFailure>,
    spans: Spans,
}

impl<'a> MemoryServer<'a> {
    fn start(
        settings: &ServeSettings,
        bus: &'a Bus,
        ports: Ports,
        (encoder, embeddings): (Option<Encoder>, EmbeddingCache),
        reporter: &'a mut ErrorReporter,
    ) -> anyhow::Result<Self> {
        let documents =
            DocumentLoader::new(settings.documents.clone(), DocumentPublisher::new(bus)?);
        let book = BookFile::<DemonstrationBook>::read(&settings.demonstrations)?.book;
        let attach = bus.attach();
        let room = room_for_views(attach);
        let externals = external_memories(attach, settings.limits, encoder.as_ref())?;
        let snapshots = settings.snapshots.clone().map(SnapshotFolder::new);
        let engine = Engine::new(
            DemonstrationLibrary::new(book),
            attach.lanes,
            room,
            embeddings,
            externals,
            snapshots,
        );
        let spans = Spans::open(attach, Role::Memory, 0).context("cannot record spans")?;
        let facts = encoder.as_ref().map_or_else(Vec::new, |encoder| facts(encoder.facts()));
        bus.sender()?.send(&Handshake::new(Role::Memory, facts)?)?;
        ports.orchestrator.notify()?;
        let (embedded, failures) = (0, Vec::new());
        Ok(Self { bus, ports, reporter, engine, documents, encoder, embedded, failures, spans })
    }

    fn run(mut self) -> anyhow::Result<()> {
        while self.ports.stops.next()?.is_none() {
            match self.turn() {
                Ok(true) => {}
                Ok(false) => drop(self.bus.listener().wait(LONGEST_SLEEP)?),
                Err(error) => match error.downcast_ref() {
                    Some(missing) if self.ports.stops.explains(missing)? => break,
                    _ => return Err(error),
                },
            }
        }
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Memory as u32,
            frames_received: self.ports.frames.received(),
            // Workers read pixels in shared memory; this process sends frame ids only.
            pixel_bytes_copied: 0,
            error_reports: self.reporter.count().into(),
            ..Zeroable::zeroed()
        })?;
        Ok(self.ports.orchestrator.notify()?)
    }

    /// Handles everything that has arrived; returns whether more may have.
    fn turn(&mut self) -> anyhow::Result<bool> {
        let error_reports = self.reporter.count();
        let more = self.take_messages()?;
        self.take_external_messages()?;
        self.take_embeddings()?;
        self.answer()?;
        self.send_to_externals()?;
        self.report_failures()?;
        let learned = self.engine.take_snapshot_reports();
        for report in &learned {
            self.ports.snapshots.send(report)?;
        }
        if !learned.is_empty() {
            self.ports.orchestrator.notify()?;
        }
        for request in self.engine.take_view_requests() {
            // All have the demonstrations; each keeps the views that it was asked for.
            let world = self.bus.attach().world_of(request.demonstration);
            let world = &mut self.ports.worlds[usize::from(world)];
            world.requests.send(&request)?;
            world.is_due = true;
        }
        for world in &mut self.ports.worlds {
            if std::mem::take(&mut world.is_due) {
                world.notifier.notify()?;
            }
        }
        let found = self.submit_images()?;
        let reported = self.send_heartbeat();
        if reported || self.reporter.count() != error_reports {
            self.ports.orchestrator.notify()?;
        }
        self.write_embeddings();
        self.release_frames()?;
        Ok(more || found)
    }

    /// Reads all queues, observations up to a batch; returns whether more may have arrived. A message is sent
    /// after those that it refers to. Queues are therefore drained in the order effect, cause, and handled in the order
    /// cause, effect.
    fn take_messages(&mut self) -> anyhow::Result<bool> {
        let most = self.bus.attach().batch_len();
        let observations = self.ports.observations.drain_some(most)?;
        let more = observations.len() == most;
        let received_ns = monotonic_ns();
        let reports = self.ports.reports.drain()?;
        let views = self.ports.views.drain()?;
        for config in self.ports.configs.drain()? {
            let outcome = self.can_serve(&config).and_then(|()| self.engine.config(&config));
            self.report_unusable(outcome);
        }
        for View { frame, sequence, demonstration, step } in views {
            let view_id = ViewId { sequence, number: demonstration, step };
            let what = format_args!("view of step {step} of demonstration {demonstration}");
            if let Some(image) = self.find_frame(frame, &what)? {
                let outcome = self.engine.view(view_id, frame, image.content_hash(), image);
                self.report_unusable(outcome);
            }
        }
        for report in reports {
            let outcome = self.engine.step_report(&report);
            self.report_unusable(outcome);
        }
        for seen in observations {
            let Observation { episode, lane, step, .. } = seen;
            match self.engine.observe(&seen, received_ns) {
                Err(unusable) => self.reporter.report(unusable),
                Ok(None) => {}
                Ok(Some(frame)) => {
                    let what = format_args!("observation of episode {episode}, step {step}");
                    if let Some(image) = self.find_frame(frame, &what)? {
                        self.engine.current_view(lane, image.content_hash(), image);
                    }
                }
            }
        }
        Ok(more)
    }

    /// Reads the queues of the external memories. What cannot be used is counted, and reported now and then.
    fn take_external_messages(&mut self) -> Result<(), BusError> {
        let Self { ports, engine, reporter, .. } = self;
        for external in &mut ports.externals {
            let index = external.index;
            // A note is published before the message that names it.
            let answers = external.answers.drain()?;
            let stored = external.stored.drain()?;
            let built = external.built.drain()?;
            let notes = external.notes.drain()?;
            let now_ns = monotonic_ns();
            let notes = notes.into_iter().map(|note| engine.external_note(index, note));
            let mut outcomes: Vec<_> = notes.collect();
            outcomes.extend(built.iter().map(|message| engine.external_built(index, message)));
            outcomes.extend(stored.iter().map(|message| engine.external_stored(index, message)));
            let answered = answers.iter();
            outcomes.extend(answered.map(|message| engine.external_answer(index, message, now_ns)));
            for unusable in outcomes.into_iter().filter_map(Result::err) {
                external.unusable += 1;
                if external.unusable.is_power_of_two() {
                    reporter.report(format_args!(
                        "{unusable} (message {} of it that is of no use)",
                        external.unusable
                    ));
                }
            }
        }
        Ok(())
    }

    /// Sends what has arisen for external memories, and notifies each once.
    fn send_to_externals(&mut self) -> Result<(), BusError> {
        let Self { ports, engine, .. } = self;
        for (index, message) in engine.take_external_messages() {
            let external = ports.externals.iter_mut().find(|external| external.index == index);
            let Some(external) = external else { continue };
            match external.send(&message) {
                Ok(()) => {}
                Err(BusError::Deserted { .. }) => engine.external_left(index, monotonic_ns()),
                Err(error) => engine.external_unreachable(index, &message, &error.to_string()),
            }
            external.notifier.notify()?;
        }
        Ok(())
    }

    /// Reports episodes that cannot go on. Those for which the queue has no room are reported in the next turn.
    fn report_failures(&mut self) -> Result<(), BusError> {
        self.failures.extend(self.engine.take_failures());
        while let Some(failure) = self.failures.last() {
            let &EpisodeFailure { lane, episode, ref why, is_overdue } = failure;
            let reported = if is_overdue {
                self.reporter.overdue(lane, episode, why)
            } else {
                self.reporter.fail_episode(lane, episode, why)
            };
            match reported {
                Ok(()) => drop(self.failures.pop()),
                Err(BusError::Full { .. }) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Checks that this process was started with what an episode's memory needs.
    fn can_serve(&self, config: &MemoryEpisodeConfig) -> Result<(), String> {
        match Representation::try_from(config.representation) {
            Ok(asked) if asked.matches_views() && self.encoder.is_none() => Err(format!(
                "config of episode {}: {asked} memory matches views, and memory-proc was started with \
                 --no-encoder",
                config.episode
            )),
            // External memories are checked at the start, and the engine refuses unknown representations.
            Ok(_) | Err(_) => Ok(()),
        }
    }

    /// The frame that a message names. A missing or broken frame is reported.
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
                        "{message}: frame {id} is not in the store: it was evicted too early or never \
                         published"
                    ));
                    return Ok(None);
                }
                Err(FrameError::Bus(error)) => return Err(error),
                // The store has dropped the frame that it could not use.
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn take_embeddings(&mut self) -> anyhow::Result<()> {
        let Some(encoder) = &mut self.encoder else { return Ok(()) };
        while let Some(Embedded { content, embedding, worker, span_ns }) = encoder.poll()? {
            let track = format!("encoder {worker}");
            self.spans.add(span_ns.start, span_ns.end, &track, "embed", 1);
            if let Err(error) = self.engine.add_embedding(content, embedding?) {
                self.reporter.report(format_args!("{error}; the run continues without it"));
            }
            self.embedded += 1;
        }
        Ok(())
    }

    /// Writes new embeddings to disk about once a second.
    fn write_embeddings(&mut self) {
        if let Err(error) = self.engine.write_embeddings() {
            self.reporter.report(format_args!("{error}; the run continues without it"));
        }
    }

    /// Reports progress to the orchestrator about once a second.
    fn send_heartbeat(&mut self) -> bool {
        let (engine, done) = (&self.engine, self.embedded);
        let (held, room) = engine.pinned_views();
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
        let mut answers = self.engine.answers(monotonic_ns, &mut self.documents)?;
        for answer in &mut answers {
            let (recall, trace) = &mut **answer;
            trace.sent_ns = monotonic_ns();
            // The trace is sent before the recall, so that the policy's decision does not overtake it.
            self.ports.traces.send(trace)?;
            self.ports.recalls.send(recall)?;
        }
        if !answers.is_empty() {
            // The orchestrator reads the traces when the policy notifies it.
            self.ports.policy.notify()?;
        }
        self.spans.end(began, "memory", "recall", answers.len());
        Ok(())
    }

    /// Gives the encoder what it has room for. Returns whether another process had embedded an image meanwhile, so that
    /// there may be more to answer.
    fn submit_images(&mut self) -> anyhow::Result<bool> {
        let Some(encoder) = &mut self.encoder else { return Ok(false) };
        let known = self.engine.known_embeddings();
        while encoder.has_room()
            && let Some((content, frame)) = self.engine.next_image()
        {
            encoder.submit(content, frame)?;
        }
        Ok(self.engine.known_embeddings() > known)
    }

    fn release_frames(&mut self) -> Result<(), BusError> {
        loop {
            match self.ports.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error),
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn report_unusable(&mut self, outcome: Result<(), String>) {
        if let Err(unusable) = outcome {
            self.reporter.report(unusable);
        }
    }
}

/// The description of the external memory in `folder`. When all processes are started again, this one may be ready before
/// the memory has written it.
fn read_description(folder: &Path) -> Result<MemoryDescription, AttachError> {
    let deadline = Instant::now() + DESCRIPTION_TIMEOUT;
    loop {
        match MemoryDescription::read(folder) {
            Err(AttachError::File { cause, .. })
                if cause.kind() == ErrorKind::NotFound && Instant::now() < deadline =>
            {
                sleep(DESCRIPTION_POLL);
            }
            outcome => return outcome,
        }
    }
}

/// The external memories of the run, as they describe themselves.
///
/// # Errors
/// When a description cannot be read, or a memory uses embeddings that cannot be computed or sent.
fn external_memories(
    attach: &Attach,
    limits: ExternalLimits,
    encoder: Option<&Encoder>,
) -> anyhow::Result<ExternalMemories> {
    let mut descriptions = BTreeMap::new();
    for &index in &attach.external_memories {
        let description = read_description(&memory_folder(&attach.root, index))?;
        let name = &description.name;
        match encoder.map(|encoder| encoder.facts().dimension) {
            _ if !description.embeddings => {}
            None => bail!(
                "external memory {name} uses embeddings, and memory-proc was started with --no-encoder"
            ),
            Some(dimension) if dimension > MAX_EMBEDDING => bail!(
                "external memory {name} uses embeddings, and those of this encoder have {dimension} numbers: at most \
                 {MAX_EMBEDDING} fit into a message"
            ),
            Some(_) => {}
        }
        descriptions.insert(index, description);
    }
    Ok(ExternalMemories::new(descriptions, limits))
}

/// The number of demonstration views that fit into the frame store of any world beside what running episodes pin: each lane's
/// window, its current view and the one before.
pub(crate) fn room_for_views(attach: &Attach) -> usize {
    let pinned = u64::from(attach.lanes_of_world()) * (u64::from(attach.window) + 2);
    u64::from(attach.frame_capacity).saturating_sub(pinned) as usize
}
