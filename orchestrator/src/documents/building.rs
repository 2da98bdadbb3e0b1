//! A run of simulator and memory alone, in which documents are built.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use bytemuck::Zeroable;
use shm_types::message::{
    ErrorReport, Handshake, Heartbeat, Role, ShutdownReport, Stop, read_text,
};
use shm_types::process::check_shared_memory;
use shm_types::{Attach, Bus, FrameSize, Receiver, RunDir, registry};

use super::{DocumentName, Library, Stage, listed};
use supervise::{Children, Launch};

/// Views that are rendered ahead of being read.
const VIEWS_AHEAD: u32 = 64;

/// How often the loop looks after processes and signals when nobody rings.
const TICK: Duration = Duration::from_millis(50);

/// How long processes may take to finish once they are told to.
const FAREWELL_PATIENCE: Duration = Duration::from_secs(5);

/// Has `names` built in `folder`. Says whether that was done, and not broken off by `stop`.
///
/// # Errors
/// When the processes cannot be started, or one of them fails.
pub(super) fn build(
    library: &Library,
    folder: &Path,
    names: &[DocumentName],
    stop: &AtomicBool,
    tell: &mut dyn FnMut(Stage),
) -> Result<bool> {
    let base = registry::default_base();
    registry::clean(&base)?;
    let run = RunDir::create(&base)?;
    let mut attach = Attach {
        participants: vec![Role::Sim, Role::Memory],
        window: 0,
        frame: FrameSize { width: library.frame_size, height: library.frame_size },
        ..run.attach()
    };
    // An idle lane may pin two views.
    attach.frame_capacity = VIEWS_AHEAD + 2 * attach.lanes;
    check_shared_memory(attach.shared_memory_bytes())?;
    attach.write(&attach.root)?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let inbox = Inbox::new(&bus)?;
    tell(Stage::Starting);
    let children =
        Children::start(&launches(library, folder, names, run.path())?, &folder.join("logs"))?;
    Building { children, inbox, bus: &bus, told: None }.see_through(stop, tell)
}

fn launches(
    library: &Library,
    folder: &Path,
    names: &[DocumentName],
    root: &Path,
) -> Result<Vec<Launch>> {
    let launch = |role, program| {
        let verb = if role == Role::Sim { "serve" } else { "build" };
        let mut args = vec![verb.into(), "--attach".into(), root.into()];
        if let Some(assets) = &library.assets {
            args.extend(["--assets".into(), assets.into()]);
        }
        Launch::sibling(role, program, args)
    };
    let sim = launch(Role::Sim, "sim-proc")?;
    let mut memory = launch(Role::Memory, "memory-proc")?;
    memory.args.extend(["--documents".into(), folder.into()]);
    memory.args.extend(["--wanted".into(), listed(names).into()]);
    memory.args.extend(library.builder.arguments());
    Ok(vec![sim, memory])
}

/// Everything that arrives.
struct Inbox {
    handshakes: Receiver<Handshake>,
    heartbeats: Receiver<Heartbeat>,
    error_reports: Receiver<ErrorReport>,
    shutdown_reports: Receiver<ShutdownReport>,
}

impl Inbox {
    fn new(bus: &Bus) -> Result<Self> {
        Ok(Self {
            handshakes: bus.receiver()?,
            heartbeats: bus.receiver()?,
            error_reports: bus.receiver()?,
            shutdown_reports: bus.receiver()?,
        })
    }
}

/// The fields are dropped in order: the processes are gone before the services they use.
struct Building<'a> {
    children: Children,
    inbox: Inbox,
    bus: &'a Bus,
    /// Stage that was told last: views come first.
    told: Option<Stage>,
}

impl Building<'_> {
    fn see_through(mut self, stop: &AtomicBool, tell: &mut dyn FnMut(Stage)) -> Result<bool> {
        let mut error_report = None;
        loop {
            self.bus.listener().wait(TICK)?;
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            self.inbox.handshakes.drain()?;
            for heartbeat in self.inbox.heartbeats.drain()? {
                if heartbeat.role == Role::Memory as u32 {
                    self.tell(heartbeat, tell);
                }
            }
            for said in self.inbox.error_reports.drain()? {
                error_report = read_text(&said.text, said.text_len).ok().map(str::to_owned);
            }
            let shutdown_reports = self.inbox.shutdown_reports.drain()?;
            if shutdown_reports
                .iter()
                .any(|shutdown_report| shutdown_report.role == Role::Memory as u32)
            {
                self.finish()?;
                return Ok(true);
            }
            if let Some(death) = self.children.exited() {
                let error_report = error_report.map(|said| format!("{said}; ")).unwrap_or_default();
                bail!("{error_report}{death}");
            }
        }
    }

    /// Views are counted until none waits, then parts of documents.
    fn tell(&mut self, heartbeat: Heartbeat, tell: &mut dyn FnMut(Stage)) {
        let (done, total) = (heartbeat.done, heartbeat.done.saturating_add(heartbeat.waiting));
        let all_seen = match self.told {
            Some(Stage::Writing(..)) => true,
            Some(Stage::Views(done, total)) => done == total,
            _ => false,
        };
        let stage = if all_seen { Stage::Writing(done, total) } else { Stage::Views(done, total) };
        self.told = Some(stage);
        tell(stage);
    }

    fn finish(self) -> Result<()> {
        self.bus.sender()?.send(&Stop::zeroed())?;
        for role in [Role::Sim, Role::Memory] {
            self.bus.notifier(role)?.notify()?;
        }
        // Nobody is asked for an account; that they end is enough.
        let deadline = Instant::now() + FAREWELL_PATIENCE;
        while Instant::now() < deadline && self.inbox.shutdown_reports.drain()?.is_empty() {
            self.bus.listener().wait(TICK)?;
        }
        self.children.wait_or_kill(FAREWELL_PATIENCE);
        Ok(())
    }
}
