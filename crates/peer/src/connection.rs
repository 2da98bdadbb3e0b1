//! One generation of a run, for any role: handshake, serve loop, frames, heartbeats, shutdown.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::Duration;

use bytemuck::Zeroable;
use case_book::{BookFile, WORLD_FILE, WorldDeclaration};
use shm_types::clock::{self, Instant, sleep};
use shm_types::message::{FrameId, Handshake, Heartbeat, Role, ShutdownReport, Stop};
use shm_types::{
    Attach, Bus, BusError, ErrorReporter, Frame, FrameError, FrameStore, Heartbeats, Notifier,
    Receiver, Spans,
};

use crate::error::ServeError;
use crate::watched_run::WatchedRun;

/// Longest sleep of the serve loop, and how often it looks for the next generation.
const MAX_SLEEP: Duration = Duration::from_millis(250);

/// Sleep while a message is expected that comes without a notification.
const SHORT_SLEEP: Duration = Duration::from_millis(1);

/// How often to look for the orchestrator before it has joined.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// How often an external memory releases evicted frames while it works on a query.
const RELEASE_INTERVAL: Duration = Duration::from_millis(50);

/// What a program does in a role.
pub trait Service {
    /// The role.
    const ROLE: Role;

    /// The state of one generation.
    type Session<'s>: Session
    where
        Self: 's;

    /// Joins a generation.
    ///
    /// # Errors
    /// When the generation cannot be joined, or this process does not take part in it.
    fn join(&self, attach: Attach) -> Result<Bus, BusError> {
        Bus::join(attach, Self::ROLE)
    }

    /// Facts for the run's manifest, as names and values.
    fn facts(&self) -> Vec<(&str, String)>;

    /// Creates the receivers and senders of a generation.
    ///
    /// # Errors
    /// When a service cannot be opened.
    fn start<'s>(&'s mut self, connection: &Connection) -> Result<Self::Session<'s>, ServeError>;
}

/// What a [`Service`] does in one generation.
pub trait Session {
    /// Receives all waiting messages, works on them and sends the results. Returns whether the orchestrator has to be
    /// notified.
    ///
    /// # Errors
    /// When the transport fails or the service cannot go on.
    fn turn(&mut self, connection: &mut Connection) -> Result<bool, ServeError>;

    /// Work done since the start, and work that waits, for the heartbeat.
    fn progress(&self) -> (u64, u64);

    /// Whether a message is expected that comes without a notification.
    fn expects_message(&self) -> bool {
        false
    }

    /// Called when a wait has ended without a notification, a few times a second, and before the first.
    ///
    /// # Errors
    /// When serving has to end.
    fn idle(&mut self) -> Result<(), ServeError> {
        Ok(())
    }

    /// Called when too many evicted frames are pinned, before the run is asked to stop.
    fn release_frames(&mut self) {}
}

/// How a generation ended.
pub(crate) enum End {
    /// A stop message came.
    Stopped,
    /// Another generation has replaced it.
    NextGeneration(Attach),
}

/// A process's place in one generation of a run.
#[derive(Debug)]
pub struct Connection {
    /// Frames, documents and messages that cannot be used are reported here.
    pub errors: ErrorReporter,
    /// Spans of the process's work, if the run asks for them.
    pub spans: Spans,
    world: Arc<WorldDeclaration>,
    frames: SharedFrames,
    heartbeats: Heartbeats,
    stops: Receiver<Stop>,
    orchestrator: Notifier,
    pin_limit: usize,
    is_over_pin_limit: bool,
    // The last field: the ports above are dropped first.
    bus: Bus,
}

/// The frame store of the process. An external memory may work on one query for minutes; a thread of its own releases
/// evicted frames in the meantime, because the simulator needs their memory.
#[derive(Debug)]
struct SharedFrames(Arc<Mutex<FrameStore>>);

impl SharedFrames {
    fn new(bus: &Bus) -> Result<Self, ServeError> {
        let frames = Arc::new(Mutex::new(FrameStore::new(bus)?));
        // A simulation has no such thread: the serve loop releases them, too.
        if bus.role() == Role::ExternalMemory && !clock::is_simulated() {
            let frames = Arc::downgrade(&frames);
            thread::Builder::new()
                .name("evictions".to_owned())
                .spawn(move || release_evicted(&frames))?;
        }
        Ok(Self(frames))
    }

    fn lock(&self) -> MutexGuard<'_, FrameStore> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Releases evicted frames until the store is dropped.
fn release_evicted(frames: &Weak<Mutex<FrameStore>>) {
    while let Some(frames) = frames.upgrade() {
        // Frames that cannot be used are dropped, and the transport's failure ends the serve loop as well.
        let outcome = frames.lock().unwrap_or_else(PoisonError::into_inner).apply_evictions();
        drop(frames);
        if let Err(error) = outcome {
            tracing::debug!(%error, "evictions");
        }
        thread::sleep(RELEASE_INTERVAL);
    }
}

impl Connection {
    pub(crate) fn new(bus: Bus) -> Result<Self, ServeError> {
        let attach = bus.attach();
        let world = BookFile::read(&attach.root.join(WORLD_FILE))?.book;
        Ok(Self {
            world: Arc::new(world),
            errors: ErrorReporter::new(&bus)?,
            spans: Spans::open(attach, bus.role(), bus.index()).map_err(ServeError::Spans)?,
            frames: SharedFrames::new(&bus)?,
            heartbeats: Heartbeats::new(&bus)?,
            stops: bus.receiver()?,
            orchestrator: bus.notifier(Role::Orchestrator)?,
            pin_limit: attach.spare_frames() as usize / 2,
            is_over_pin_limit: false,
            bus,
        })
    }

