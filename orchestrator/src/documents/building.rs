//! Builds documents: starts a simulator and a memory process and follows their progress.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bytemuck::Zeroable;
use shm_types::message::{ErrorReport, Heartbeat, Role, ShutdownReport, Stop, read_text};
use shm_types::process::check_shared_memory;
use shm_types::{Attach, Bus, FrameSize, HandshakeReceiver, Receiver, RunDir, registry};

use documents::{DocumentFolder, DocumentName, Recipe};

use super::{BuildStage, DocumentRequest};
use crate::launch::SHUTDOWN_TIMEOUT;
use supervise::{Children, Launch};

/// Views that are rendered before they are read.
const VIEWS_AHEAD: u32 = 64;

/// How often processes and signals are checked.
const TICK: Duration = Duration::from_millis(50);

/// Builds documents in `folder`. Returns false when stopped.
///
/// # Errors
/// When the processes cannot be started, or one of them fails.
pub(super) fn build(
    request: &DocumentRequest,
    recipe: &Recipe,
    folder: &DocumentFolder,
    names: &[DocumentName],
    stop: &AtomicBool,
    report: &mut dyn FnMut(BuildStage),
) -> Result<bool> {
    let base = registry::default_base();
    registry::clean(&base)?;
    let run = RunDir::create(&base)?;
    let mut attach = Attach {
        participants: vec![Role::Sim, Role::Memory],
        window: 0,
        frame: FrameSize { width: request.frame_size, height: request.frame_size },
        ..run.attach()
    };
    // An idle lane may pin two views.
    attach.frame_capacity = VIEWS_AHEAD + 2 * attach.lanes;
    check_shared_memory(attach.shared_memory_bytes())?;
    attach.write(&attach.root)?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let (handshakes, heartbeats) = (bus.handshake_receiver()?, bus.receiver()?);
    let (error_reports, shutdown_reports) = (bus.receiver()?, bus.receiver()?);
    report(BuildStage::Starting);
    let launches = launches(request, recipe, folder.path(), names, run.path())?;
    let children = Children::start(&launches, &folder.path().join("logs"))?;
    let build = Build {
        children,
        handshakes,
        heartbeats,
        error_reports,
        shutdown_reports,
        bus: &bus,
        last_report: None,
    };
    build.run(stop, report)
}

fn launches(
    request: &DocumentRequest,
    recipe: &Recipe,
    folder: &Path,
    names: &[DocumentName],
    root: &Path,
) -> Result<Vec<Launch>> {
    let elsewhere = match &request.elsewhere {
        None => None,
        Some(elsewhere) => {
            let file = root.join("elsewhere.json");
            std::fs::write(&file, elsewhere)
                .with_context(|| format!("cannot write {}", file.display()))?;
            Some(file)
        }
    };
    let launch = |role, program| {
        let verb = if role == Role::Sim { "serve" } else { "build" };
        let mut args = vec![verb.into(), "--attach".into(), root.into()];
        if let Some(assets) = &request.assets {
            args.extend(["--assets".into(), assets.into()]);
        }
        if let Some(file) = &elsewhere {
            args.extend(["--elsewhere".into(), file.into()]);
        }
        for (flag, value) in request.appearance.flags() {
            args.extend([flag.into(), value.into()]);
        }
        Launch::sibling(role, program, args)
    };
    let sim = launch(Role::Sim, "sim-proc")?;
    let mut memory = launch(Role::Memory, "memory-proc")?;
    memory.args.extend(["--documents".into(), folder.into()]);
    let names: Vec<String> = names.iter().map(DocumentName::to_string).collect();
    memory.args.extend(["--wanted".into(), names.join(",").into()]);
    Ok(vec![sim, memory.with_flags(request.builder_flags(recipe))])
}

/// A build that is running. Fields are dropped in order: processes end before the services that they use.
struct Build<'a> {
    children: Children,
    handshakes: HandshakeReceiver,
    heartbeats: Receiver<Heartbeat>,
    error_reports: Receiver<ErrorReport>,
    shutdown_reports: Receiver<ShutdownReport>,
    bus: &'a Bus,
    /// The last reported stage.
    last_report: Option<BuildStage>,
}

impl Build<'_> {
    fn run(mut self, stop: &AtomicBool, report: &mut dyn FnMut(BuildStage)) -> Result<bool> {
        let mut error = None;
        loop {
            self.bus.listener().wait(TICK)?;
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            self.handshakes.drain()?;
            for heartbeat in self.heartbeats.drain()? {
                if heartbeat.role == Role::Memory as u32 {
                    self.report(heartbeat, report);
                }
            }
            for report in self.error_reports.drain()? {
                error = read_text(&report.text, report.text_len).ok().map(str::to_owned);
            }
            let reports = self.shutdown_reports.drain()?;
            if reports.iter().any(|report| report.role == Role::Memory as u32) {
                self.finish()?;
                return Ok(true);
            }
            if let Some(exit) = self.children.exited() {
                let error = error.map(|text| format!("{text}; ")).unwrap_or_default();
                bail!("{error}{exit}");
            }
        }
    }

    /// Reports progress: of views until all are read, then of parts of documents.
    fn report(&mut self, heartbeat: Heartbeat, report: &mut dyn FnMut(BuildStage)) {
        let (done, total) = (heartbeat.done, heartbeat.done.saturating_add(heartbeat.waiting));
        let all_read = match self.last_report {
            Some(BuildStage::Writing(..)) => true,
            Some(BuildStage::Views(done, total)) => done == total,
            _ => false,
        };
        let stage = if all_read {
            BuildStage::Writing(done, total)
        } else {
            BuildStage::Views(done, total)
        };
        self.last_report = Some(stage);
        report(stage);
    }

    fn finish(self) -> Result<()> {
        self.bus.sender()?.send(&Stop::zeroed())?;
        for role in [Role::Sim, Role::Memory] {
            self.bus.notifier(role)?.notify()?;
        }
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while Instant::now() < deadline && self.shutdown_reports.drain()?.is_empty() {
            self.bus.listener().wait(TICK)?;
        }
        self.children.wait_or_kill(SHUTDOWN_TIMEOUT);
        Ok(())
    }
}
