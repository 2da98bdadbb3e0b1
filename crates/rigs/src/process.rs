//! Rigs for the crates' own tests: a run around one process, its subject, whose other roles the test plays.
//!
//! A test that cannot go on fails: everything here panics.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::collections::HashMap;
use std::ops::Deref;
use std::path::Path;
use std::process::{Child, Command};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use conformance::messages::write_scripted_world;
use domain::State;
use shm_types::documents::Content;
use shm_types::message::{
    Decision, DocumentId, ErrorReport, ErrorReportKind, FrameId, Handshake, MemoryEpisodeConfig,
    NO_DOCUMENT, NO_FRAME, Observation, PolicyEpisodeConfig, Recall, RecallTrace, Role,
    ShutdownReport, StepReport, View, ViewRequest, ViewRequestKind, read_text,
};
use shm_types::{
    Attach, BusError, DocumentStore, FramePublisher, FrameSize, FrameStore, NoteReceiver,
    PortedMessage, Receiver, RunDir,
};
use tempfile::TempDir;

use conformance::neighbours::{self, Neighbours, PolicyNeighbours};

/// A wait that takes this long hangs.
pub const LONG: Duration = Duration::from_secs(600);

/// A run in a folder of its own, which is removed in the end. Fields are dropped in order.
#[derive(Debug)]
pub struct ScratchRun {
    attach: Attach,
    _run: RunDir,
    base: TempDir,
}

impl ScratchRun {
    /// A run of `participants` with four lanes and 64 frames of 64 x 64 pixels, unless `change` sets something else.
    pub fn new(participants: &[Role], change: impl FnOnce(&mut Attach)) -> Self {
        // The names of sockets leave little room for the path.
        let base = tempfile::Builder::new().prefix("mt").tempdir_in("/dev/shm").unwrap();
        let run = RunDir::create(base.path()).unwrap();
        let mut attach = Attach {
            participants: participants.to_vec(),
            frame: FrameSize { width: 64, height: 64 },
            frame_capacity: 64,
            lanes: 4,
            ..run.attach()
        };
        change(&mut attach);
        write_scripted_world(run.path()).unwrap();
        attach.write(run.path()).unwrap();
        Self { attach, _run: run, base }
    }

    /// The run's settings.
    pub fn attach(&self) -> &Attach {
        &self.attach
    }

    /// The folder to attach to.
    pub fn path(&self) -> &Path {
        &self.attach.root
    }

    /// A folder for other files of the test.
    pub fn base(&self) -> &Path {
        self.base.path()
    }
}

/// The neighbours of a subject.
pub trait SubjectNeighbours: Deref<Target = Neighbours> + Sized {
    /// The subject's role.
    const SUBJECT: Role;

    /// Joins the run of `attach`, whose only participant is the subject.
    ///
    /// # Errors
    /// When the run cannot be joined.
    fn join(attach: &Attach) -> Result<Self, BusError>;

    /// Answers what the subject asks for while the test waits for something else.
    fn respond(&mut self) {}
}

/// A process under test.
#[derive(Debug)]
enum RigSubject {
    Thread(Option<JoinHandle<anyhow::Result<()>>>),
    Process(Child),
}

impl RigSubject {
    fn has_ended(&mut self) -> bool {
        match self {
            Self::Thread(thread) => thread.as_ref().is_none_or(JoinHandle::is_finished),
            Self::Process(child) => child.try_wait().unwrap().is_some(),
        }
    }
}

/// A subject among its neighbours. Fields are dropped in order: the subject before its run.
#[derive(Debug)]
pub struct Rig<N: SubjectNeighbours> {
    subject: RigSubject,
    /// The other roles.
    pub neighbours: N,
    /// The subject's first words, until the test asks for them.
    first_words: (Option<Handshake>, Option<ErrorReport>),
    /// Reports of another kind than was asked for, oldest first, until the test asks for theirs.
    other_reports: Vec<ErrorReport>,
    _run: ScratchRun,
}

impl<N: SubjectNeighbours> Drop for Rig<N> {
    /// After a failed test the subject must not outlive its run.
    fn drop(&mut self) {
        if let RigSubject::Process(child) = &mut self.subject {
            let _ = child.kill();
            let _ = child.wait();
        } else if !self.subject.has_ended() {
            let _ = self.neighbours.stop();
            let deadline = Instant::now() + Duration::from_secs(5);
            while !self.subject.has_ended() && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(2));
            }
        }
    }
}

