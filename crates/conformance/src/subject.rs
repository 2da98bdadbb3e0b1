//! The process under test: started as a run starts it, asked through its [`neighbours`](crate::neighbours), and watched.
//!
//! It tracks its requests, so that each answer is either the one to an open request or a mistake that can be named. What differs between policies, memories and worlds is its [`TestedRole`].

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use std::{fs, io};

use shm_types::message::{ErrorReportKind, FrameId, RequestId, Role, WIRE_VERSION, read_text};
use shm_types::{Attach, BusError, FrameError, FramePublisher};
use supervise::{ChildExit, Children, Launch};

use crate::messages::write_scripted_world;
use crate::neighbours::{Neighbours, TICK};

/// How long to look for messages that must not come.
const QUIET_TIME: Duration = Duration::from_millis(60);

/// How long a process may take to drop evicted frames.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(5);

/// Pixels of a stripe.
const STRIPE: usize = 16;

/// Why a check ended early.
#[derive(Debug)]
pub(crate) enum Trouble {
    /// The process violates the protocol.
    Wrong(String),
    /// The process does something that is wrong unless it is intended.
    Doubtful(String),
    /// The check does not apply to this process.
    NotApplicable(String),
    /// The check itself failed.
    Broken(anyhow::Error),
}

pub(crate) type CheckResult<T> = Result<T, Trouble>;

pub(crate) fn wrong<T>(what: impl Display) -> CheckResult<T> {
    Err(Trouble::Wrong(what.to_string()))
}

impl From<BusError> for Trouble {
    /// The process under test is the only other one: if a message cannot be delivered, it does not receive, or too slowly.
    fn from(error: BusError) -> Self {
        Self::Wrong(error.to_string())
    }
}

impl From<anyhow::Error> for Trouble {
    fn from(error: anyhow::Error) -> Self {
        Self::Broken(error)
    }
}

/// The state of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RequestState {
    /// It waits for its answer.
    Open,
    /// It has been answered.
    Answered,
    /// Its episode is over: a late answer does no harm.
    Over,
    /// It cannot be answered.
    Impossible,
    /// It cannot be answered, other than with a failure.
    Unusable,
}

/// The request of the next step.
pub(crate) fn next(id: RequestId) -> RequestId {
    RequestId { step: id.step + 1, ..id }
}

/// How the process is started, and its time limits.
pub(crate) struct Terms<'a> {
    pub(crate) launch: &'a Launch,
    /// The command line as the user gave it.
    pub(crate) command: &'a str,
    pub(crate) answer_timeout: Duration,
    pub(crate) end_timeout: Duration,
    pub(crate) start_timeout: Duration,
    /// Set by the user's Ctrl-C.
    pub(crate) stop: &'a AtomicBool,
}

impl Terms<'_> {
    pub(crate) fn check_stop(&self) -> CheckResult<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Trouble::Broken(anyhow::anyhow!("stopped")));
        }
        Ok(())
    }
}

/// The role that is tested: what its neighbours are, and what an answer is.
pub(crate) trait TestedRole: Default {
    /// The role.
    const ROLE: Role;
    /// The role in a sentence, with its article.
    const A_PROCESS: &'static str;
    /// The fact of the handshake that holds its name.
    const NAME_FACT: &'static str;
    /// An answer in a sentence.
    const ANSWER: &'static str;
    /// The same, with its article.
    const AN_ANSWER: &'static str;
    /// What an answer that must not come could not be.
    const ANSWERED: &'static str;
    /// Whether the process waits for `attach.json`.
    const WAITS_FOR_RUN: bool;

    /// The other roles of the run.
    type Neighbours: Deref<Target = Neighbours>;
    /// An answer.
    type Answer: Clone;

    /// The settings of a run with this process alone.
    fn settings(attach: Attach) -> Attach;

    /// Its index, if there can be several.
    fn index() -> u8 {
        0
    }

    /// The folder that `MEMTRANSFER_ATTACH` names, in the run's folder.
    fn folder(root: &Path) -> PathBuf {
        root.to_owned()
    }

    /// Its name, where `facts` are those of its handshake.
    fn name<'n>(&'n self, facts: &'n BTreeMap<String, String>) -> Option<&'n str> {
        facts.get(Self::NAME_FACT).map(String::as_str)
    }

    /// How `command` is started to take part in the run in `root`.
    ///
    /// # Errors
    /// When it is no command.
    fn launch(command: &str, root: &Path) -> anyhow::Result<Launch> {
        let _ = root;
        Ok(Launch { index: Self::index(), ..Launch::command(Self::ROLE, command)? })
    }

