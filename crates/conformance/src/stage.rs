//! Everybody but the policy: orchestrator, simulator and memory in this process, over the real bus.
//!
//! A stage asks questions and keeps account of them, so that each decision is either the one answer to an open
//! question or a mistake that can be named.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use domain::{Action, Feedback, Heading, Outcome, Pose};
use shm_types::documents::Content;
use shm_types::message::{
    Decision, DocumentId, ErrorReport, ErrorReportKind, Eviction, FrameId, Handshake, NO_ACTION,
    NO_FRAME, Observation, PastStep, PolicyEpisodeConfig, Recall, Role, SegmentStep,
    ShutdownReport, Stop, WIRE_VERSION, WirePose, read_text, write_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Attach, Bus, BusError, DocumentPublisher, FrameError, FramePublisher, Notifier, Receiver,
    Sender,
};

use supervise::{ChildExit, Children, Launch};

/// How often deadlines, signals and the policy's process are looked at when nobody rings.
const TICK: Duration = Duration::from_millis(20);

/// How long to listen for what nobody asked for.
const SETTLING: Duration = Duration::from_millis(60);

/// How long a policy may take to let go of evicted frames.
const LETTING_GO: Duration = Duration::from_secs(5);

/// Why a check ended early.
#[derive(Debug)]
pub(super) enum Trouble {
    /// The policy did something wrong.
    Wrong(String),
    /// It did something that is wrong unless it is meant.
    Doubtful(String),
    /// The kit itself could not go on.
    Broken(anyhow::Error),
}

/// What most of this comes to.
pub(super) type Step<T> = Result<T, Trouble>;

pub(super) fn wrong<T>(what: impl Display) -> Step<T> {
    Err(Trouble::Wrong(what.to_string()))
}

impl From<BusError> for Trouble {
    /// Nobody else is on the bus: what cannot be delivered is not received, or not fast enough.
    fn from(error: BusError) -> Self {
        Self::Wrong(error.to_string())
    }
}

impl From<anyhow::Error> for Trouble {
    fn from(error: anyhow::Error) -> Self {
        Self::Broken(error)
    }
}

/// Names a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RequestId {
    pub(super) lane: u32,
    pub(super) episode: u64,
    pub(super) step: u32,
}

impl RequestId {
    pub(super) fn next(self) -> Self {
        Self { step: self.step + 1, ..self }
    }
}

/// How it stands with a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// It waits for its answer.
    Open,
    /// It has been answered.
    Answered,
    /// Its episode is over: an answer is late, and does no harm.
    Over,
    /// It cannot be answered.
    Impossible,
}

/// What a question shows.
#[derive(Debug, Clone, Default)]
pub(super) struct Scene {
    pub(super) frame: FrameId,
    pub(super) window: Vec<FrameId>,
    pub(super) segment: Vec<FrameId>,
    pub(super) documents: Vec<DocumentId>,
}

/// What a policy is started with, and how long anything may take.
pub(super) struct Terms<'a> {
    pub(super) launch: &'a Launch,
    /// For an answer.
    pub(super) patience: Duration,
    /// For its end.
    pub(super) end_patience: Duration,
    /// Until it is ready.
    pub(super) start_patience: Duration,
    /// Set when somebody wants to end all this.
    pub(super) stop: &'a AtomicBool,
}

impl Terms<'_> {
    pub(super) fn go_on(&self) -> Step<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Trouble::Broken(anyhow::anyhow!("stopped")));
        }
        Ok(())
    }
}

/// One generation, with the policy in it. The fields are dropped in order: the policy is gone before the services.
pub(super) struct Stage<'a> {
    children: Children,
    terms: &'a Terms<'a>,
    configs: Sender<PolicyEpisodeConfig>,
    observations: Sender<Observation>,
    recalls: Sender<Recall>,
    evictions: Sender<Eviction>,
    stops: Sender<Stop>,
    /// What the simulator sends is for the orchestrator, too.
    seen: Receiver<Observation>,
    decisions: Receiver<Decision>,
    error_reports: Receiver<ErrorReport>,
    handshakes: Receiver<Handshake>,
    shutdown_reports: Receiver<ShutdownReport>,
    frames: FramePublisher,
    documents: DocumentPublisher,
    policy: Notifier,
    orchestrator: Bus,
    _others: [Bus; 2],
    questions: BTreeMap<RequestId, Standing>,
    answers: BTreeMap<RequestId, Decision>,
    reported: Vec<String>,
    resident: Vec<FrameId>,
    episodes: u64,
    /// Its own name for itself, and how long it took to be ready.
    pub(super) introduction: String,
}

