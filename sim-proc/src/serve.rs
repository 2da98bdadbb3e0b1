//! The simulator in a run: commands and view requests in, frames and observations out.
//!
//! A turn takes everything that waits, applies it, evicts what has to go, publishes what has been drawn, answers
//! whatever is resident, rings those once who have something to do now (`neighbours`), and has the next few
//! missing views drawn. Painters draw on threads of their own (`easels`) and ring this process's doorbell, so a
//! lane whose view is resident never waits for another lane's drawing; what lanes wait for is drawn before what
//! memory asked for.
//!
//! A message that cannot be used is complained about and dropped; the lane or view it was about gets no
//! answer.

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use domain::{Pose, pose::UnknownCode};
use rustc_hash::FxHashMap;
use shm_types::message::{
    Eviction, Handshake, Heartbeat, NO_ACTION, NO_FRAME, Observation, Role, ShutdownReport,
    StepCommand, StepKind, Stop, View, ViewRequest, ViewRequestKind, WirePose,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Bus, BusError, ErrorReporter, FactsTooLong, FrameError, FramePublisher, FrameSlot, Heartbeats,
    Receiver, Sender, Spans,
};
use warehouse::{CaseSet, Warehouse};

use crate::control::{Control, every_pose};
use crate::easels::{Batch, Drawn, Easels, Order};
use crate::neighbours::Neighbours;
use crate::painter::{MayShowBarricade, Studio};
use crate::renderer::RenderError;
use crate::views::{NotHeld, Overfull, ViewKey, Views};
use crate::world::{BadCommand, Stepped, World};

/// What is drawn before anybody asks for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ahead {
    /// Nothing: a view is drawn when somebody first sees it.
    Nothing,
    /// Every view of the unchanged world, before the simulator says hello.
    EveryView,
}

/// How long the loop sleeps when nobody rings. Only a look around; nothing waits for it.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// How long consumers get to let go of evicted frames when no chunk is free.
const CHUNK_PATIENCE: Duration = Duration::from_secs(30);

/// How often it is looked whether the consumers of frames are there.
const CONSUMERS_LOOK: Duration = Duration::from_millis(1);

/// Why the simulator ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The frame store failed.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// More views are in use than fit.
    #[error(transparent)]
    Overfull(#[from] Overfull),
    /// The renderer failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Spans cannot be kept.
    #[error("cannot keep spans of the work: {0}")]
    Spans(#[from] std::io::Error),
    /// The renderer says too much about itself.
    #[error(transparent)]
    Facts(#[from] FactsTooLong),
    /// Views that are to be drawn ahead do not fit.
    #[error(
        "--warm-views needs room for {needed} frames and the frame store has room for {capacity}: raise \
         --frame-budget or leave --warm-views out"
    )]
    NoRoomAhead {
        /// Views of the unchanged world.
        needed: usize,
        /// Views that may be resident.
        capacity: usize,
    },
}

