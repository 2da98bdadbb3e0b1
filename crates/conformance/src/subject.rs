//! The policy under test: started as a run starts it, asked through [`PolicyNeighbours`], and watched.
//!
//! It tracks its requests, so that each decision is either the one answer to an open request or a mistake that can be
//! named.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use domain::{Action, Outcome};
use shm_types::documents::Content;
use shm_types::message::{
    Decision, ErrorReportKind, FrameId, ItemKind, Observation, Recall, RecalledItem, RequestId,
    Role, SegmentStep, WIRE_VERSION, read_text,
};
use shm_types::{Attach, BusError, FrameError};
use supervise::{ChildExit, Children, Launch};

use crate::messages::{config, item, observation, recall, supply};
use crate::neighbours::{PolicyNeighbours, TICK};

/// How long to look for messages that must not come.
const QUIET_TIME: Duration = Duration::from_millis(60);

/// How long a policy may take to drop evicted frames.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(5);

/// Why a check ended early.
#[derive(Debug)]
pub(crate) enum Trouble {
    /// The policy violates the protocol.
    Wrong(String),
    /// The policy does something that is wrong unless it is intended.
    Doubtful(String),
    /// The check itself failed.
    Broken(anyhow::Error),
}

pub(crate) type CheckResult<T> = Result<T, Trouble>;

pub(crate) fn wrong<T>(what: impl Display) -> CheckResult<T> {
    Err(Trouble::Wrong(what.to_string()))
}

impl From<BusError> for Trouble {
    /// The policy is the only other process: if a message cannot be delivered, it does not receive, or too slowly.
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
}

/// What a request shows.
#[derive(Debug, Clone, Default)]
pub(crate) struct RequestScene {
    pub(crate) frame: FrameId,
    pub(crate) segment: Vec<FrameId>,
    /// Further items, with the steps that the message holds for them.
    pub(crate) items: Vec<(RecalledItem, Vec<SegmentStep>)>,
}

impl RequestScene {
    pub(crate) fn recall(&self, id: RequestId) -> Recall {
        let mut recall = recall(id, &self.segment);
        for (item, steps) in &self.items {
            supply(&mut recall, *item, steps);
        }
        recall
    }
}

/// The request of the next step.
pub(crate) fn next(id: RequestId) -> RequestId {
    RequestId { step: id.step + 1, ..id }
}

/// How a policy is started, and its time limits.
pub(crate) struct Terms<'a> {
    pub(crate) launch: &'a Launch,
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

/// A policy in one generation. The fields are dropped in order: the policy ends before the services.
pub(crate) struct TestedPolicy<'a> {
    children: Children,
    terms: &'a Terms<'a>,
    neighbours: PolicyNeighbours,
    requests: BTreeMap<RequestId, RequestState>,
    answers: BTreeMap<RequestId, Decision>,
    errors: Vec<String>,
    resident: Vec<FrameId>,
    last_episode: u64,
    /// The policy's name, and how long it took to get ready.
    pub(crate) introduction: String,
}

impl<'a> TestedPolicy<'a> {
    /// Starts the policy and waits until it is ready.
    pub(crate) fn start(attach: &Attach, terms: &'a Terms<'a>) -> CheckResult<Self> {
        attach.write(&attach.root).map_err(anyhow::Error::from)?;
        let neighbours = PolicyNeighbours::join(attach).map_err(anyhow::Error::from)?;
        let launch = terms.launch.clone().attached_to(&attach.root);
        let mut subject = Self {
            children: Children::start(&[launch], &attach.root.join("logs"))?,
            terms,
            neighbours,
            requests: BTreeMap::new(),
            answers: BTreeMap::new(),
            errors: Vec::new(),
            resident: Vec::new(),
            // Unique over all generations.
            last_episode: u64::from(attach.generation) << 32,
            introduction: String::new(),
        };
        subject.wait_for_handshake()?;
        Ok(subject)
    }

