//! A world in one generation of a run: commands and view requests in, frames and observations out.
//!
//! Each turn of the loop applies all waiting messages, evicts views, publishes rendered ones, sends the answers whose
//! views are resident, wakes each process that has work at most once (`wakeups`), and hands missing views to the render
//! workers (`render_pool`). Workers wake this process when they are done, so a lane whose view is resident never waits for
//! another lane's rendering. Views that lanes wait for are rendered before views that memory has requested.
//!
//! An invalid message is reported and dropped; the lane or view that it refers to gets no answer.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::clock::{Instant, sleep};
use shm_types::message::{
    EpisodeEnd, Eviction, Handshake, Heartbeat, NO_DOCUMENT, NO_FRAME, Observation, Role,
    ShutdownReport, StepCommand, StepReport, Stop, View, ViewRequest, ViewRequestKind,
    WorldEpisodeConfig, action_code,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Bus, BusError, ErrorReporter, FrameControl, FrameError, FramePublisher, Heartbeats,
    NotePublisher, Receiver, Sender, Spans,
};

use super::render_pool::{RenderPool, RenderRequest, RenderedBatch, RenderedView};
use super::views::ViewCache;
use super::wakeups::Wakeups;
use super::{Moment, Refusal, RenderSetup, World, WorldFailure};
use crate::connection::End;
use crate::error::ServeError;
use crate::watched_run::WatchedRun;

/// The longest sleep of the loop. Nothing relies on waking this often.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// How often to look for the next generation, where the process may outlive this one.
const LOOK_INTERVAL: Duration = Duration::from_millis(250);

/// How often to look for a free slot. A policy that is at work releases evicted frames only afterwards, and sends nothing
/// when it does.
const SLOT_POLL: Duration = Duration::from_millis(1);

/// How long to wait for a free slot before each report of it. The orchestrator decides when a process hangs.
const SLOT_PATIENCE: Duration = Duration::from_secs(30);

/// How often to check whether the consumers of frames have connected.
const CONSUMER_POLL: Duration = Duration::from_millis(1);

/// Serves `world` in the generation that `bus` has joined, until the orchestrator stops it. `open` opens the renderers after
/// the queues exist, so other processes may send meanwhile. With `warm_views`, the [first views](World::first_views) are
/// rendered before the handshake; this changes when things happen and nothing else.
///
/// # Errors
/// When the transport or a renderer fails, or more views are in use at once than fit. The orchestrator gets the error
/// first.
pub fn serve_generation<W: World>(
    bus: &Bus,
    world: &mut W,
    warm_views: bool,
    open: impl FnOnce(&mut W) -> Result<RenderSetup<W::Picture>, WorldFailure>,
) -> Result<(), ServeError> {
    serve_watched(bus, world, warm_views, None, open).map(drop)
}

/// As [`serve_generation`], and until another generation replaces it, if the process may outlive this one.
pub(super) fn serve_watched<W: World>(
    bus: &Bus,
    world: &mut W,
    warm_views: bool,
    run: Option<&WatchedRun>,
    open: impl FnOnce(&mut W) -> Result<RenderSetup<W::Picture>, WorldFailure>,
) -> Result<End, ServeError> {
    let mut session = WorldSession::new(bus, world)?;
    let outcome = open(session.world).map_err(ServeError::from);
    let outcome = outcome.and_then(|setup| session.serve_until_stop(setup, warm_views, run));
    // An interrupt is the reason of what fails after it.
    let outcome = outcome.or_else(|error| session.world.check().and(Err(error)));
    match &outcome {
        Ok(_) => {}
        Err(ServeError::Interrupted) => session.send_shutdown_report()?,
        Err(error) => {
            session.reporter.report(error);
            session.wakeups.send_to_all()?;
        }
    }
    outcome
}

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Shown<V> {
    /// A view of the world.
    View(V),
    /// Uniform grey, in place of a view: a control.
    Grey,
}

/// An answer and the view that it waits for.
#[derive(Debug)]
struct Pending<V> {
    view: Option<Shown<V>>,
    answer: PendingView,
}

#[derive(Debug)]
enum PendingView {
    /// An observation, what the orchestrator is told of the step, and the facts of the episode that ends with it, as JSON.
    Step(Observation, StepReport, Option<String>),
    /// The request of a view.
    View(ViewRequest),
}

/// The render workers.
type Pool<W> = RenderPool<Shown<<W as World>::View>, <W as World>::Picture>;

