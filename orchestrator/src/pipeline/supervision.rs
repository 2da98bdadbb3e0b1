//! Watches a generation: exits, overdue answers, error reports, heartbeats.

use std::time::Duration;

use shm_types::message::{ErrorReportKind, Role, read_text};
use shm_types::process::{ProcessWatch, monotonic_ns};

use super::generation::{Generation, role};
use super::startup::{read_handshake, unexpected};
use super::{Failure, PipelineRun};
use crate::lanes::PendingAnswer;

impl Generation {
    /// Checks all processes. Returns why the run has to stop early, if a process says so.
    pub(super) fn supervise(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<String>, Failure> {
        let halted = self.read_error_reports(run)?;
        if halted.is_some() {
            return Ok(halted);
        }
        for heartbeat in self.inbox.heartbeats.drain()? {
            let Ok(role) = role(heartbeat.role) else { continue };
            // An encoder that hangs makes no progress.
            if role == Role::Memory && heartbeat.done > self.embedded {
                self.embedded = heartbeat.done;
                self.memory_busy_ns = monotonic_ns();
            }
            run.observer.heartbeat(role, &heartbeat);
        }
        if let Some(exit) = self.exited() {
            return Err(exit);
        }
        if let Some(handshake) = self.inbox.handshakes.drain()?.first() {
            let (role, _) = read_handshake(handshake)?;
            let why = unexpected(role);
            return Err(match role {
                Role::Policy => Failure::Policy(why),
                _ => Failure::Retry(why),
            });
        }
        self.check_overdue(run)?;
        Ok(None)
    }

    /// Gives up episodes, or the generation, whose answers are overdue.
    fn check_overdue(&self, run: &mut PipelineRun<'_, '_>) -> Result<(), Failure> {
        let now = monotonic_ns();
        let pending = run.lanes.pending(self.memory_busy_ns);
        run.observer.pending(&pending);
        for PendingAnswer { role, lane, since_ns, unusable, .. } in pending {
            let timeout = match role {
                Role::Policy => run.options.decision_timeout,
                _ => Some(run.options.answer_timeout),
            };
            let waited = Duration::from_nanos(now.saturating_sub(since_ns));
            if timeout.is_none_or(|timeout| waited <= timeout) {
                continue;
            }
            let (role_name, seconds) = (role.word(), waited.as_secs());
            let overdue = format!(
                "the {role_name} process has not answered for {seconds} s (--step-timeout)"
            );
            if role != Role::Policy {
                return Err(Failure::Retry(format!("{overdue} and seems to hang")));
            }
            // A policy that meanwhile answered other episodes, or this one with something unusable, is alive: only
            // this episode is given up. A later answer to it is ignored.
            if self.decided_ns <= since_ns && unusable == 0 {
                return Err(Failure::Policy(format!("{overdue} and seems to hang")));
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

    /// Handles error reports. Returns why the run has to stop early, if one says so.
    fn read_error_reports(&self, run: &mut PipelineRun<'_, '_>) -> Result<Option<String>, Failure> {
        let mut halted = None;
        for report in self.inbox.error_reports.drain()? {
            let sender = role(report.role).map_or("an unknown process", Role::word);
            let text = read_text(&report.text, report.text_len).unwrap_or("an unreadable message");
            let what = format!("{sender}: {text}");
            match u8::try_from(report.kind).map(ErrorReportKind::try_from) {
                Ok(Ok(ErrorReportKind::Episode)) => {
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
                Ok(Ok(ErrorReportKind::Message)) | Ok(Err(_)) | Err(_) => {
                    run.observer.problem(&what);
                }
            }
        }
        Ok(halted)
    }

    /// The failure that a process's exit means, if one has exited.
    pub(super) fn exited(&mut self) -> Option<Failure> {
        if self.external_policy.as_ref().is_some_and(ProcessWatch::has_ended) {
            return Some(Failure::Policy("the external policy has exited".to_owned()));
        }
        let exit = self.children.exited()?;
        let why = exit.to_string();
        Some(if exit.role == Role::Policy { Failure::Policy(why) } else { Failure::Retry(why) })
    }
}