impl<'a> Stage<'a> {
    /// Starts the policy and waits until it is ready.
    pub(super) fn set(attach: &Attach, terms: &'a Terms<'a>) -> Step<Self> {
        attach.write(&attach.root).map_err(anyhow::Error::from)?;
        let bus = |role| Bus::join(attach.clone(), role).map_err(anyhow::Error::from);
        let (orchestrator, sim, memory) =
            (bus(Role::Orchestrator)?, bus(Role::Sim)?, bus(Role::Memory)?);
        let (seen, decisions, error_reports, handshakes, shutdown_reports) = (
            orchestrator.receiver()?,
            orchestrator.receiver()?,
            orchestrator.receiver()?,
            orchestrator.receiver()?,
            orchestrator.receiver()?,
        );
        let (frames, documents) = (FramePublisher::new(&sim)?, DocumentPublisher::new(&memory)?);
        let launch = terms.launch.clone().attached_to(&attach.root);
        let mut stage = Self {
            children: Children::start(&[launch], &attach.root.join("logs"))?,
            terms,
            configs: orchestrator.sender()?,
            observations: sim.sender()?,
            recalls: memory.sender()?,
            evictions: sim.sender()?,
            stops: orchestrator.sender()?,
            seen,
            decisions,
            error_reports,
            handshakes,
            shutdown_reports,
            frames,
            documents,
            policy: orchestrator.notifier(Role::Policy)?,
            orchestrator,
            _others: [sim, memory],
            questions: BTreeMap::new(),
            answers: BTreeMap::new(),
            reported: Vec::new(),
            resident: Vec::new(),
            // Tickets are never used twice, in whichever generation.
            episodes: u64::from(attach.generation) << 32,
            introduction: String::new(),
        };
        stage.wait_for_hello()?;
        Ok(stage)
    }

    fn wait_for_hello(&mut self) -> Step<()> {
        let (began, patience) = (Instant::now(), self.terms.start_patience);
        let handshake = loop {
            if let Some(handshake) = self.handshakes.next()? {
                break handshake;
            }
            self.look_after()?;
            if began.elapsed() > patience {
                return wrong(format_args!("no hello within {} s", patience.as_secs()));
            }
            self.orchestrator.listener().wait(TICK)?;
        };
        if handshake.wire_version != WIRE_VERSION {
            return wrong(format_args!(
                "it says hello with wire version {}, and the run's is {WIRE_VERSION}",
                handshake.wire_version
            ));
        }
        if handshake.role != Role::Policy as u32 {
            return wrong(format_args!(
                "it says hello as role {}, and a policy is role {}",
                handshake.role,
                Role::Policy as u32
            ));
        }
        let facts = handshake.facts().map_err(|error| {
            Trouble::Wrong(format!("its hello has no facts that can be read: {error}"))
        })?;
        let name = facts.get("policy").map_or("without a name", String::as_str);
        let seconds = began.elapsed().as_secs_f64();
        self.introduction = format!("policy {name}, ready after {seconds:.1} s");
        Ok(())
    }

    /// Whether the policy's process is there. Otherwise how it ended.
    pub(super) fn death(&mut self) -> Option<ChildExit> {
        self.children.exited()
    }

    fn look_after(&mut self) -> Step<()> {
        self.terms.go_on()?;
        match self.children.exited() {
            None => Ok(()),
            Some(death) => wrong(format_args!("its process ended {}", death.how())),
        }
    }