    /// Writes what the world of the run says of itself.
    ///
    /// # Errors
    /// When the file cannot be written.
    fn write_world(root: &Path) -> io::Result<()> {
        write_scripted_world(root)
    }

    /// Prepares its folder for the start of the process.
    ///
    /// # Errors
    /// When the folder cannot be changed.
    fn prepare(folder: &Path) -> CheckResult<()> {
        let _ = folder;
        Ok(())
    }

    /// Waits for what the process writes before it joins the run.
    ///
    /// # Errors
    /// When it does not write it.
    fn introduce(
        &mut self,
        folder: &Path,
        children: &mut Children,
        terms: &Terms<'_>,
    ) -> CheckResult<()> {
        let _ = (folder, children, terms);
        Ok(())
    }

    /// Joins the run as its neighbours.
    ///
    /// # Errors
    /// When the run cannot be joined.
    fn join(attach: &Attach) -> Result<Self::Neighbours, BusError>;

    /// The answers that have arrived.
    ///
    /// # Errors
    /// When the process sends something else that is wrong.
    fn receive(
        &mut self,
        neighbours: &mut Self::Neighbours,
    ) -> CheckResult<Vec<(RequestId, Self::Answer)>>;

    /// Whether the answer is valid.
    ///
    /// # Errors
    /// What is wrong with it.
    fn check(&self, id: RequestId, answer: &Self::Answer) -> Result<(), String>;

    /// All views were evicted.
    fn evicted(&mut self) {}

    /// The reason, if the process refuses to answer.
    fn refusal(answer: &Self::Answer) -> Option<String>;
}

/// A role that is shown frames.
pub(crate) trait SeesFrames: TestedRole {
    /// Publishes the frames of the run.
    fn frames(neighbours: &mut Self::Neighbours) -> &mut FramePublisher;
}

/// A process in one generation. The fields are dropped in order: the process ends before the services.
pub(crate) struct Subject<'a, R: TestedRole> {
    children: Children,
    pub(crate) terms: &'a Terms<'a>,
    pub(crate) neighbours: R::Neighbours,
    pub(crate) role: R,
    requests: BTreeMap<RequestId, RequestState>,
    answers: BTreeMap<RequestId, R::Answer>,
    errors: Vec<String>,
    /// The resident views and their content hashes.
    resident: Vec<(FrameId, [u8; 16])>,
    /// The number of the last episode that began.
    last_episode: u64,
    /// The name, and how long it took to get ready.
    pub(crate) introduction: String,
}

impl<'a, R: TestedRole> Subject<'a, R> {
    /// Starts the process and waits until it is ready.
    pub(crate) fn start(attach: &Attach, terms: &'a Terms<'a>) -> CheckResult<Self> {
        let root = &attach.root;
        let folder = R::folder(root);
        fs::create_dir_all(&folder).map_err(anyhow::Error::from)?;
        R::prepare(&folder)?;
        if R::WAITS_FOR_RUN {
            Attach::withdraw(root).map_err(anyhow::Error::from)?;
        } else {
            R::write_world(root).map_err(anyhow::Error::from)?;
            attach.write(root).map_err(anyhow::Error::from)?;
        }
        let neighbours = R::join(attach).map_err(anyhow::Error::from)?;
        let launch = terms.launch.clone().attached_to(root);
        let mut subject = Self {
            children: Children::start(&[launch], &root.join("logs"))?,
            terms,
            neighbours,
            role: R::default(),
            requests: BTreeMap::new(),
            answers: BTreeMap::new(),
            errors: Vec::new(),
            resident: Vec::new(),
            // Unique over all generations.
            last_episode: u64::from(attach.generation) << 32,
            introduction: String::new(),
        };
        let began = Instant::now();
        subject.role.introduce(&folder, &mut subject.children, terms)?;
        if R::WAITS_FOR_RUN {
            R::write_world(root).map_err(anyhow::Error::from)?;
            attach.write(root).map_err(anyhow::Error::from)?;
        }
        subject.wait_for_handshake(began)?;
        Ok(subject)
    }