/// A view request that cannot be used.
#[derive(Debug, thiserror::Error)]
enum BadRequest {
    #[error("view request: {0}")]
    Code(#[from] UnknownCode),
    #[error("view request: nobody can stand at {0}")]
    Pose(Pose),
    #[error("view request: {0}")]
    Release(#[from] NotHeld),
}

/// Serves the run that `bus` has joined until the orchestrator says stop. `open` makes the renderer; the
/// simulator's queues exist before that, so peers may start to send meanwhile. What is drawn `ahead` changes
/// when things happen and nothing else.
///
/// # Errors
/// When the transport or the renderer fails, or more views are in use at once, or to be drawn ahead, than
/// fit. The orchestrator is told before.
pub fn serve(
    bus: &Bus,
    warehouse: &Warehouse,
    cases: &CaseSet,
    ahead: Ahead,
    open: impl FnOnce() -> Result<Studio, RenderError>,
) -> Result<(), ServeError> {
    let mut simulator = Simulator::new(bus, warehouse, cases)?;
    let outcome = open()
        .map_err(ServeError::from)
        .and_then(|studio| simulator.serve_until_stop(studio, ahead));
    if let Err(error) = &outcome {
        simulator.reporter.report(error);
        simulator.neighbours.ring_all()?;
    }
    outcome
}

/// An answer, and the view it waits for.
#[derive(Debug)]
struct Pending {
    view: Option<ViewKey>,
    answer: Answer,
}

#[derive(Debug)]
enum Answer {
    Observation(Observation),
    View(WirePose),
}

struct Simulator<'a> {
    bus: &'a Bus,
    commands: Receiver<StepCommand>,
    requests: Receiver<ViewRequest>,
    stops: Receiver<Stop>,
    observations: Sender<Observation>,
    resident: Sender<View>,
    evictions: Sender<Eviction>,
    neighbours: Neighbours,
    frames: FramePublisher,
    reporter: ErrorReporter,
    heartbeats: Heartbeats,
    spans: Spans,
    world: World,
    control: Control,
    views: Views,
    pending: Vec<Pending>,
    frames_rendered: u64,
    frames_evicted: u64,
    pixel_bytes_copied: u64,
}

/// Who draws, and what is worth drawing.
struct Drawing {
    easels: Easels,
    may_show_barricade: MayShowBarricade,
    /// The view that does for each that has been asked about.
    drawn_as: FxHashMap<ViewKey, ViewKey>,
}

impl<'a> Simulator<'a> {
    fn new(bus: &'a Bus, warehouse: &Warehouse, cases: &CaseSet) -> Result<Self, ServeError> {
        let attach = bus.attach();
        let (lanes, window) = (attach.lanes as usize, attach.window as usize);
        Ok(Self {
            bus,
            commands: bus.receiver()?,
            requests: bus.receiver()?,
            stops: bus.receiver()?,
            observations: bus.sender()?,
            resident: bus.sender()?,
            evictions: bus.sender()?,
            neighbours: Neighbours::new(bus)?,
            frames: FramePublisher::new(bus)?,
            reporter: ErrorReporter::new(bus)?,
            heartbeats: Heartbeats::new(bus)?,
            spans: Spans::open(attach, Role::Sim)?,
            world: World::new(warehouse, cases, lanes),
            control: Control::new(attach.frame_control, &warehouse.layout),
            views: Views::new(attach.frame_capacity as usize, lanes, window),
            pending: Vec::new(),
            frames_rendered: 0,
            frames_evicted: 0,
            pixel_bytes_copied: 0,
        })
    }