impl<N: SubjectNeighbours> Rig<N> {
    /// A subject that serves in a thread of the test, in a run as [`ScratchRun::new`] makes it.
    pub fn in_thread(
        change: impl FnOnce(&mut Attach),
        serve: impl FnOnce(&Path) -> anyhow::Result<()> + Send + 'static,
    ) -> Self {
        Self::start(change, |folder| {
            let folder = folder.to_owned();
            RigSubject::Thread(Some(thread::spawn(move || serve(&folder))))
        })
    }

    /// A subject that is a process, started by the command that `command` returns for the run's folder.
    pub fn in_process(
        change: impl FnOnce(&mut Attach),
        command: impl FnOnce(&Path) -> Command,
    ) -> Self {
        Self::start(change, |folder| RigSubject::Process(command(folder).spawn().unwrap()))
    }

    /// Returns once the subject can be sent messages, or has ended. It starts last, so that its own first messages find
    /// their receivers.
    fn start(change: impl FnOnce(&mut Attach), subject: impl FnOnce(&Path) -> RigSubject) -> Self {
        let run = ScratchRun::new(&[N::SUBJECT], change);
        let neighbours = N::join(run.attach()).unwrap();
        let subject = subject(run.path());
        let (first_words, other_reports) = ((None, None), Vec::new());
        let mut rig = Self { subject, neighbours, first_words, other_reports, _run: run };
        while rig.first_words == (None, None) && !rig.subject.has_ended() {
            rig.neighbours.respond();
            rig.neighbours.wait().unwrap();
            let Neighbours { handshakes, error_reports, .. } = &*rig.neighbours;
            rig.first_words = (handshakes.next().unwrap(), error_reports.next().unwrap());
        }
        rig
    }

    /// Waits until `look` returns something.
    ///
    /// # Panics
    /// When the subject has ended, or after [`LONG`].
    #[track_caller]
    pub fn until<T>(&mut self, mut look: impl FnMut(&mut N) -> Option<T>) -> T {
        let deadline = Instant::now() + LONG;
        loop {
            // Checked first, so that messages sent before the subject ended are found.
            let over = self.subject.has_ended();
            self.neighbours.respond();
            if let Some(found) = look(&mut self.neighbours) {
                return found;
            }
            assert!(!over, "the subject has ended");
            assert!(Instant::now() < deadline, "nothing came");
            self.neighbours.wait().unwrap();
        }
    }

    /// The subject's handshake.
    ///
    /// # Panics
    /// With the text of an error report that comes instead.
    pub fn handshake(&mut self) -> Handshake {
        let (mut handshake, mut report) = std::mem::take(&mut self.first_words);
        self.until(|neighbours| {
            report = report.or(neighbours.error_reports.next().unwrap());
            if let Some(report) = &report {
                panic!("{}", read_text(&report.text, report.text_len).unwrap());
            }
            handshake.take().or_else(|| neighbours.handshakes.next().unwrap())
        })
    }

    /// The next error report that is one, and its text. Facts are kept for [`learned_facts`](Self::learned_facts).
    pub fn error_report(&mut self) -> (ErrorReport, String) {
        self.report(|kind| kind != ErrorReportKind::Facts as u32)
    }

    /// The next facts that the subject has learned since its handshake, as JSON. Other reports are kept for
    /// [`error_report`](Self::error_report).
    pub fn learned_facts(&mut self) -> String {
        self.report(|kind| kind == ErrorReportKind::Facts as u32).1
    }

    fn report(&mut self, is_awaited: impl Fn(u32) -> bool) -> (ErrorReport, String) {
        let mut others = std::mem::take(&mut self.other_reports);
        others.extend(self.first_words.1.take());
        let report = match others.iter().position(|report| is_awaited(report.kind)) {
            Some(kept) => others.remove(kept),
            None => self.until(|neighbours| {
                let next = neighbours.error_reports.next().unwrap()?;
                if !is_awaited(next.kind) {
                    others.push(next);
                    return None;
                }
                Some(next)
            }),
        };
        self.other_reports = others;
        (report, read_text(&report.text, report.text_len).unwrap().to_owned())
    }

    /// The texts of the next `count` error reports.
    pub fn error_texts(&mut self, count: usize) -> Vec<String> {
        (0..count).map(|_| self.error_report().1).collect()
    }