    fn wait_for_handshake(&mut self, began: Instant) -> CheckResult<()> {
        let timeout = self.terms.start_timeout;
        let handshake = loop {
            if let Some(handshake) = self.neighbours.handshakes.next()? {
                break handshake;
            }
            self.check_alive()?;
            if began.elapsed() > timeout {
                return wrong(format_args!("no handshake within {} s", timeout.as_secs()));
            }
            self.neighbours.wait()?;
        };
        if handshake.wire_version != WIRE_VERSION {
            return wrong(format_args!(
                "its handshake has wire version {}, and the run's is {WIRE_VERSION}",
                handshake.wire_version
            ));
        }
        if handshake.role != R::ROLE as u32 {
            return wrong(format_args!(
                "its handshake has role {}, and {} is role {}",
                handshake.role,
                R::A_PROCESS,
                R::ROLE as u32
            ));
        }
        if handshake.index != u32::from(R::index()) {
            return wrong(format_args!(
                "its handshake has `index` {}, and its folder is that of index {}",
                handshake.index,
                R::index()
            ));
        }
        let facts = handshake.facts().map_err(|error| {
            Trouble::Wrong(format!("the facts of its handshake cannot be read: {error}"))
        })?;
        let name = self.role.name(&facts).unwrap_or("without a name");
        let seconds = began.elapsed().as_secs_f64();
        self.introduction = format!("{} {name}, ready after {seconds:.1} s", R::NAME_FACT);
        Ok(())
    }

    /// How the process ended, if it has.
    pub(crate) fn exited(&mut self) -> Option<ChildExit> {
        self.children.exited()
    }

    pub(crate) fn check_alive(&mut self) -> CheckResult<()> {
        self.terms.check_stop()?;
        match self.children.exited() {
            None => Ok(()),
            Some(exit) => wrong(format_args!("its process ended {}", exit.how())),
        }
    }

    /// The content hash of a resident view.
    pub(crate) fn content_of(&self, frame: FrameId) -> Option<[u8; 16]> {
        self.resident.iter().find(|(resident, _)| *resident == frame).map(|(_, hash)| *hash)
    }

    /// Evicts all views.
    pub(crate) fn evict_all(&mut self) -> CheckResult<()> {
        for (frame, _) in std::mem::take(&mut self.resident) {
            self.neighbours.evict(frame)?;
        }
        self.role.evicted();
        self.notify()
    }

    /// Begins an episode in `lane`: the lane's earlier one is over. Returns the request of its first step.
    pub(crate) fn next_episode(&mut self, lane: u32) -> RequestId {
        for (id, state) in &mut self.requests {
            if id.lane == lane && *state == RequestState::Open {
                *state = RequestState::Over;
            }
        }
        self.last_episode += 1;
        // The ids of a run have no order. An odd factor keeps them apart.
        let episode = self.last_episode.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        RequestId { lane, episode, step: 0 }
    }

    /// The answer to a request.
    pub(crate) fn answer(&self, id: RequestId) -> CheckResult<R::Answer> {
        self.answers.get(&id).cloned().map_or_else(|| wrong("no answer"), Ok)
    }

    /// From now on, `id` has to be answered.
    pub(crate) fn expect(&mut self, id: RequestId) {
        self.requests.insert(id, RequestState::Open);
    }

    /// From now on, an answer to `id` is a mistake.
    pub(crate) fn expect_none(&mut self, id: RequestId) {
        self.requests.insert(id, RequestState::Impossible);
    }

    pub(crate) fn notify(&self) -> CheckResult<()> {
        Ok(self.neighbours.notify()?)
    }

    /// Notifies the process, and waits until every open request is answered.
    pub(crate) fn wait(&mut self) -> CheckResult<()> {
        self.notify()?;
        let open = |subject: &Self| -> Vec<RequestId> {
            let open = subject.requests.iter().filter(|(_, state)| **state == RequestState::Open);
            open.map(|(id, _)| *id).collect()
        };
        self.listen_until(
            self.terms.answer_timeout,
            |subject| open(subject).is_empty(),
            |subject| subject.no_answer(&open(subject)),
        )
    }

    /// Receives messages until something `has_happened`, for `timeout` at most: then `what_is_missing` is wrong.
    pub(crate) fn listen_until(
        &mut self,
        timeout: Duration,
        has_happened: impl Fn(&Self) -> bool,
        what_is_missing: impl Fn(&Self) -> String,
    ) -> CheckResult<()> {
        let deadline = Instant::now() + timeout;
        loop {
            self.listen()?;
            if has_happened(self) {
                return Ok(());
            }
            if Instant::now() > deadline {
                return wrong(what_is_missing(self));
            }
            self.check_alive()?;
            self.neighbours.wait()?;
        }
    }

