//! One session of a run: records what the [`pipeline`](crate::pipeline) finishes in the run folder, and passes events
//! to the monitor.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Result;
use domain::{ExternalName, Outcome, Reasoning};
use run_log::{EpisodeError, EpisodeTimings, RequestRecord, RunFolder, SessionEvent};
use shm_types::message::{Heartbeat, Role, ShutdownReport, read_text};
use shm_types::process::monotonic_ns;

use crate::answers::{AnswerNotice, AnswerWatch};
use crate::budget::Budget;
use crate::lanes::{AnsweredRequest, FinishedEpisode, Stamps};
use crate::machine::Machine;
use crate::monitor::Monitor;
use crate::pipeline::{Ending, Facts, MemoryState, Observer, Participant};
use crate::progress::say;
use crate::trace::RunTrace;

/// Problems that are printed one by one; a process that sends invalid messages may do so often.
const PROBLEMS_PRINTED: u32 = 20;

/// Records a session in the run folder and shows it.
#[derive(Debug)]
pub(crate) struct RunSession<'a> {
    folder: &'a mut RunFolder,
    monitor: Monitor,
    budget: Budget,
    answers: AnswerWatch,
    trace: Option<RunTrace>,
    lanes: u32,
    frame_budget: u32,
    began_ns: u64,
    generation: u32,
    problems: u32,
    last_problem: String,
    finished: u32,
    /// What was told of servers that do otherwise than asked.
    told: BTreeSet<String>,
}

/// Words of a learned fact that says what a server does otherwise than asked.
const OTHERWISE: [&str; 2] = ["the server ", "although "];

impl<'a> RunSession<'a> {
    /// A session that is recorded in `folder`, with so many lanes and frames.
    pub(crate) fn new(
        folder: &'a mut RunFolder,
        monitor: Monitor,
        budget: Budget,
        trace: Option<RunTrace>,
        (lanes, frame_budget): (u32, u32),
    ) -> Self {
        let answers = AnswerWatch::new(folder.manifest().settings.model.as_ref());
        Self {
            folder,
            monitor,
            budget,
            answers,
            trace,
            lanes,
            frame_budget,
            began_ns: monotonic_ns(),
            generation: 0,
            problems: 0,
            last_problem: String::new(),
            finished: 0,
            told: BTreeSet::new(),
        }
    }

    /// Records how the session ended; `reason` is "complete", or why it stopped.
    ///
    /// # Errors
    /// When the run folder or the trace cannot be written.
    pub(crate) fn end(mut self, outcome: &Result<Ending>, reason: &str) -> Result<()> {
        let session = self.folder.session();
        let mut errors = 0;
        let mut shutdown_reports = BTreeMap::new();
        if let Ok(ending) = outcome {
            for (episode, why) in &ending.unfinished {
                let (key, error) = (episode.key.to_string(), why.clone());
                self.folder.give_up(&EpisodeError { key, session, error })?;
                self.monitor.gave_up();
                errors += 1;
            }
            let reports = ending.shutdown_reports.iter();
            shutdown_reports = reports.map(|(sender, report)| counts_of(*sender, report)).collect();
        }
        if let Some(more) = self.problems.checked_sub(PROBLEMS_PRINTED).filter(|more| *more > 0) {
            self.monitor.note(&format!("{more} more such messages were not printed"));
        }
        let latency = self.monitor.close();
        latency.records(session).try_for_each(|record| self.folder.measured(&record))?;
        if let Some(trace) = self.trace {
            let path = trace.finish()?;
            say(&format!("trace: {} (open it with https://ui.perfetto.dev)", path.display()));
        }
        let (finished, reason) = (self.finished, reason.to_owned());
        Ok(self.folder.note(SessionEvent::Ended { finished, errors, reason, shutdown_reports })?)
    }
}