    /// Wakes the subject.
    pub fn notify(&self) {
        self.neighbours.notify().unwrap();
    }

    /// Stops the subject, which has to end without an error, and returns its shutdown report.
    pub fn stop(mut self) -> ShutdownReport {
        // Connects to the subject, as the orchestrator does at its handshake: it may end right after it has sent the report.
        assert!(self.neighbours.shutdown_reports.next().unwrap().is_none());
        self.neighbours.stop().unwrap();
        let report = self.until(|neighbours| neighbours.shutdown_reports.next().unwrap());
        self.end().unwrap();
        report
    }

    /// Waits until the subject ends by itself.
    ///
    /// # Errors
    /// When it ends with one: that of a thread as it is, that of a process as its exit status.
    pub fn end(&mut self) -> anyhow::Result<()> {
        let deadline = Instant::now() + LONG;
        while !self.subject.has_ended() {
            assert!(Instant::now() < deadline, "the subject does not end");
            thread::sleep(Duration::from_millis(2));
        }
        match &mut self.subject {
            RigSubject::Thread(thread) => thread.take().unwrap().join().unwrap(),
            RigSubject::Process(child) => {
                let status = child.wait()?;
                anyhow::ensure!(status.success(), "{status}");
                Ok(())
            }
        }
    }
}

impl SubjectNeighbours for PolicyNeighbours {
    const SUBJECT: Role = Role::Policy;

    fn join(attach: &Attach) -> Result<Self, BusError> {
        Self::join(attach)
    }
}

/// A policy among its neighbours.
pub type PolicyRig = Rig<PolicyNeighbours>;

impl PolicyRig {
    /// Publishes a grey frame of one brightness.
    pub fn publish(&mut self, grey: u8) -> FrameId {
        self.neighbours.publish([grey; 16], |pixels| pixels.fill(grey)).unwrap()
    }

    /// Publishes a document for the whole run.
    pub fn publish_document(&mut self, content: &Content) -> DocumentId {
        self.neighbours.documents.publish(None, content).unwrap()
    }

    /// Begins an episode. Does not notify.
    pub fn begin(&self, config: &PolicyEpisodeConfig) {
        self.neighbours.send(config).unwrap();
    }

    /// Sends the messages of a step. Does not notify.
    pub fn ask(&self, observation: &Observation, recall: &Recall) {
        self.neighbours.observe(observation).unwrap();
        self.neighbours.send(recall).unwrap();
    }

    /// Sends the messages of a step, and notifies.
    pub fn step(&self, observation: &Observation, recall: &Recall) {
        self.ask(observation, recall);
        self.notify();
    }

    /// The next `count` decisions, or more.
    pub fn decisions(&mut self, count: usize) -> Vec<Decision> {
        let mut all = Vec::new();
        self.until(|neighbours| {
            all.extend(neighbours.decisions.drain().unwrap());
            (all.len() >= count).then_some(())
        });
        all
    }
}

impl SubjectNeighbours for neighbours::ExternalMemoryNeighbours {
    const SUBJECT: Role = Role::ExternalMemory;

    fn join(attach: &Attach) -> Result<Self, BusError> {
        Self::join(attach)
    }
}

/// An external memory among its neighbours.
pub type ExternalMemoryRig = Rig<neighbours::ExternalMemoryNeighbours>;

impl ExternalMemoryRig {
    /// Publishes a grey frame of one brightness.
    pub fn publish(&mut self, grey: u8) -> FrameId {
        let mut slot = self.neighbours.frames.loan().unwrap();
        slot.pixels_mut().fill(grey);
        self.neighbours.frames.publish(slot, [grey; 16]).unwrap()
    }
}

/// The neighbours of a simulator.
#[derive(Debug)]
pub struct SimNeighbours {
    /// Views for memory.
    pub views: Receiver<View>,
    /// The frames of memory and policy.
    pub stores: [FrameStore; 2],
    /// Observations as memory and policy receive them.
    observers: [Receiver<Observation>; 2],
    /// What the orchestrator is told.
    pub reports: Receiver<StepReport>,
    /// The facts of episodes.
    pub facts: NoteReceiver,
    neighbours: Neighbours,
}

impl Deref for SimNeighbours {
    type Target = Neighbours;

    fn deref(&self) -> &Neighbours {
        &self.neighbours
    }
}