    fn wait_for_handshake(&mut self) -> CheckResult<()> {
        let (began, timeout) = (Instant::now(), self.terms.start_timeout);
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
        if handshake.role != Role::Policy as u32 {
            return wrong(format_args!(
                "its handshake has role {}, and a policy is role {}",
                handshake.role,
                Role::Policy as u32
            ));
        }
        let facts = handshake.facts().map_err(|error| {
            Trouble::Wrong(format!("the facts of its handshake cannot be read: {error}"))
        })?;
        let name = facts.get("policy").map_or("without a name", String::as_str);
        let seconds = began.elapsed().as_secs_f64();
        self.introduction = format!("policy {name}, ready after {seconds:.1} s");
        Ok(())
    }

    /// How the policy's process ended, if it has.
    pub(crate) fn exited(&mut self) -> Option<ChildExit> {
        self.children.exited()
    }

    fn check_alive(&mut self) -> CheckResult<()> {
        self.terms.check_stop()?;
        match self.children.exited() {
            None => Ok(()),
            Some(exit) => wrong(format_args!("its process ended {}", exit.how())),
        }
    }

    /// Publishes a view: stripes that depend on `seed`.
    pub(crate) fn view(&mut self, seed: u64) -> CheckResult<FrameId> {
        let deadline = Instant::now() + RELEASE_TIMEOUT;
        let size = self.neighbours.attach().frame;
        let mut pixels = vec![0; size.bytes()];
        for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
            let stripe = (at as u64 / 16).wrapping_add(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            pixel.copy_from_slice(&[(stripe >> 56) as u8, (stripe >> 48) as u8, seed as u8, 255]);
        }
        let mut hash = [0; 16];
        hash.copy_from_slice(&blake3::hash(&pixels).as_bytes()[..16]);
        loop {
            match self.neighbours.publish(hash, |slot| slot.copy_from_slice(&pixels)) {
                Ok(id) => {
                    self.resident.push(id);
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

    /// Evicts all views.
    pub(crate) fn evict_all(&mut self) -> CheckResult<()> {
        for frame in std::mem::take(&mut self.resident) {
            self.neighbours.evict(frame)?;
        }
        self.notify()
    }

    /// Publishes a document for an episode, or for the whole run. Returns the item that supplies all of it.
    pub(crate) fn document(
        &mut self,
        of: Option<RequestId>,
        content: &Content,
    ) -> CheckResult<RecalledItem> {
        let of = of.map(|id| (id.lane, id.episode));
        let published = self.neighbours.documents.publish(of, content);
        let document = published.map_err(|error| Trouble::Wrong(error.to_string()))?;
        Ok(match content {
            Content::Trajectories(steps) => RecalledItem {
                document,
                steps: steps.len() as u32,
                whole: 1,
                ..item(ItemKind::Trajectory)
            },
            Content::Summary(text) | Content::Semantic(text) | Content::Note(text) => {
                RecalledItem { document, bytes: text.len() as u32, ..item(ItemKind::Text) }
            }
        })
    }

    /// Begins an episode with a window of six steps.
    pub(crate) fn begin(
        &mut self,
        lane: u32,
        seed: u64,
        instruction: &str,
    ) -> CheckResult<RequestId> {
        self.begin_with_window(lane, seed, instruction, 6)
    }

    /// Begins an episode in `lane`; the lane's earlier one is over.
    pub(crate) fn begin_with_window(
        &mut self,
        lane: u32,
        seed: u64,
        instruction: &str,
        window: u8,
    ) -> CheckResult<RequestId> {
        for (id, state) in &mut self.requests {
            if id.lane == lane && *state == RequestState::Open {
                *state = RequestState::Over;
            }
        }
        self.last_episode += 1;
        let episode = self.last_episode;
        let config = config(lane, episode, instruction);
        self.neighbours.send(&shm_types::message::PolicyEpisodeConfig {
            seed,
            window,
            ..config
        })?;
        Ok(RequestId { lane, episode, step: 0 })
    }

    /// Makes a request: recall, then observation. Does not notify.
    pub(crate) fn ask(&mut self, id: RequestId, scene: &RequestScene) -> CheckResult<()> {
        self.expect(id);
        self.recall(&scene.recall(id))?;
        self.observe(&observation(id, scene.frame))
    }

    /// Makes a request and waits for its answer.
    pub(crate) fn ask_and_wait(
        &mut self,
        id: RequestId,
        scene: &RequestScene,
    ) -> CheckResult<Decision> {
        self.ask(id, scene)?;
        self.notify()?;
        self.wait()?;
        self.answers.get(&id).copied().map_or_else(|| wrong("no answer"), Ok)
    }

    /// From now on, `id` has to be answered.
    pub(crate) fn expect(&mut self, id: RequestId) {
        self.requests.insert(id, RequestState::Open);
    }

    /// From now on, an answer to `id` is a mistake.
    pub(crate) fn expect_none(&mut self, id: RequestId) {
        self.requests.insert(id, RequestState::Impossible);
    }

    pub(crate) fn recall(&mut self, message: &Recall) -> CheckResult<()> {
        Ok(self.neighbours.send(message)?)
    }

    pub(crate) fn observe(&mut self, message: &Observation) -> CheckResult<()> {
        Ok(self.neighbours.observe(message)?)
    }

    pub(crate) fn notify(&self) -> CheckResult<()> {
        Ok(self.neighbours.notify()?)
    }

    /// Waits until every open request is answered.
    pub(crate) fn wait(&mut self) -> CheckResult<()> {
        let deadline = Instant::now() + self.terms.answer_timeout;
        loop {
            self.listen()?;
            let open = self.requests.iter().filter(|(_, state)| **state == RequestState::Open);
            let open: Vec<RequestId> = open.map(|(id, _)| *id).collect();
            if open.is_empty() {
                return Ok(());
            }
            if Instant::now() > deadline {
                return wrong(self.no_answer(&open));
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

    /// The policy's error reports since the last call.
    pub(crate) fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.errors)
    }

    /// Receives all waiting messages.
    fn listen(&mut self) -> CheckResult<()> {
        for decision in self.neighbours.decisions.drain()? {
            self.take(decision)?;
        }
        for report in self.neighbours.error_reports.drain()? {
            let text = read_text(&report.text, report.text_len).unwrap_or("(not UTF-8)");
            let kind = u8::try_from(report.kind).ok().map(ErrorReportKind::try_from);
            match kind {
                Some(Ok(ErrorReportKind::Message)) => self.errors.push(text.to_owned()),
                Some(Ok(ErrorReportKind::Waiting)) => {}
                Some(Ok(ErrorReportKind::Episode)) => {
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

    /// Takes a decision, which has to be the valid answer to an open request.
    fn take(&mut self, decision: Decision) -> CheckResult<()> {
        let Decision { lane, step, episode, outcome, action, .. } = decision;
        let lanes = self.neighbours.attach().lanes;
        if lane >= lanes {
            let last = lanes - 1;
            return wrong(format_args!(
                "a decision for lane {lane}, but the lanes are 0 to {last}"
            ));
        }
        let id = RequestId { lane, episode, step };
        match self.requests.get(&id) {
            Some(RequestState::Open) => {}
            Some(RequestState::Over) => return Ok(()),
            Some(RequestState::Answered) => {
                return wrong(format_args!("a second decision for step {step} of lane {lane}"));
            }
            Some(RequestState::Impossible) => {
                return wrong(format_args!(
                    "a decision for step {step} of lane {lane}, which could not be decided"
                ));
            }
            None => return wrong(self.unknown_request(id)),
        }
        let valid = match Outcome::try_from(outcome) {
            Ok(Outcome::Acted) => Action::try_from(action).map(drop),
            Ok(_) => Ok(()),
            Err(error) => Err(error),
        };
        if let Err(error) = valid {
            return wrong(format_args!(
                "the decision for step {step} of lane {lane} is invalid: {error}"
            ));
        }
        self.requests.insert(id, RequestState::Answered);
        self.answers.insert(id, decision);
        Ok(())
    }

    fn unknown_request(&self, RequestId { lane, episode, step }: RequestId) -> String {
        let of_episode = |id: &&RequestId| id.lane == lane && id.episode == episode;
        let last = self.requests.keys().rfind(of_episode);
        let last = last.map_or_else(
            || "the lane has no such episode".to_owned(),
            |id| format!("its last request is step {}", id.step),
        );
        format!(
            "a decision for step {step} of lane {lane}, episode {episode}, without a request: {last}"
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