impl Observer for RunSession<'_> {
    fn starting(&mut self, generation: u32) {
        if generation > 1 {
            let (generation, reason) = (self.generation, self.last_problem.clone());
            if let Err(error) = self.folder.note(SessionEvent::Failed { generation, reason }) {
                self.monitor.note(&error.to_string());
            }
        }
        self.generation = generation;
        self.monitor.phase("starting the processes");
    }

    fn awaiting(&mut self, process: Participant, command: &str) {
        let what = match (process.role, process.memory) {
            (_, Some(name)) => format!("the memory {name}"),
            (Role::Sim, None) => "a world".to_owned(),
            (_, None) => format!("a {}", process.role.word()),
        };
        self.monitor.phase(&format!("waiting for {what} to attach"));
        if self.generation > 1 {
            // It may have joined this generation by itself, or have ended.
            self.monitor
                .note(&format!("Waiting for {what} to attach: start it again if it has ended"));
        } else if let Some(yours) = what.strip_prefix("a ") {
            // A memory was started before the run.
            self.monitor.note(&format!("Start your {yours}, now or later:\n  {command}"));
        }
    }

    fn memory_state(&mut self, name: ExternalName, state: &MemoryState) -> Result<()> {
        self.monitor.memory_state(name, state);
        if let MemoryState::Excluded(reason) = state {
            let (memory, reason) = (name, reason.clone());
            self.folder.note(SessionEvent::Excluded { memory, reason })?;
        }
        Ok(())
    }

    fn ready(&mut self, facts: &BTreeMap<Participant, Facts>) -> Result<()> {
        let mut processes: BTreeMap<String, Facts> =
            facts.iter().map(|(sender, facts)| (sender.to_string(), facts.clone())).collect();
        // Pixels and embeddings may depend on it in the last bits.
        let processor = Machine::here().processor_and_flags();
        processes.insert("machine".to_owned(), Facts::from([("processor".to_owned(), processor)]));
        for name in facts.keys().filter_map(|sender| sender.memory) {
            self.monitor.memory_state(name, &MemoryState::Ready);
        }
        self.folder.note(SessionEvent::Ready {
            generation: self.generation,
            lanes: self.lanes,
            frame_budget: self.frame_budget,
            processes: processes.clone(),
        })?;
        for change in self.folder.introduce(processes)? {
            self.monitor.note(&change);
        }
        let has_memory = facts.contains_key(&Role::Memory.into());
        self.monitor.phase(if has_memory {
            "preparing memories"
        } else {
            "taking the first steps"
        });
        Ok(())
    }

    fn learned(&mut self, sender: Participant, facts: &Facts) -> Result<()> {
        for change in self.folder.learn(&sender.to_string(), facts)? {
            self.monitor.note(&change);
        }
        for (fact, value) in facts {
            let note = format!("{sender}: {fact}: {value}");
            if OTHERWISE.iter().any(|words| value.contains(words)) && self.told.insert(note.clone())
            {
                self.monitor.note(&note);
            }
        }
        Ok(())
    }

    fn answered(&mut self, request: &AnsweredRequest) -> Result<Option<String>> {
        let record = request_record(request, self.folder.session());
        self.folder.asked(&record)?;
        self.budget.add(&record);
        let without_action = match self.answers.add(&record) {
            Some(AnswerNotice::Warning(warning)) => {
                self.monitor.note(&warning);
                None
            }
            Some(AnswerNotice::Stop(why)) => Some(why),
            None => None,
        };
        Ok(self.budget.exceeded().or(without_action))
    }

    fn finished(&mut self, finished: &FinishedEpisode, attempt: u32) -> Result<()> {
        let timings = EpisodeTimings {
            key: finished.record.key.clone(),
            session: self.folder.session(),
            generation: self.generation,
            episode: finished.id,
            attempt,
            lane: finished.lane,
            started_ns: finished.started_ns.saturating_sub(self.began_ns),
            ended_ns: finished.ended_ns.saturating_sub(self.began_ns),
            steps: finished.record.steps,
            invalid_messages: finished.unusable,
            stages: finished.stages,
            recalls: finished.recalls,
        };
        self.folder.finish(&[(finished.record.clone(), timings)])?;
        self.finished += 1;
        self.monitor.finished(finished.record.is_success());
        Ok(())
    }

    fn stepped(&mut self, stamps: &Stamps) -> Result<()> {
        self.monitor.stepped(stamps);
        self.trace.as_mut().map_or(Ok(()), |trace| trace.step(stamps))
    }

    fn heartbeat(&mut self, sender: Participant, heartbeat: &Heartbeat) {
        self.monitor.heartbeat(sender, heartbeat);
    }

    fn waiting_for_server(&mut self, reason: Option<&str>) {
        self.monitor.waiting_for_server(reason);
    }

    fn pending(&mut self, awaited: &[Participant]) {
        self.monitor.pending(awaited);
    }

    fn progress(&mut self, _steps: u64) {
        self.monitor.tick();
    }

    fn problem(&mut self, what: &str) {
        self.problems += 1;
        if self.problems <= PROBLEMS_PRINTED {
            self.monitor.note(what);
        }
        what.clone_into(&mut self.last_problem);
    }
}

/// A shutdown report as the run folder stores it.
fn counts_of(sender: Participant, report: &ShutdownReport) -> (String, BTreeMap<String, u64>) {
    let counts = [
        ("frames_rendered", report.frames_rendered),
        ("frames_evicted", report.frames_evicted),
        ("frames_received", report.frames_received),
        ("pixel_bytes_copied", report.pixel_bytes_copied),
        ("error_reports", report.error_reports),
    ];
    let counts = counts.into_iter().map(|(what, count)| (what.to_owned(), count));
    (sender.to_string(), counts.collect())
}

/// The record of a request to a model. A policy may leave any figure unmeasured.
fn request_record(request: &AnsweredRequest, session: u32) -> RequestRecord {
    let AnsweredRequest { key, decision } = request;
    let counts = decision.counts();
    let latency_ns = decision.decided_ns.saturating_sub(decision.sent_ns);
    let text = |bytes: &[u8], len: u8| {
        let text = read_text(bytes, len.into()).ok()?;
        Some(text.to_owned()).filter(|text| !text.is_empty())
    };
    RequestRecord {
        key: key.clone(),
        step: decision.step,
        session,
        // Decisions with an invalid outcome are dropped before.
        outcome: Outcome::try_from(decision.outcome).unwrap_or(Outcome::Unreadable),
        attempts: counts.attempts,
        replayed: decision.replayed != 0,
        latency_us: (decision.sent_ns > 0).then_some(latency_ns / 1000),
        images_asked: counts.images_asked,
        images: counts.images,
        prompt_tokens: counts.prompt_tokens,
        completion_tokens: counts.completion_tokens,
        cached_tokens: counts.cached_tokens,
        image_tokens: counts.image_tokens,
        memory_tokens: counts.memory_tokens,
        reusable_tokens: counts.reusable_tokens,
        finish_reason: text(&decision.finish_reason, decision.finish_reason_len),
        reasoned: match Reasoning::try_from(decision.reasoning) {
            Ok(Reasoning::Off) => Some(false),
            Ok(Reasoning::On) => Some(true),
            Ok(Reasoning::Unknown) | Err(_) => None,
        },
        model: text(&decision.model, decision.model_len),
    }
}