    fn serve_until_stop(
        &mut self,
        Studio { painters, at_once, may_show_barricade, facts }: Studio,
        ahead: Ahead,
    ) -> Result<(), ServeError> {
        let own_notifier = Arc::new(self.bus.notifier(Role::Sim)?);
        let easels = Easels::new(painters, at_once, move || {
            if let Err(error) = own_notifier.notify() {
                tracing::debug!(%error, "a painter cannot wake the loop");
            }
        });
        let mut drawing = Drawing { easels, may_show_barricade, drawn_as: FxHashMap::default() };
        if ahead == Ahead::EveryView {
            self.draw_every_view(&mut drawing.easels)?;
        }
        self.bus.sender()?.send(&Handshake::new(Role::Sim, facts)?)?;
        self.neighbours.ring_all()?;
        while self.stops.next()?.is_none() {
            if !self.turn(&mut drawing)? {
                self.bus.listener().wait(LONGEST_SLEEP)?;
            }
        }
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Sim as u32,
            frames_rendered: self.frames_rendered,
            frames_evicted: self.frames_evicted,
            pixel_bytes_copied: self.pixel_bytes_copied,
            error_reports: self.reporter.count().into(),
            ..Zeroable::zeroed()
        })?;
        Ok(self.neighbours.ring_all()?)
    }

    /// Draws every view of the unchanged world. All are resident afterwards, and none is pinned.
    fn draw_every_view(&mut self, easels: &mut Easels) -> Result<(), ServeError> {
        let poses = every_pose(self.world.layout());
        let views: Vec<ViewKey> = poses.map(|pose| ViewKey::World { variant: 0, pose }).collect();
        let (needed, capacity) = (views.len(), self.views.capacity());
        if needed > capacity {
            return Err(ServeError::NoRoomAhead { needed, capacity });
        }
        while !self.frames.is_complete() {
            thread::sleep(CONSUMERS_LOOK);
        }
        tracing::info!(views = needed, "drawing every view");
        views.iter().for_each(|&view| self.views.hold(view));
        while self.views.missing() > 0 {
            self.have_drawn(easels)?;
            self.bus.listener().wait(LONGEST_SLEEP)?;
            self.publish_drawn(easels)?;
        }
        for view in views {
            if let Some(frame) = self.views.frame(view)
                && let Err(error) = self.views.release(frame)
            {
                self.reporter.report(error);
            }
        }
        Ok(())
    }

    /// One turn; returns whether there may be more to do.
    fn turn(&mut self, drawing: &mut Drawing) -> Result<bool, ServeError> {
        let error_reports = self.reporter.count();
        self.take_requests()?;
        let more = self.take_commands(drawing)?;
        self.evict()?;
        self.publish_drawn(&mut drawing.easels)?;
        self.answer()?;
        if self.beat() || self.reporter.count() != error_reports {
            self.neighbours.orchestrator.wake();
        }
        self.neighbours.notify()?;
        self.have_drawn(&mut drawing.easels)?;
        Ok(more)
    }

    fn beat(&mut self) -> bool {
        let (views, done) = (&self.views, self.frames_rendered);
        self.heartbeats.beat(|| Heartbeat {
            done,
            waiting: views.missing() as u64,
            held: views.resident() as u64,
            room: views.capacity() as u64,
            ..Zeroable::zeroed()
        })
    }

    fn take_requests(&mut self) -> Result<(), BusError> {
        while let Some(request) = self.requests.next()? {
            if let Err(bad) = self.take_request(&request) {
                self.reporter.report(bad);
            }
        }
        Ok(())
    }

    fn take_request(&mut self, request: &ViewRequest) -> Result<(), BadRequest> {
        match ViewRequestKind::try_from(request.kind)? {
            ViewRequestKind::Pin => {
                let pose = Pose::try_from(request.pose)?;
                if !self.world.layout().is_free(pose.cell) {
                    return Err(BadRequest::Pose(pose));
                }
                let view = ViewKey::World { variant: 0, pose };
                self.views.hold(view);
                self.pending.push(Pending { view: Some(view), answer: Answer::View(pose.into()) });
            }
            ViewRequestKind::Release => self.views.release(request.frame)?,
        }
        Ok(())
    }

    /// Takes up as many commands as belong into a turn; returns whether there may be more.
    fn take_commands(&mut self, drawing: &mut Drawing) -> Result<bool, BusError> {
        let woken_ns = monotonic_ns();
        let most = self.bus.attach().batch_len();
        let mut taken = 0;
        while taken < most
            && let Some(command) = self.commands.next()?
        {
            if let Err(bad) = self.take_command(&command, woken_ns, drawing) {
                self.reporter.report(bad);
            }
            taken += 1;
        }
        Ok(taken == most)
    }

    fn take_command(
        &mut self,
        command: &StepCommand,
        woken_ns: u64,
        drawing: &mut Drawing,
    ) -> Result<(), BadCommand> {
        let Stepped { lane, variant, pose, feedback, begins, ends } = self.world.apply(command)?;
        let stepped_ns = monotonic_ns();
        if begins || ends {
            self.views.forget(lane);
            // Nobody waits for what an abandoned episode was about to see.
            self.pending.retain(|Pending { answer, .. }| {
                !matches!(answer, Answer::Observation(waiting) if waiting.lane == command.lane)
            });
        }
        let view = (!ends).then(|| {
            let shown = self.control.shown(variant, self.world.variant(variant), pose);
            let view = self.as_drawn(shown, drawing);
            self.views.show(lane, view);
            view
        });
        let is_there = view.is_none_or(|view| self.views.frame(view).is_some());
        let acted = command.kind == StepKind::Act as u8;
        let observation = Observation {
            episode: command.episode,
            frame: NO_FRAME,
            commanded_ns: command.sent_ns,
            woken_ns,
            stepped_ns,
            rendered_ns: if is_there { stepped_ns } else { 0 },
            sent_ns: 0,
            lane: command.lane,
            step: command.step,
            pose: pose.into(),
            feedback: feedback as u8,
            action: if acted { command.action } else { NO_ACTION },
            last: u8::from(ends),
            reserved: 0,
        };
        self.pending.push(Pending { view, answer: Answer::Observation(observation) });
        Ok(())
    }

    /// The view that does for `view`, too: variants that close the same passage look alike, and where no
    /// barricade is in sight the world looks unchanged.
    fn as_drawn(&self, view: ViewKey, drawing: &mut Drawing) -> ViewKey {
        let ViewKey::World { variant, pose } = view else { return view };
        let Drawing { may_show_barricade, drawn_as, .. } = drawing;
        *drawn_as.entry(view).or_insert_with(|| {
            let shows = may_show_barricade(self.world.variant(variant), pose);
            ViewKey::World {
                variant: if shows { self.world.first_alike(variant) } else { 0 },
                pose,
            }
        })
    }

    /// Evicts what has to go.
    fn evict(&mut self) -> Result<(), ServeError> {
        let frames = self.views.make_room()?;
        for &frame in &frames {
            self.evictions.send(&Eviction { frame })?;
        }
        self.frames_evicted += frames.len() as u64;
        if !frames.is_empty() {
            self.neighbours.memory.wake();
            self.neighbours.policy.wake();
        }
        Ok(())
    }

    /// Sends the answers whose views are resident.
    fn answer(&mut self) -> Result<(), BusError> {
        for Pending { view, answer } in std::mem::take(&mut self.pending) {
            let frame = view.map_or(Some(NO_FRAME), |view| self.views.frame(view));
            match (frame, answer) {
                (None, answer) => self.pending.push(Pending { view, answer }),
                (Some(frame), Answer::View(pose)) => {
                    self.resident.send(&View { frame, pose, reserved: 0 })?;
                    self.neighbours.memory.wake();
                }
                (Some(frame), Answer::Observation(observation)) => {
                    let observation = Observation { frame, sent_ns: monotonic_ns(), ..observation };
                    self.observations.send(&observation)?;
                    self.neighbours.observed(observation.last != 0);
                }
            }
        }
        Ok(())
    }

    /// Has the next missing views drawn, as many as painters take on.
    fn have_drawn(&mut self, easels: &mut Easels) -> Result<(), ServeError> {
        for view in self.views.take_missing(easels.room()) {
            let look = match view {
                ViewKey::World { variant, pose } => {
                    Some((self.world.variant(variant).clone(), pose))
                }
                ViewKey::Blank => None,
            };
            easels.give(Order { view, look, slot: self.loan()? })?;
        }
        Ok(())
    }

    /// Publishes what painters have finished.
    fn publish_drawn(&mut self, easels: &mut Easels) -> Result<(), ServeError> {
        while let Some(Batch { painter, span_ns, copied, drawn }) = easels.take()? {
            let track = format!("renderer {painter}");
            self.spans.add(span_ns.start, span_ns.end, &track, "draw", drawn.len());
            self.pixel_bytes_copied += copied;
            for drawn in drawn {
                self.publish(drawn, span_ns.end)?;
            }
        }
        Ok(())
    }

    /// Publishes a view that was drawn at the time `drawn_ns`. It is resident then.
    fn publish(&mut self, drawn: Drawn, drawn_ns: u64) -> Result<(), FrameError> {
        let Drawn { view, slot, content_hash } = drawn;
        let frame = self.frames.publish(slot, content_hash)?;
        self.views.fill(view, frame);
        self.frames_rendered += 1;
        for Pending { view: awaited, answer } in &mut self.pending {
            if *awaited == Some(view)
                && let Answer::Observation(observation) = answer
            {
                // It may have been drawn before the agent came there.
                observation.rendered_ns = drawn_ns.max(observation.stepped_ns);
            }
        }
        Ok(())
    }

    /// A slot; waits for a while if consumers have not let go of what was evicted.
    fn loan(&self) -> Result<FrameSlot, FrameError> {
        let deadline = Instant::now() + CHUNK_PATIENCE;
        loop {
            match self.frames.loan() {
                Err(FrameError::NoChunk { .. }) if Instant::now() < deadline => {
                    thread::sleep(Duration::from_millis(1));
                }
                outcome => return outcome,
            }
        }
    }
}