    /// A view to show: stripes that depend on `seed`.
    pub(super) fn view(&mut self, seed: u64) -> Step<FrameId> {
        let deadline = Instant::now() + LETTING_GO;
        let mut slot = loop {
            match self.frames.loan() {
                Ok(slot) => break slot,
                Err(FrameError::NoChunk { chunks }) if Instant::now() > deadline => {
                    return wrong(format_args!(
                        "{} s after they were evicted, it holds most of the {chunks} frames that fit into the \
                         store",
                        LETTING_GO.as_secs()
                    ));
                }
                Err(FrameError::NoChunk { .. }) => {
                    self.notify()?;
                    self.look_after()?;
                    thread::sleep(TICK);
                }
                Err(error) => return Err(Trouble::Broken(error.into())),
            }
        };
        for (at, pixel) in slot.pixels_mut().chunks_exact_mut(4).enumerate() {
            let stripe = (at as u64 / 16).wrapping_add(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            pixel.copy_from_slice(&[(stripe >> 56) as u8, (stripe >> 48) as u8, seed as u8, 255]);
        }
        let mut hash = [0; 16];
        hash.copy_from_slice(&blake3::hash(slot.pixels()).as_bytes()[..16]);
        let id =
            self.frames.publish(slot, hash).map_err(|error| Trouble::Wrong(error.to_string()))?;
        self.resident.push(id);
        Ok(id)
    }

    /// As many views as `seeds` has.
    pub(super) fn views(&mut self, seeds: impl IntoIterator<Item = u64>) -> Step<Vec<FrameId>> {
        seeds.into_iter().map(|seed| self.view(seed)).collect()
    }

    /// Evicts every view that was published.
    pub(super) fn evict_all(&mut self) -> Step<()> {
        for frame in std::mem::take(&mut self.resident) {
            self.evictions.send(&Eviction { frame })?;
        }
        self.notify()
    }

    /// Publishes a document, for one episode or for the whole run.
    pub(super) fn document(
        &mut self,
        of: Option<RequestId>,
        content: &Content,
    ) -> Step<DocumentId> {
        let of = of.map(|ticket| (ticket.lane, ticket.episode));
        self.documents.publish(of, content).map_err(|error| Trouble::Wrong(error.to_string()))
    }

    /// A new episode begins in `lane`: whatever was open there is over.
    pub(super) fn begin(&mut self, lane: u32, seed: u64, instruction: &str) -> Step<RequestId> {
        for (ticket, standing) in &mut self.questions {
            if ticket.lane == lane && *standing == Standing::Open {
                *standing = Standing::Over;
            }
        }
        self.episodes += 1;
        let episode = self.episodes;
        let mut config =
            PolicyEpisodeConfig { episode, seed, lane, repeat: 1, ..Zeroable::zeroed() };
        config.instruction_len = write_text(&mut config.instruction, instruction);
        self.configs.send(&config)?;
        Ok(RequestId { lane, episode, step: 0 })
    }

    /// Asks a question: recall, then observation. Rings nobody.
    pub(super) fn ask(&mut self, ticket: RequestId, scene: &Scene) -> Step<()> {
        self.questions.insert(ticket, Standing::Open);
        self.recall(&recall(ticket, scene))?;
        self.observe(&observation(ticket, scene.frame))
    }

    /// Asks one question and waits for its answer.
    pub(super) fn ask_and_wait(&mut self, ticket: RequestId, scene: &Scene) -> Step<Decision> {
        self.ask(ticket, scene)?;
        self.notify()?;
        self.wait()?;
        self.answers.get(&ticket).copied().map_or_else(|| wrong("no answer"), Ok)
    }

    /// From now on `ticket` is a question that waits for its answer.
    pub(super) fn expect(&mut self, ticket: RequestId) {
        self.questions.insert(ticket, Standing::Open);
    }

    /// From now on `ticket` is a question that cannot be answered.
    pub(super) fn expect_none(&mut self, ticket: RequestId) {
        self.questions.insert(ticket, Standing::Impossible);
    }

    pub(super) fn recall(&mut self, message: &Recall) -> Step<()> {
        Ok(self.recalls.send(message)?)
    }

    pub(super) fn observe(&mut self, message: &Observation) -> Step<()> {
        self.seen.drain()?;
        Ok(self.observations.send(message)?)
    }

    pub(super) fn notify(&self) -> Step<()> {
        Ok(self.policy.notify()?)
    }

    /// Waits until every open question is answered.
    pub(super) fn wait(&mut self) -> Step<()> {
        let deadline = Instant::now() + self.terms.patience;
        loop {
            self.listen()?;
            let open: Vec<&RequestId> = self
                .questions
                .iter()
                .filter_map(|(ticket, standing)| (*standing == Standing::Open).then_some(ticket))
                .collect();
            if open.is_empty() {
                return Ok(());
            }
            if Instant::now() > deadline {
                let reported = self.reported.first();
                let reported = reported.map(|what| format!("; it complained: {what}"));
                let some: Vec<String> = open
                    .iter()
                    .take(3)
                    .map(|t| format!("step {} of lane {}", t.step, t.lane))
                    .collect();
                return wrong(format_args!(
                    "no answer to {}{} within {} s{}",
                    some.join(", "),
                    if open.len() > 3 {
                        format!(" and {} more", open.len() - 3)
                    } else {
                        String::new()
                    },
                    self.terms.patience.as_secs(),
                    reported.unwrap_or_default()
                ));
            }
            self.look_after()?;
            self.orchestrator.listener().wait(TICK)?;
        }
    }

    /// Listens a little longer: nothing may come that nobody asked for, and no complaint about what was right.
    pub(super) fn settle(&mut self) -> Step<()> {
        self.listen_for(SETTLING)?;
        match self.reported.first() {
            None => Ok(()),
            Some(what) => wrong(format_args!("it complained of what was right: {what}")),
        }
    }

    /// Listens for so long.
    pub(super) fn listen_for(&mut self, time: Duration) -> Step<()> {
        let until = Instant::now() + time;
        while Instant::now() < until {
            self.orchestrator.listener().wait(TICK)?;
            self.listen()?;
            self.look_after()?;
        }
        Ok(())
    }

    /// What it complained of since it was asked last.
    pub(super) fn error_reports(&mut self) -> Vec<String> {
        std::mem::take(&mut self.reported)
    }

    /// Its answer to `ticket`, once it was there.
    pub(super) fn answer(&self, ticket: RequestId) -> Option<Decision> {
        self.answers.get(&ticket).copied()
    }

    /// Hears everything that waits.
    fn listen(&mut self) -> Step<()> {
        for decision in self.decisions.drain()? {
            self.take(decision)?;
        }
        for error_report in self.error_reports.drain()? {
            let text =
                read_text(&error_report.text, error_report.text_len).unwrap_or("(not UTF-8)");
            match u8::try_from(error_report.kind).map(ErrorReportKind::try_from) {
                Ok(Ok(ErrorReportKind::Message)) => self.reported.push(text.to_owned()),
                Ok(Ok(ErrorReportKind::Waiting)) => {}
                Ok(Ok(ErrorReportKind::Episode)) => {
                    return wrong(format_args!(
                        "it gave up the episode of lane {}: {text}",
                        error_report.lane
                    ));
                }
                Ok(Ok(ErrorReportKind::Run)) => {
                    return wrong(format_args!("it stopped the run: {text}"));
                }
                _ => {
                    return wrong(format_args!(
                        "a complaint of kind {}: {text}",
                        error_report.kind
                    ));
                }
            }
        }
        Ok(())
    }

    /// Takes a decision: the answer to an open question, and a possible one.
    fn take(&mut self, decision: Decision) -> Step<()> {
        let Decision { lane, step, episode, outcome, action, .. } = decision;
        let lanes = self.orchestrator.attach().lanes;
        if lane >= lanes {
            return wrong(format_args!(
                "a decision for lane {lane}, and the lanes are 0 to {}",
                lanes - 1
            ));
        }
        let ticket = RequestId { lane, episode, step };
        match self.questions.get(&ticket) {
            Some(Standing::Open) => {}
            Some(Standing::Over) => return Ok(()),
            Some(Standing::Answered) => {
                return wrong(format_args!("a second decision for step {step} of lane {lane}"));
            }
            Some(Standing::Impossible) => {
                return wrong(format_args!(
                    "a decision for step {step} of lane {lane}, which could not be decided"
                ));
            }
            None => {
                let mut asked =
                    self.questions.keys().filter(|t| t.lane == lane && t.episode == episode);
                let asked = asked.next_back();
                let asked = asked.map(|ticket| format!("step {} was asked for", ticket.step));
                return wrong(format_args!(
                    "a decision for step {step} of lane {lane} under ticket {episode}, which nobody asked for: {}",
                    asked.unwrap_or_else(|| "no episode of that lane has the ticket".to_owned())
                ));
            }
        }
        let possible = match Outcome::try_from(outcome) {
            Ok(Outcome::Acted) => Action::try_from(action).map(drop),
            Ok(_) => Ok(()),
            Err(error) => Err(error),
        };
        if let Err(error) = possible {
            return wrong(format_args!(
                "the decision for step {step} of lane {lane} is no decision: {error}"
            ));
        }
        self.questions.insert(ticket, Standing::Answered);
        self.answers.insert(ticket, decision);
        Ok(())
    }

    /// Tells it to stop. Returns once it has said farewell and ended.
    pub(super) fn stop(mut self) -> Step<()> {
        let patience = self.terms.end_patience;
        self.stops.send(&Stop::zeroed())?;
        self.notify()?;
        let deadline = Instant::now() + patience;
        let (mut shutdown_report, mut death) = (None, None);
        while (shutdown_report.is_none() || death.is_none()) && Instant::now() < deadline {
            self.orchestrator.listener().wait(TICK)?;
            shutdown_report = shutdown_report.or(self.shutdown_reports.next()?);
            death = death.or_else(|| self.children.exited());
            self.terms.go_on()?;
        }
        match (shutdown_report, death) {
            (Some(_), Some(death)) if death.status.success() => Ok(()),
            (_, Some(death)) if !death.status.success() => {
                wrong(format_args!("its process ended {}", death.how()))
            }
            (None, Some(_)) => wrong("it ended without a farewell"),
            (Some(_), _) => wrong(format_args!(
                "it said farewell, and is still running {} s later",
                patience.as_secs()
            )),
            (None, None) => wrong(format_args!(
                "{} s later it has neither said farewell nor ended",
                patience.as_secs()
            )),
        }
    }

    /// Waits until its process has ended by itself.
    pub(super) fn wait_for_end(&mut self) -> Step<ChildExit> {
        wait_for_death(&mut self.children, self.terms)
    }
}

/// Waits until the process of `crew` has ended by itself.
pub(super) fn wait_for_death(children: &mut Children, terms: &Terms<'_>) -> Step<ChildExit> {
    let patience = terms.end_patience;
    let deadline = Instant::now() + patience;
    loop {
        if let Some(death) = children.exited() {
            return Ok(death);
        }
        terms.go_on()?;
        if Instant::now() > deadline {
            return wrong(format_args!("it is still running {} s later", patience.as_secs()));
        }
        thread::sleep(TICK);
    }
}

/// What is true after a step, as the simulator says it.
pub(super) fn observation(ticket: RequestId, frame: FrameId) -> Observation {
    let RequestId { lane, episode, step } = ticket;
    let (feedback, action) = match step {
        0 => (Feedback::Start, NO_ACTION),
        _ => (Feedback::Moved, Action::Forward as u8),
    };
    let now = monotonic_ns();
    Observation {
        lane,
        episode,
        step,
        frame,
        pose: WirePose::from(Pose::new(3, 4, Heading::E)),
        feedback: feedback as u8,
        action,
        commanded_ns: now,
        woken_ns: now,
        stepped_ns: now,
        rendered_ns: now,
        sent_ns: now,
        ..Zeroable::zeroed()
    }
}

/// The end of an episode.
pub(super) fn last(ticket: RequestId) -> Observation {
    Observation { last: 1, ..observation(ticket, NO_FRAME) }
}

/// What memory supplies for a step.
pub(super) fn recall(ticket: RequestId, scene: &Scene) -> Recall {
    let RequestId { lane, episode, step } = ticket;
    let now = monotonic_ns();
    let distance = if scene.segment.is_empty() { f32::NAN } else { 0.125 };
    let mut recall = Recall {
        lane,
        episode,
        step,
        distance,
        received_ns: now,
        sent_ns: now,
        window_len: scene.window.len() as u32,
        segment_len: scene.segment.len() as u32,
        documents_len: scene.documents.len() as u32,
        ..Zeroable::zeroed()
    };
    for (past, &frame) in recall.window.iter_mut().zip(&scene.window) {
        let (action, feedback) = (Action::Forward as u8, Feedback::Moved as u8);
        *past = PastStep { frame, action, feedback, reserved: [0; 6] };
    }
    let views = scene.segment.len();
    for (at, (view, &frame)) in recall.segment.iter_mut().zip(&scene.segment).enumerate() {
        let action = if at + 1 == views { NO_ACTION } else { Action::TurnLeft as u8 };
        *view = SegmentStep { frame, action, reserved: [0; 7] };
    }
    for (place, &document) in recall.documents.iter_mut().zip(&scene.documents) {
        *place = document;
    }
    recall
}
