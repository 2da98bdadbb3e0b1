//! One session of a run: what the [`pipeline`](crate::pipeline) finishes goes into the run folder, what
//! happens goes to stderr.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use domain::Outcome;
use shm_types::ATTACH_VARIABLE;
use shm_types::message::{Decision, Heartbeat, Role, ShutdownReport};
use shm_types::process::monotonic_ns;

use crate::budget::Budget;
use crate::lanes::{Owed, Spent, Stamps, Walked};
use crate::latency::Latency;
use crate::pipeline::{Ending, Facts, Observer};
use crate::progress::Progress;
use crate::status::StatusFile;
use crate::trace::Trace;
use results::log::{EpisodeError, EpisodeTimings, RequestRecord, RunFolder, SessionEvent};

/// Troubles that are said one by one; a process that talks rubbish does so often.
const TROUBLES_SAID: u32 = 20;

/// Keeps a run folder up to date, and a person.
#[derive(Debug)]
pub struct Session<'a> {
    folder: &'a mut RunFolder,
    progress: Progress,
    budget: Budget,
    lanes: u32,
    frame_budget: u32,
    began_ns: u64,
    generation: u32,
    troubles: u32,
    last_trouble: String,
    finished: u32,
    /// Episodes of the run that are done.
    done: u64,
    latency: Latency,
    status: StatusFile,
    trace: Option<Trace>,
}

impl<'a> Session<'a> {
    /// A session that writes to `folder`, and to `trace`, and keeps to `budget`, with so many lanes and frames.
    pub fn new(
        folder: &'a mut RunFolder,
        progress: Progress,
        budget: Budget,
        lanes: u32,
        frame_budget: u32,
        trace: Option<Trace>,
    ) -> Self {
        let episodes = u64::from(folder.manifest().episodes);
        let status = StatusFile::new(folder.dir(), lanes, episodes);
        Self {
            done: folder.count_finished(),
            latency: Latency::default(),
            status,
            trace,
            folder,
            progress,
            budget,
            lanes,
            frame_budget,
            began_ns: monotonic_ns(),
            generation: 0,
            troubles: 0,
            last_trouble: String::new(),
            finished: 0,
        }
    }

    /// Writes down how the session ended; `reason` is "complete", or why it stopped.
    ///
    /// # Errors
    /// When the run folder cannot be written to.
    pub fn end(mut self, outcome: &Result<Ending>, reason: &str) -> Result<()> {
        let session = self.folder.session();
        let mut errors = 0;
        let mut shutdown_reports = BTreeMap::new();
        if let Ok(ending) = outcome {
            for (episode, why) in &ending.unfinished {
                let (key, error) = (episode.key.to_string(), why.clone());
                self.folder.give_up(&EpisodeError { key, session, error })?;
                self.progress.errored();
                errors += 1;
            }
            shutdown_reports = ending
                .shutdown_reports
                .iter()
                .map(|(role, said)| said_about(*role, said))
                .collect();
        }
        if self.troubles > TROUBLES_SAID {
            let more = self.troubles - TROUBLES_SAID;
            self.progress.note(&format!("{more} more such messages were not shown"));
        }
        let session = self.folder.session();
        self.latency.records(session).try_for_each(|record| self.folder.measured(&record))?;
        self.progress.close();
        if let Some(trace) = self.trace {
            let path = trace.finish()?;
            eprintln!("trace: {} (open it with https://ui.perfetto.dev)", path.display());
        }
        let (finished, reason) = (self.finished, reason.to_owned());
        Ok(self.folder.note(SessionEvent::Ended {
            finished,
            errors,
            reason,
            farewells: shutdown_reports,
        })?)
    }
}