struct WorldSession<'a, W: World> {
    bus: &'a Bus,
    world: &'a mut W,
    configs: Receiver<WorldEpisodeConfig>,
    commands: Receiver<StepCommand>,
    requests: Receiver<ViewRequest>,
    stops: Receiver<Stop>,
    observations: Sender<Observation>,
    reports: Sender<StepReport>,
    facts: NotePublisher,
    resident: Sender<View>,
    evictions: Sender<Eviction>,
    wakeups: Wakeups,
    frames: FramePublisher,
    reporter: ErrorReporter,
    heartbeats: Heartbeats,
    spans: Spans,
    control: FrameControl,
    views: ViewCache<Shown<W::View>>,
    pending: Vec<Pending<W::View>>,
    /// Since when no slot is free, or when that was reported last.
    no_slot_since: Option<Instant>,
    frames_rendered: u64,
    frames_evicted: u64,
    pixel_bytes_copied: u64,
}

impl<'a, W: World> WorldSession<'a, W> {
    fn new(bus: &'a Bus, world: &'a mut W) -> Result<Self, ServeError> {
        let attach = bus.attach();
        let (lanes, window) = (attach.lanes as usize, attach.window as usize);
        Ok(Self {
            bus,
            world,
            configs: bus.receiver()?,
            commands: bus.receiver()?,
            requests: bus.receiver()?,
            stops: bus.receiver()?,
            observations: bus.sender()?,
            reports: bus.sender()?,
            facts: NotePublisher::of_facts(bus)?,
            resident: bus.sender()?,
            evictions: bus.sender()?,
            wakeups: Wakeups::new(bus)?,
            frames: FramePublisher::new(bus)?,
            reporter: ErrorReporter::new(bus)?,
            heartbeats: Heartbeats::new(bus)?,
            spans: Spans::open(attach, Role::Sim, bus.index()).map_err(ServeError::Spans)?,
            control: attach.frame_control,
            views: ViewCache::new(attach.frame_capacity as usize, lanes, window),
            pending: Vec::new(),
            no_slot_since: None,
            frames_rendered: 0,
            frames_evicted: 0,
            pixel_bytes_copied: 0,
        })
    }

    fn serve_until_stop(
        &mut self,
        setup: RenderSetup<W::Picture>,
        warm_views: bool,
        run: Option<&WatchedRun>,
    ) -> Result<End, ServeError> {
        let RenderSetup { renderers, facts } = setup;
        let notifier = Arc::new(self.bus.notifier(Role::Sim)?);
        let wake = move || {
            if let Err(error) = notifier.notify() {
                tracing::debug!(%error, "a render worker cannot wake the serve loop");
            }
        };
        let mut pool = RenderPool::new(renderers, wake)?;
        if warm_views {
            self.render_first_views(&mut pool)?;
        }
        let index = self.bus.index().into();
        self.bus.sender()?.send(&Handshake { index, ..Handshake::new(Role::Sim, facts)? })?;
        self.wakeups.send_to_all()?;
        let longest = if run.is_some() { LOOK_INTERVAL } else { LONGEST_SLEEP };
        let mut last_look = Instant::now();
        while self.stops.next()?.is_none() {
            if let Some(run) = run
                && last_look.elapsed() >= LOOK_INTERVAL
            {
                if let Some(next) = run.next(self.bus.attach())? {
                    return Ok(End::NextGeneration(next));
                }
                last_look = Instant::now();
            }
            self.world.check()?;
            match self.turn(&mut pool) {
                Ok(Duration::ZERO) => {}
                Ok(sleep) => drop(self.bus.listener().wait(sleep.min(longest))?),
                Err(ServeError::Bus(missing)) if self.stops.explains(&missing)? => break,
                Err(error) => return Err(error),
            }
        }
        self.send_shutdown_report()?;
        Ok(End::Stopped)
    }

    fn send_shutdown_report(&mut self) -> Result<(), BusError> {
        self.bus.sender()?.send(&ShutdownReport {
            role: Role::Sim as u32,
            index: self.bus.index().into(),
            frames_rendered: self.frames_rendered,
            frames_evicted: self.frames_evicted,
            pixel_bytes_copied: self.pixel_bytes_copied,
            error_reports: self.reporter.count().into(),
            ..Zeroable::zeroed()
        })?;
        self.wakeups.send_to_all()
    }