impl SubjectNeighbours for SimNeighbours {
    const SUBJECT: Role = Role::Sim;

    fn join(attach: &Attach) -> Result<Self, BusError> {
        let neighbours = Neighbours::join(attach, Role::Sim)?;
        let [memory, policy] = [Role::Memory, Role::Policy].map(|role| neighbours.bus(&[role]));
        Ok(Self {
            views: memory.receiver()?,
            stores: [FrameStore::new(memory)?, FrameStore::new(policy)?],
            observers: [memory.receiver()?, policy.receiver()?],
            reports: neighbours.receiver()?,
            facts: NoteReceiver::of_facts(neighbours.bus(&[Role::Orchestrator]))?,
            neighbours,
        })
    }
}

/// What a simulator has answered.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// To memory and policy.
    pub observation: Observation,
    /// To the orchestrator.
    pub report: StepReport,
}

impl Deref for Seen {
    type Target = Observation;

    fn deref(&self) -> &Observation {
        &self.observation
    }
}

/// A simulator among its neighbours.
pub type SimRig = Rig<SimNeighbours>;

impl SimRig {
    /// Sends a config or a command. Does not notify.
    pub fn command<M: PortedMessage>(&self, command: &M) {
        self.neighbours.send(command).unwrap();
    }

    /// Wakes the simulator and waits for `count` answers: a report, then an observation, which both receivers must get.
    pub fn observe(&mut self, count: usize) -> Vec<Seen> {
        self.notify();
        let mut seen = Vec::new();
        while seen.len() < count {
            let report = self.until(|neighbours| neighbours.reports.next().unwrap());
            let [observation, same] =
                [0, 1].map(|at| self.until(|neighbours| neighbours.observers[at].next().unwrap()));
            assert_eq!(same, observation);
            let StepReport { lane, episode, step, frame, .. } = report;
            assert_eq!(
                (lane, episode, step),
                (observation.lane, observation.episode, observation.step)
            );
            assert_eq!(frame, observation.frame);
            seen.push(Seen { observation, report });
        }
        for store in &mut self.neighbours.stores {
            store.apply_evictions().unwrap();
        }
        seen
    }

    /// Sends a config or a command and waits for its answer.
    pub fn ask<M: PortedMessage>(&mut self, command: &M) -> Seen {
        self.command(command);
        self.observe(1)[0]
    }

    /// Asks for the view of a step of a demonstration, as memory. Does not notify.
    pub fn pin(&self, demonstration: u32, step: u32) {
        let (kind, frame) = (ViewRequestKind::Pin as u8, NO_FRAME);
        let request = ViewRequest { frame, demonstration, step, kind, ..Zeroable::zeroed() };
        self.neighbours.send(&request).unwrap();
    }

    /// Releases a frame, as memory. Does not notify.
    pub fn release(&self, frame: FrameId) {
        let kind = ViewRequestKind::Release as u8;
        self.neighbours.send(&ViewRequest { frame, kind, ..Zeroable::zeroed() }).unwrap();
    }

    /// The view that memory gets next.
    pub fn view(&mut self) -> View {
        self.notify();
        self.until(|neighbours| neighbours.views.next().unwrap())
    }
}

/// The neighbours of a memory. The simulator shows it every view that it asks for.
#[derive(Debug)]
pub struct MemoryNeighbours {
    /// The documents of the policy.
    pub documents: DocumentStore,
    /// The states of the demonstrations.
    pub demonstrations: Vec<Vec<State>>,
    /// The state of each frame.
    pub shown: HashMap<FrameId, State>,
    /// Views that memory has released.
    pub released: usize,
    /// Those of the orchestrator.
    reports: Receiver<StepReport>,
    recalls: Receiver<Recall>,
    traces: Receiver<RecallTrace>,
    requests: Receiver<ViewRequest>,
    frames: FramePublisher,
    neighbours: Neighbours,
}

impl Deref for MemoryNeighbours {
    type Target = Neighbours;

    fn deref(&self) -> &Neighbours {
        &self.neighbours
    }
}

impl SubjectNeighbours for MemoryNeighbours {
    const SUBJECT: Role = Role::Memory;