    fn no_answer(&self, open: &[RequestId]) -> String {
        let some = open.iter().take(3).map(|id| format!("step {} of lane {}", id.step, id.lane));
        let some = some.collect::<Vec<_>>().join(", ");
        let more = match open.len().saturating_sub(3) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let seconds = self.terms.answer_timeout.as_secs();
        let error = self.errors.first().map(|what| format!("; it reported: {what}"));
        format!("no answer to {some}{more} within {seconds} s{}", error.unwrap_or_default())
    }

    /// Checks for a moment that no unexpected message arrives.
    pub(crate) fn settle(&mut self) -> CheckResult<()> {
        self.listen_for(QUIET_TIME)?;
        match self.errors.first() {
            None => Ok(()),
            Some(what) => wrong(format_args!("it reported an error about a valid message: {what}")),
        }
    }

    /// Whether there are error reports that were not taken.
    pub(crate) fn has_errors(&self) -> bool {
        !self.errors.is_empty()
    }

    /// Receives messages for `time`.
    pub(crate) fn listen_for(&mut self, time: Duration) -> CheckResult<()> {
        let until = Instant::now() + time;
        while Instant::now() < until {
            self.neighbours.wait()?;
            self.listen()?;
            self.check_alive()?;
        }
        Ok(())
    }

    /// From now on, `id` may be answered with a failure, and otherwise not.
    pub(crate) fn expect_refusal(&mut self, id: RequestId) {
        self.requests.insert(id, RequestState::Unusable);
    }

    /// Error reports and refusals since the last call.
    pub(crate) fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.errors)
    }

    /// Receives all waiting messages.
    pub(crate) fn listen(&mut self) -> CheckResult<()> {
        for (id, answer) in self.role.receive(&mut self.neighbours)? {
            self.take(id, answer)?;
        }
        for report in self.neighbours.error_reports.drain()? {
            let text = read_text(&report.text, report.text_len).unwrap_or("(not UTF-8)");
            let kind = u8::try_from(report.kind).ok().map(ErrorReportKind::try_from);
            match kind {
                Some(Ok(ErrorReportKind::Message)) => self.errors.push(text.to_owned()),
                Some(Ok(ErrorReportKind::Waiting | ErrorReportKind::Facts)) => {}
                Some(Ok(ErrorReportKind::Episode | ErrorReportKind::Overdue)) => {
                    let lane = report.lane;
                    return wrong(format_args!("it gave up the episode of lane {lane}: {text}"));
                }
                Some(Ok(ErrorReportKind::Run)) => {
                    return wrong(format_args!("it stopped the run: {text}"));
                }
                None | Some(Err(_)) => {
                    let kind = report.kind;
                    return wrong(format_args!("an error report of unknown kind {kind}: {text}"));
                }
            }
        }
        Ok(())
    }

    /// Takes an answer, which has to be the valid one to an open request.
    fn take(&mut self, id: RequestId, answer: R::Answer) -> CheckResult<()> {
        let RequestId { lane, step, .. } = id;
        let lanes = self.neighbours.attach().lanes;
        let (an_answer, answer_word) = (R::AN_ANSWER, R::ANSWER);
        if lane >= lanes {
            let last = lanes - 1;
            return wrong(format_args!(
                "{an_answer} for lane {lane}, but the lanes are 0 to {last}"
            ));
        }
        match self.requests.get(&id) {
            Some(RequestState::Open) => {}
            Some(RequestState::Over) => return Ok(()),
            Some(RequestState::Answered) => {
                return wrong(format_args!(
                    "a second {answer_word} for step {step} of lane {lane}"
                ));
            }
            Some(RequestState::Unusable) if R::refusal(&answer).is_some() => {
                self.errors.extend(R::refusal(&answer));
                return Ok(());
            }
            Some(RequestState::Impossible | RequestState::Unusable) => {
                return wrong(format_args!(
                    "{an_answer} for step {step} of lane {lane}, which could not be {}",
                    R::ANSWERED
                ));
            }
            None => return wrong(self.unknown_request(id)),
        }
        if let Some(why) = R::refusal(&answer) {
            return wrong(format_args!("it failed at step {step} of lane {lane}: {why}"));
        }
        if let Err(error) = self.role.check(id, &answer) {
            return wrong(format_args!(
                "the {answer_word} for step {step} of lane {lane} is invalid: {error}"
            ));
        }
        self.requests.insert(id, RequestState::Answered);
        self.answers.insert(id, answer);
        Ok(())
    }

    fn unknown_request(&self, RequestId { lane, episode, step }: RequestId) -> String {
        let of_episode = |id: &&RequestId| id.lane == lane && id.episode == episode;
        let last = self.requests.keys().rfind(of_episode);
        let last = last.map_or_else(
            || "the lane has no such episode".to_owned(),
            |id| format!("its last request is step {}", id.step),
        );
        let an_answer = R::AN_ANSWER;
        format!(
            "{an_answer} for step {step} of lane {lane}, episode {episode}, without a request: {last}"
        )
    }

    /// Sends a stop message, and waits for the shutdown report and the end of the process.
    pub(crate) fn stop(mut self) -> CheckResult<()> {
        let timeout = self.terms.end_timeout;
        self.neighbours.stop()?;
        let deadline = Instant::now() + timeout;
        let (mut report, mut exit) = (None, None);
        while (report.is_none() || exit.is_none()) && Instant::now() < deadline {
            self.neighbours.wait()?;
            report = report.or(self.neighbours.shutdown_reports.next()?);
            exit = exit.or_else(|| self.children.exited());
            self.terms.check_stop()?;
        }
        let seconds = timeout.as_secs();
        match (report, exit) {
            (Some(_), Some(exit)) if exit.status.success() => Ok(()),
            (_, Some(exit)) if !exit.status.success() => {
                wrong(format_args!("its process ended {}", exit.how()))
            }
            (None, Some(_)) => wrong("it ended without a shutdown report"),
            (Some(_), _) => {
                wrong(format_args!("it still runs {seconds} s after its shutdown report"))
            }
            (None, None) => wrong(format_args!(
                "after {seconds} s it has neither sent a shutdown report nor ended"
            )),
        }
    }

    /// Waits until the process has ended by itself.
    pub(crate) fn wait_for_exit(&mut self) -> CheckResult<ChildExit> {
        wait_for_exit(&mut self.children, self.terms)
    }
}