impl Observer for Session<'_> {
    fn starting(&mut self, generation: u32) {
        if generation > 1 {
            let (generation, reason) = (self.generation, self.last_trouble.clone());
            if let Err(error) = self.folder.note(SessionEvent::Failed { generation, reason }) {
                self.progress.note(&format!("{error}"));
            }
        }
        self.generation = generation;
        self.progress.phase("starting the processes");
    }

    fn awaiting(&mut self, folder: &Path) {
        if self.generation == 1 {
            self.progress.note(&format!(
                "start your policy with this, now or later:\n  {ATTACH_VARIABLE}={} your-program",
                folder.display()
            ));
        }
        self.progress.phase("waiting for a policy to attach");
    }

    fn ready(&mut self, facts: &BTreeMap<Role, Facts>) -> Result<()> {
        let processes: BTreeMap<String, Facts> =
            facts.iter().map(|(role, facts)| (role.word().to_owned(), facts.clone())).collect();
        self.folder.note(SessionEvent::Ready {
            generation: self.generation,
            lanes: self.lanes,
            frame_budget: self.frame_budget,
            processes: processes.clone(),
        })?;
        for change in self.folder.introduce(processes)? {
            self.progress.note(&change);
        }
        let remembers = facts.contains_key(&Role::Memory);
        self.progress.phase(if remembers {
            "looking at the demonstrations"
        } else {
            "setting out"
        });
        Ok(())
    }

    fn spent(&mut self, spent: &Spent) -> Result<Option<String>> {
        let session = self.folder.session();
        let request = request_record(spent.key.clone(), session, &spent.decision);
        self.folder.asked(&request)?;
        self.budget.add(&request);
        Ok(self.budget.exceeded())
    }

    fn finished(&mut self, walked: &Walked, attempt: u32) -> Result<()> {
        let timings = EpisodeTimings {
            key: walked.record.key.clone(),
            session: self.folder.session(),
            generation: self.generation,
            ticket: walked.ticket,
            attempt,
            lane: walked.lane,
            started_ns: walked.started_ns.saturating_sub(self.began_ns),
            ended_ns: walked.ended_ns.saturating_sub(self.began_ns),
            steps: walked.record.steps,
            rubbish: walked.rubbish,
            stages: walked.stages,
        };
        self.folder.finish(&[(walked.record.clone(), timings)])?;
        self.finished += 1;
        self.done += 1;
        self.progress.finished(walked.record.is_success());
        Ok(())
    }

    fn stepped(&mut self, stamps: &Stamps) -> Result<()> {
        self.latency.record(stamps);
        self.status.stepped(stamps);
        self.trace.as_mut().map_or(Ok(()), |trace| trace.step(stamps))
    }

    fn heartbeat(&mut self, role: Role, heartbeat: &Heartbeat) {
        self.status.heartbeat(role, heartbeat);
    }

    fn waiting(&mut self, owed: &[Owed]) {
        self.status.waiting(owed);
        self.status.tick(self.done);
    }

    fn progress(&mut self, steps: u64) {
        self.progress.steps(steps);
        self.progress.tick();
    }

    fn trouble(&mut self, what: &str) {
        self.troubles += 1;
        if self.troubles <= TROUBLES_SAID {
            self.progress.note(what);
        }
        self.last_trouble = what.to_owned();
    }
}

fn said_about(role: Role, said: &ShutdownReport) -> (String, BTreeMap<String, u64>) {
    let counts = [
        ("frames_rendered", said.frames_rendered),
        ("frames_evicted", said.frames_evicted),
        ("frames_held", said.frames_received),
        ("pixel_bytes_copied", said.pixel_bytes_copied),
        ("complaints", said.error_reports),
    ];
    let counts = counts.into_iter().map(|(what, count)| (what.to_owned(), count));
    (role.word().to_owned(), counts.collect())
}

/// The record of the request that `decision` reports.
fn request_record(key: String, session: u32, decision: &Decision) -> RequestRecord {
    let counts = decision.counts();
    let latency_ns = decision.decided_ns.saturating_sub(decision.sent_ns);
    RequestRecord {
        key,
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
    }
}