    fn join(attach: &Attach) -> Result<Self, BusError> {
        let neighbours = Neighbours::join(attach, Role::Memory)?;
        Ok(Self {
            documents: DocumentStore::new(neighbours.bus(&[Role::Policy]))?,
            demonstrations: Vec::new(),
            shown: HashMap::new(),
            released: 0,
            reports: neighbours.bus(&[Role::Orchestrator]).receiver()?,
            recalls: neighbours.receiver()?,
            traces: neighbours.receiver()?,
            requests: neighbours.receiver()?,
            frames: FramePublisher::new(neighbours.bus(&[Role::Sim]))?,
            neighbours,
        })
    }

    fn respond(&mut self) {
        self.reports.drain().unwrap();
        for request in self.requests.drain().unwrap() {
            if request.kind == ViewRequestKind::Pin as u8 {
                let ViewRequest { sequence, demonstration, step, .. } = request;
                let frame =
                    self.publish(self.demonstrations[demonstration as usize][step as usize]);
                self.send(&View { frame, sequence, demonstration, step }).unwrap();
                self.notify().unwrap();
            } else {
                assert!(self.shown.contains_key(&request.frame));
                self.released += 1;
            }
        }
    }
}

impl MemoryNeighbours {
    /// Publishes a frame for `state`, with stripes that no other state has.
    fn publish(&mut self, state: State) -> FrameId {
        let mut slot = self.frames.loan().unwrap();
        let width = self.attach().frame.width as usize;
        let seed = *blake3::hash(state.to_string().as_bytes()).as_bytes();
        for (index, byte) in slot.pixels_mut().iter_mut().enumerate() {
            let (column, row) = (index / 4 % width, index / 4 / width);
            *byte = seed[(column / 8 + 3 * (row / 8)) % 32] ^ (index % 4) as u8;
        }
        let hash = *blake3::hash(slot.pixels()).as_bytes().first_chunk().unwrap();
        let id = self.frames.publish(slot, hash).unwrap();
        self.shown.insert(id, state);
        id
    }
}

/// A memory among its neighbours.
pub type MemoryRig = Rig<MemoryNeighbours>;

impl MemoryRig {
    /// Begins an episode.
    pub fn begin(&self, config: &MemoryEpisodeConfig) {
        self.neighbours.send(config).unwrap();
        self.notify();
    }

    /// Sends an observation with a frame of its state, or without one if it is the last.
    pub fn observe(&mut self, seen: Observation) {
        let frame = match seen.last {
            1 => NO_FRAME,
            _ => self.neighbours.publish(State::new(&seen.state[..3]).unwrap()),
        };
        self.observe_as(Observation { frame, ..seen });
    }

    /// Sends the report of a step and this observation.
    pub fn observe_as(&self, seen: Observation) {
        let Observation { episode, lane, step, frame, .. } = seen;
        let report = StepReport { episode, lane, step, frame, ..Zeroable::zeroed() };
        self.neighbours.send(&report).unwrap();
        self.neighbours.observe(&seen).unwrap();
        self.notify();
    }

    /// The next recall, and its trace.
    pub fn recall(&mut self) -> (Recall, RecallTrace) {
        let recall = self.until(|neighbours| neighbours.recalls.next().unwrap());
        let trace = self.until(|neighbours| neighbours.traces.next().unwrap());
        assert_eq!(
            (recall.episode, recall.lane, recall.step),
            (trace.episode, trace.lane, trace.step)
        );
        let times =
            [trace.received_ns, trace.embedded_ns, trace.searched_ns, trace.sent_ns, u64::MAX];
        assert!(times.is_sorted() && times[0] > 0);
        (recall, trace)
    }

    /// The states of the views of a recall's segment, in order.
    pub fn segment(&self, recall: &Recall) -> Vec<State> {
        let segment = &recall.steps[..recall.steps_len as usize];
        segment.iter().map(|entry| self.neighbours.shown[&entry.frame]).collect()
    }

    /// The documents that a recall names, in order, and their episodes; 0 stands for the run.
    pub fn documents(&mut self, recall: &Recall) -> Vec<(DocumentId, u64, Content)> {
        let items = &recall.items[..recall.items_len as usize];
        let ids = items.iter().map(|item| item.document).filter(|&id| id != NO_DOCUMENT);
        let documents = &mut self.neighbours.documents;
        let named = |id: DocumentId| {
            let document = documents.get(id).unwrap().expect("published before it is named");
            (id, document.episode, document.content.clone())
        };
        ids.map(named).collect()
    }
}