impl<R: SeesFrames> Subject<'_, R> {
    /// Publishes a view: stripes that depend on `seed`.
    pub(crate) fn view(&mut self, seed: u64) -> CheckResult<FrameId> {
        let deadline = Instant::now() + RELEASE_TIMEOUT;
        let size = self.neighbours.attach().frame;
        let mut pixels = vec![0; size.bytes()];
        for (number, stripe) in pixels.chunks_mut(4 * STRIPE).enumerate() {
            let mixed = (number as u64).wrapping_add(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let colour = [(mixed >> 56) as u8, (mixed >> 48) as u8, seed as u8, 255];
            stripe.copy_from_slice(&[colour; STRIPE].as_flattened()[..stripe.len()]);
        }
        let mut hash = [0; 16];
        hash.copy_from_slice(&blake3::hash(&pixels).as_bytes()[..16]);
        loop {
            let frames = R::frames(&mut self.neighbours);
            let published = frames.loan().and_then(|mut slot| {
                slot.pixels_mut().copy_from_slice(&pixels);
                frames.publish(slot, hash)
            });
            match published {
                Ok(id) => {
                    self.resident.push((id, hash));
                    return Ok(id);
                }
                Err(FrameError::NoChunk { chunks }) if Instant::now() > deadline => {
                    return wrong(format_args!(
                        "{} s after frames were evicted, it still keeps most of the {chunks} frames of the store",
                        RELEASE_TIMEOUT.as_secs()
                    ));
                }
                Err(FrameError::NoChunk { .. }) => {
                    self.neighbours.notify()?;
                    self.listen()?;
                    self.check_alive()?;
                    thread::sleep(TICK);
                }
                Err(error) => return wrong(error),
            }
        }
    }

    /// Publishes a view for each of `seeds`.
    pub(crate) fn views(
        &mut self,
        seeds: impl IntoIterator<Item = u64>,
    ) -> CheckResult<Vec<FrameId>> {
        seeds.into_iter().map(|seed| self.view(seed)).collect()
    }
}

/// Waits until a process of `children` has ended by itself.
pub(crate) fn wait_for_exit(children: &mut Children, terms: &Terms<'_>) -> CheckResult<ChildExit> {
    let timeout = terms.end_timeout;
    let deadline = Instant::now() + timeout;
    loop {
        if let Some(exit) = children.exited() {
            return Ok(exit);
        }
        terms.check_stop()?;
        if Instant::now() > deadline {
            return wrong(format_args!("it still runs after {} s", timeout.as_secs()));
        }
        thread::sleep(TICK);
    }
}