    /// The generation's bus.
    pub fn bus(&self) -> &Bus {
        &self.bus
    }

    /// What the world of the run says of itself.
    pub const fn world(&self) -> &Arc<WorldDeclaration> {
        &self.world
    }

    /// The frame that `id` names, which stays readable while the result lives; `None` if there is none.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn frame(&mut self, id: FrameId) -> Result<Option<Arc<Frame>>, ServeError> {
        loop {
            let found = self.frames.lock().get(id).map(|frame| frame.cloned());
            match found {
                Ok(frame) => return Ok(frame),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                // The store has dropped the invalid frame.
                Err(error) => self.errors.report(error),
            }
        }
    }

    /// Serves until the generation ends. A program that is interrupted says so to the orchestrator.
    pub(crate) fn serve<S: Service>(
        &mut self,
        service: &mut S,
        run: &WatchedRun,
    ) -> Result<End, ServeError> {
        let ended = self.serve_until_end(service, run);
        if let Ok(End::Stopped) | Err(ServeError::Interrupted) = ended {
            self.send_shutdown_report()?;
        }
        ended
    }

    fn serve_until_end<S: Service>(
        &mut self,
        service: &mut S,
        run: &WatchedRun,
    ) -> Result<End, ServeError> {
        // The session creates its receivers first: other processes send as soon as all handshakes are in.
        let index = self.bus.index().into();
        let handshake = Handshake { index, ..Handshake::new(S::ROLE, service.facts())? };
        let mut session = service.start(self)?;
        let handshakes = self.bus.sender()?;
        // The orchestrator may not have joined yet, or be in the next generation already.
        while !handshakes.is_complete() {
            if let Some(next) = run.next(self.bus.attach())? {
                return Ok(End::NextGeneration(next));
            }
            session.idle()?;
            sleep(POLL_INTERVAL);
        }
        handshakes.send(&handshake)?;
        self.orchestrator.notify()?;
        let mut last_look = Instant::now();
        while !self.turn(&mut session)? {
            let sleep = if session.expects_message() { SHORT_SLEEP } else { MAX_SLEEP };
            let notified = self.bus.listener().wait(sleep)?;
            if last_look.elapsed() >= MAX_SLEEP {
                if let Some(next) = run.next(self.bus.attach())? {
                    return Ok(End::NextGeneration(next));
                }
                last_look = Instant::now();
            }
            if !notified {
                session.idle()?;
            }
        }
        Ok(End::Stopped)
    }

    /// One iteration of the serve loop; returns whether a stop message came.
    fn turn(&mut self, session: &mut impl Session) -> Result<bool, ServeError> {
        let reports = self.errors.count();
        let sent = match session.turn(self) {
            Err(ServeError::Bus(missing)) if self.stops.explains(&missing)? => return Ok(true),
            sent => sent?,
        };
        self.drop_evicted_frames(session)?;
        let frames = self.frames.lock().len() as u64;
        let is_beat = self.heartbeats.beat(|| {
            let (done, waiting) = session.progress();
            Heartbeat { done, waiting, held: frames, ..Zeroable::zeroed() }
        });
        if sent || is_beat || self.errors.count() != reports {
            self.orchestrator.notify()?;
        }
        Ok(self.stops.next()?.is_some())
    }

    /// Drops evicted frames from the store. If the program itself pins too many of them, the simulator would run out of
    /// memory for new ones: then the run stops, or the external memory ends.
    fn drop_evicted_frames(&mut self, session: &mut impl Session) -> Result<(), ServeError> {
        loop {
            let outcome = self.frames.lock().apply_evictions();
            let Err(error) = outcome else { break };
            match error {
                FrameError::Bus(error) => return Err(error.into()),
                error => self.errors.report(error),
            }
        }
        let mut pinned = self.frames.lock().evicted_but_pinned();
        if pinned > self.pin_limit && !self.is_over_pin_limit {
            session.release_frames();
            pinned = self.frames.lock().evicted_but_pinned();
        }
        if pinned > self.pin_limit && !self.is_over_pin_limit {
            self.is_over_pin_limit = true;
            let role = self.bus.role();
            let why = format!(
                "the {} keeps {pinned} frames that were evicted, and at most {} are allowed: copy the pixels that are \
                 needed after a request",
                role.word(),
                self.pin_limit
            );
            if role == Role::ExternalMemory {
                // It may end itself, not the run.
                return Err(ServeError::Frames(why));
            }
            self.errors.stop_run(&why)?;
        }
        Ok(())
    }

    fn send_shutdown_report(&self) -> Result<(), ServeError> {
        self.bus.sender()?.send(&ShutdownReport {
            role: self.bus.role() as u32,
            index: self.bus.index().into(),
            frames_received: self.frames.lock().received(),
            error_reports: self.errors.count().into(),
            ..Zeroable::zeroed()
        })?;
        self.orchestrator.notify()?;
        Ok(())
    }
}
