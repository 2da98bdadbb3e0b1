//! Watches a generation: exits, overdue answers, error reports, heartbeats.

use std::time::Duration;

use domain::MemoryKind;
use shm_types::message::{ErrorReport, ErrorReportKind, Role, read_text};
use shm_types::process::monotonic_ns;

use super::generation::{Generation, POLICY_LEFT, role};
use super::startup::{is_started_by_user, of_unknown_sender, read_handshake, unexpected};
use super::{Failure, MEMORY_BUILD_TIMEOUT, Participant, PipelineOptions, PipelineRun};
use crate::lanes::PendingAnswer;

impl Generation {
    /// Checks all processes. Returns why the run has to stop early, if a process says so.
    pub(super) fn supervise(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<String>, Failure> {
        // What others report follows from its leaving.
        let error_reports = self.inbox.error_reports.drain()?;
        if let Some(left) = self.left(run.options) {
            return Err(left);
        }
        let halted = self.read_error_reports(error_reports, run)?;
        if halted.is_some() {
            return Ok(halted);
        }
        for heartbeat in self.inbox.heartbeats.drain()? {
            let Ok(role) = role(heartbeat.role) else { continue };
            let Some(sender) = run.options.participant(role, heartbeat.index) else { continue };
            self.vital_signs.heard(sender, &heartbeat, monotonic_ns());
            run.observer.heartbeat(sender, &heartbeat);
        }
        if let Some(exit) = self.exited(run.options) {
            return Err(exit);
        }
        for handshake in self.inbox.handshakes.drain()? {
            let read = read_handshake(&handshake, run.options).map_err(|failure| match failure {
                // It cannot be a process that the run waited for: these have been read.
                Failure::Fatal(error) => Failure::Retry(format!("{error:#}")),
                other => other,
            });
            let Some((sender, _)) = read? else {
                run.observer.problem(&of_unknown_sender(&handshake));
                continue;
            };
            return Err(Failure::of(sender, run.options, unexpected(sender)));
        }
        self.check_overdue(run)?;
        Ok(None)
    }

    /// Gives up episodes, or the generation, whose answers are overdue.
    fn check_overdue(&self, run: &mut PipelineRun<'_, '_>) -> Result<(), Failure> {
        let now = monotonic_ns();
        // An encoder that hangs makes no progress.
        let pending = run.lanes.pending(self.vital_signs.memory_busy_ns());
        let awaited: Vec<Participant> = pending.iter().map(|answer| self.awaited(answer)).collect();
        run.observer.pending(&awaited);
        for (answer, process) in pending.into_iter().zip(awaited) {
            let PendingAnswer { role, lane, memory, since_ns, unusable } = answer;
            let timeout = match role {
                Role::Policy => run.options.decision_timeout,
                // The memory process has time limits for external memories, and gives up their episodes.
                Role::Memory if memory.external().is_some() => {
                    let own = run.options.memory_timeout.max(MEMORY_BUILD_TIMEOUT);
                    Some(run.options.answer_timeout + own)
                }
                _ => Some(run.options.answer_timeout),
            };
            let waited = Duration::from_nanos(now.saturating_sub(since_ns));
            if timeout.is_none_or(|timeout| waited <= timeout) {
                continue;
            }
            if role == Role::Memory
                && let Some((world, why)) = self.vital_signs.simulator_hangs(since_ns, now)
            {
                return Err(Failure::of(world, run.options, why));
            }
            // The memory process answers for an external memory, too.
            let process = if process.memory.is_some() { role.into() } else { process };
            let (name, seconds) = (process.in_words(), waited.as_secs());
            let overdue = format!("{name} has not answered for {seconds} s (--step-timeout)");
            // A policy that meanwhile answered other episodes, or this one with something unusable, is alive: only
            // this episode is given up. A later answer to it is ignored.
            if role != Role::Policy || (self.decided_ns <= since_ns && unusable == 0) {
                let why = match role {
                    Role::Policy if self.has_policy_left() => POLICY_LEFT.to_owned(),
                    _ => format!("{overdue} and seems to hang"),
                };
                return Err(Failure::of(process, run.options, why));
            }
            let Some(episode) = run.lanes.give_up(lane) else { continue };
            let why = match unusable {
                0 => format!("{overdue}, but answered other episodes meanwhile"),
                _ => format!("{overdue}, after {unusable} answers that could not be used"),
            };
            run.observer.problem(&format!("{}: {why}", episode.key));
            run.queue.spoiled(episode, &why);
        }
        Ok(())
    }

    /// The process that an answer is awaited from.
    fn awaited(&self, answer: &PendingAnswer) -> Participant {
        match (answer.role, answer.memory) {
            (Role::Sim, _) => Participant::world(self.bus.attach().world_of(answer.lane)),
            (Role::Memory, MemoryKind::External(name)) => name.into(),
            (role, _) => role.into(),
        }
    }

    /// Handles error reports. Returns why the run has to stop early, if one says so.
    fn read_error_reports(
        &self,
        reports: Vec<ErrorReport>,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<String>, Failure> {
        let mut halted = None;
        for report in reports {
            let role = role(report.role).ok();
            let sender = role.and_then(|role| run.options.participant(role, report.index));
            let text = read_text(&report.text, report.text_len).unwrap_or("an unreadable message");
            let what = match sender {
                Some(sender) => format!("{sender}: {text}"),
                None => format!("an unknown process: {text}"),
            };
            let kind = u8::try_from(report.kind).map(ErrorReportKind::try_from);
            if let Some(name) = sender.and_then(|sender| sender.memory) {
                // It has a say about its own episodes only.
                let own = run.lanes.memory_of(report.lane, report.episode) == Some(name.into());
                if !own || kind != Ok(Ok(ErrorReportKind::Episode)) {
                    run.observer.problem(&what);
                    continue;
                }
            }
            match kind {
                Ok(Ok(kind @ (ErrorReportKind::Episode | ErrorReportKind::Overdue))) => {
                    // Other failures, however late, are answers.
                    if kind == ErrorReportKind::Overdue {
                        self.check_silence(run, &report, &what)?;
                    }
                    // `None`: the episode is over already.
                    let episode = run.lanes.give_up_episode(report.lane, report.episode);
                    let Some(episode) = episode else { continue };
                    run.observer.problem(&format!("{}: {what}", episode.key));
                    run.queue.give_up(episode, what);
                }
                Ok(Ok(ErrorReportKind::Run)) => halted = Some(what),
                Ok(Ok(ErrorReportKind::Waiting)) => {
                    let reason = Some(text).filter(|text| !text.is_empty());
                    run.observer.waiting_for_server(reason);
                }
                Ok(Ok(ErrorReportKind::Facts)) => match (sender, serde_json::from_str(text)) {
                    (Some(sender), Ok(facts)) => run.observer.learned(sender, &facts)?,
                    _ => run.observer.problem(&what),
                },
                Ok(Ok(ErrorReportKind::Message)) | Ok(Err(_)) | Err(_) => {
                    run.observer.problem(&what);
                }
            }
        }
        Ok(halted)
    }

    /// Records the facts that have arrived since the last look. What else a process reports concerns episodes that are over.
    pub(super) fn read_last_facts(&self, run: &mut PipelineRun<'_, '_>) -> Result<(), Failure> {
        for report in self.inbox.error_reports.drain()? {
            let role = role(report.role).ok();
            let sender = role.and_then(|role| run.options.participant(role, report.index));
            if report.kind == ErrorReportKind::Facts as u32
                && let Some(sender) = sender.filter(|sender| sender.memory.is_none())
                && let Ok(text) = read_text(&report.text, report.text_len)
                && let Ok(facts) = serde_json::from_str(text)
            {
                run.observer.learned(sender, &facts)?;
            }
        }
        Ok(())
    }

    /// Fails if the episode with an overdue answer waited for the simulator, or for an external memory that has not answered
    /// anything for as long as it has time: then that process hangs, and its other episodes would end the same way.
    fn check_silence(
        &self,
        run: &PipelineRun<'_, '_>,
        report: &ErrorReport,
        what: &str,
    ) -> Result<(), Failure> {
        let Some(MemoryKind::External(name)) = run.lanes.memory_of(report.lane, report.episode)
        else {
            return Ok(());
        };
        let pending = run.lanes.pending(0);
        let Some(waits) = pending.iter().find(|answer| answer.lane == report.lane) else {
            return Ok(());
        };
        let last_ns = self.recalled_ns.get(&name).copied().unwrap_or(0).max(waits.since_ns);
        let silence = Duration::from_nanos(monotonic_ns().saturating_sub(last_ns));
        if waits.role != Role::Memory {
            return Ok(());
        }
        if let Some((world, why)) = self.vital_signs.simulator_is_silent(monotonic_ns()) {
            return Err(Failure::of(world, run.options, why));
        }
        if silence < run.options.memory_timeout {
            return Ok(());
        }
        let seconds = silence.as_secs();
        let why = format!(
            "the external memory {name} has not answered anything for {seconds} s (--memory-timeout) and seems to \
             hang: {what}"
        );
        Err(Failure::of(name.into(), run.options, why))
    }

    /// The failure that a process's exit means, if one has exited.
    pub(super) fn exited(&mut self, options: &PipelineOptions) -> Option<Failure> {
        if let Some(&(sender, _)) = self.external.iter().find(|(_, watch)| watch.has_ended()) {
            let which = match sender.role {
                Role::Policy => "the external policy".to_owned(),
                _ => sender.in_words(),
            };
            return Some(Failure::of(sender, options, format!("{which} has exited")));
        }
        self.children.exited().map(|exit| Failure::of_exit(&exit, options))
    }

    /// The failure that it means if a process that the user started has sent its shutdown report without being asked to: the user
    /// has interrupted it.
    pub(super) fn left(&mut self, options: &PipelineOptions) -> Option<Failure> {
        // What cannot be received shows in other ways.
        for report in self.inbox.shutdown_reports.drain().unwrap_or_default() {
            let role = role(report.role).ok();
            let sender = role.and_then(|role| options.participant(role, report.index));
            self.shutdown_reports.extend(sender.map(|sender| (sender, report)));
        }
        let mut senders = self.shutdown_reports.keys();
        let left = senders.find(|&&sender| is_started_by_user(sender, options))?;
        Some(Failure::Left(format!("{} was interrupted, and has left the run", left.in_words())))
    }
}