    /// Renders the first views. All are resident afterwards, and none is pinned.
    fn render_first_views(&mut self, pool: &mut Pool<W>) -> Result<(), ServeError> {
        let views: Vec<_> = self.world.first_views().into_iter().map(Shown::View).collect();
        let (needed, capacity) = (views.len(), self.views.capacity());
        if needed > capacity {
            let why = format!(
                "--warm-views needs room for {needed} frames and the frame store has room for {capacity}: raise \
                 --frame-budget or leave --warm-views out"
            );
            return Err(WorldFailure::from(why).into());
        }
        while !self.frames.is_complete() {
            sleep(CONSUMER_POLL);
        }
        tracing::info!(views = needed, "rendering every view");
        views.iter().for_each(|&view| self.views.pin_for_memory(view));
        while self.views.missing() > 0 {
            let sleep = self.request_missing(pool)?;
            self.bus.listener().wait(sleep)?;
            self.publish_rendered(pool)?;
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

    /// One turn of the loop. Returns how long it may sleep until the next: not at all if more commands may be waiting.
    fn turn(&mut self, pool: &mut Pool<W>) -> Result<Duration, ServeError> {
        let reported = self.reporter.count();
        self.take_requests()?;
        let more = self.take_commands()?;
        self.evict()?;
        self.publish_rendered(pool)?;
        self.answer()?;
        if self.beat() || self.reporter.count() != reported {
            self.wakeups.add(Role::Orchestrator);
        }
        self.wakeups.send()?;
        let sleep = self.request_missing(pool)?;
        Ok(if more { Duration::ZERO } else { sleep })
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

    fn take_request(&mut self, request: &ViewRequest) -> Result<(), String> {
        let problem = |problem: &dyn Display| format!("view request: {problem}");
        match ViewRequestKind::try_from(request.kind).map_err(|unknown| problem(&unknown))? {
            ViewRequestKind::Pin => {
                let view = self.world.remembered(request).map_err(|bad| problem(&bad))?;
                let view = match self.control {
                    FrameControl::BlankAll => Shown::Grey,
                    FrameControl::Rendered | FrameControl::Blank | FrameControl::Swapped => {
                        Shown::View(view)
                    }
                };
                self.views.pin_for_memory(view);
                let answer = PendingView::View(*request);
                self.pending.push(Pending { view: Some(view), answer });
            }
            ViewRequestKind::Release => {
                self.views.release(request.frame).map_err(|not_pinned| problem(&not_pinned))?;
            }
        }
        Ok(())
    }

    /// Begins episodes, and executes at most as many commands as a turn may take. Returns whether more may be waiting.
    fn take_commands(&mut self) -> Result<bool, ServeError> {
        let woken_ns = monotonic_ns();
        let most = self.bus.attach().batch_len();
        // The config of an episode is sent before its commands.
        let commands = self.commands.drain_some(most)?;
        for config in self.configs.drain()? {
            let WorldEpisodeConfig { episode, lane, sent_ns: commanded_ns, .. } = config;
            let report = StepReport { episode, lane, commanded_ns, woken_ns, ..Zeroable::zeroed() };
            match self.world.begin(&config) {
                Ok(moment) => self.answer_later(moment, report),
                Err(refusal) => self.refuse(lane, episode, refusal)?,
            }
        }
        for command in &commands {
            let &StepCommand { episode, lane, step, sent_ns: commanded_ns, .. } = command;
            let report =
                StepReport { episode, lane, step, commanded_ns, woken_ns, ..Zeroable::zeroed() };
            match self.world.apply(command) {
                Ok(None) => {}
                Ok(Some(moment)) => self.answer_later(moment, report),
                Err(refusal) => self.refuse(lane, episode, refusal)?,
            }
        }
        Ok(commands.len() == most)
    }

    /// Reports why there is no answer to a message about an episode.
    fn refuse(&mut self, lane: u32, episode: u64, refusal: Refusal) -> Result<(), ServeError> {
        self.world.check()?;
        match refusal {
            Refusal::Message(bad) => self.reporter.report(bad),
            Refusal::Episode(why) => self.reporter.fail_episode(lane, episode, &why)?,
        }
        Ok(())
    }

    /// Prepares the answer to a config or a command, about which `report` says whose it is, once its view is resident.
    fn answer_later(&mut self, moment: Moment<W::View>, report: StepReport) {
        let Moment { state, action, feedback, sub_goals, required, conflict, ended, .. } = moment;
        let stepped_ns = monotonic_ns();
        let lane = report.lane as usize;
        let ends = ended != EpisodeEnd::GoesOn;
        if report.step == 0 || ends {
            self.views.clear_lane(lane);
            // Drop answers about an abandoned episode.
            self.pending.retain(|Pending { answer, .. }| {
                !matches!(answer, PendingView::Step(_, waiting, _) if waiting.lane == report.lane)
            });
        }
        let view = (!ends).then_some(match self.control {
            FrameControl::Blank | FrameControl::BlankAll => Shown::Grey,
            FrameControl::Rendered | FrameControl::Swapped => Shown::View(moment.view),
        });
        view.into_iter().for_each(|view| self.views.show(lane, view));
        let is_resident = view.is_none_or(|view| self.views.frame(view).is_some());
        let report = StepReport {
            stepped_ns,
            rendered_ns: if is_resident { stepped_ns } else { 0 },
            sub_goals: sub_goals as u16,
            required: required as u16,
            ended: ended as u8,
            conflict: conflict.into(),
            state_hash: moment.state_hash,
            ..report
        };
        let observation = Observation {
            episode: report.episode,
            frame: NO_FRAME,
            lane: report.lane,
            step: report.step,
            state: state.padded(),
            feedback: feedback.0,
            action: action_code(action),
            last: ends.into(),
            reserved: [0; 5],
        };
        let answer = PendingView::Step(observation, report, moment.facts);
        self.pending.push(Pending { view, answer });
    }

    /// Evicts views to make room.
    fn evict(&mut self) -> Result<(), ServeError> {
        let frames = self.views.make_room().map_err(WorldFailure::from)?;
        for &frame in &frames {
            self.evictions.send(&Eviction { frame })?;
        }
        self.frames_evicted += frames.len() as u64;
        if !frames.is_empty() {
            self.wakeups.add(Role::Memory);
            self.wakeups.add(Role::Policy);
        }
        Ok(())
    }

    /// Sends the answers whose views are resident.
    fn answer(&mut self) -> Result<(), BusError> {
        for Pending { view, answer } in std::mem::take(&mut self.pending) {
            let frame = view.map_or(Some(NO_FRAME), |view| self.views.frame(view));
            match (frame, answer) {
                (None, answer) => self.pending.push(Pending { view, answer }),
                (Some(frame), PendingView::View(request)) => {
                    let ViewRequest { sequence, demonstration, step, .. } = request;
                    self.resident.send(&View { frame, sequence, demonstration, step })?;
                    self.wakeups.add(Role::Memory);
                }
                (Some(frame), PendingView::Step(observation, report, facts)) => {
                    let StepReport { lane, episode, .. } = report;
                    let publish = |text: String| self.facts.publish(lane, episode, text.as_bytes());
                    let facts = facts.map_or(Ok(NO_DOCUMENT), publish)?;
                    let sent_ns = monotonic_ns();
                    self.reports.send(&StepReport { frame, facts, sent_ns, ..report })?;
                    self.observations.send(&Observation { frame, ..observation })?;
                    self.wakeups.add_for_observation(observation.last != 0);
                }
            }
        }
        Ok(())
    }

    /// Sends the next missing views to the render workers, as many as they accept and slots are free. Returns how long the
    /// loop may sleep.
    fn request_missing(&mut self, pool: &mut Pool<W>) -> Result<Duration, ServeError> {
        let mut none_since = self.no_slot_since.take();
        while pool.room() > 0
            && let Some(view) = self.views.next_missing()
        {
            let slot = match self.frames.loan() {
                Err(error @ FrameError::NoChunk { .. }) => {
                    let since = none_since.get_or_insert_with(Instant::now);
                    if since.elapsed() >= SLOT_PATIENCE {
                        *since = Instant::now();
                        self.reporter.report(error);
                    }
                    self.no_slot_since = none_since;
                    return Ok(SLOT_POLL);
                }
                slot => slot?,
            };
            none_since = None;
            self.views.start_rendering(view);
            let picture = match view {
                Shown::View(view) => Some(self.world.picture(view)),
                Shown::Grey => None,
            };
            pool.send(RenderRequest { view, picture, slot })?;
        }
        Ok(LONGEST_SLEEP)
    }

    /// Publishes the views that workers have rendered.
    fn publish_rendered(&mut self, pool: &mut Pool<W>) -> Result<(), ServeError> {
        while let Some(RenderedBatch { worker, span_ns, bytes_copied, views }) = pool.take()? {
            let track = format!("renderer {worker}");
            self.spans.add(span_ns.start, span_ns.end, &track, "draw", views.len());
            self.pixel_bytes_copied += bytes_copied;
            for view in views {
                self.publish(view, span_ns.end)?;
            }
        }
        Ok(())
    }

    /// Publishes a view that was completed at `rendered_ns` and makes it resident.
    fn publish(
        &mut self,
        rendered: RenderedView<Shown<W::View>>,
        rendered_ns: u64,
    ) -> Result<(), FrameError> {
        let RenderedView { view, slot, content_hash } = rendered;
        let frame = self.frames.publish(slot, content_hash)?;
        self.views.insert(view, frame);
        self.frames_rendered += 1;
        for Pending { view: awaited, answer } in &mut self.pending {
            if *awaited == Some(view)
                && let PendingView::Step(_, report, _) = answer
            {
                // The view may have been rendered before the agent arrived.
                report.rendered_ns = rendered_ns.max(report.stepped_ns);
            }
        }
        Ok(())
    }
}
