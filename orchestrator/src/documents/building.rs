//! A run of simulator and memory alone, in which documents are built.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use bytemuck::Zeroable;
use shm_types::message::{Complaint, Farewell, Hello, Pulse, Role, Stop, read_text};
use shm_types::process::check_shared_memory;
use shm_types::{Attach, Bus, FrameSize, Receiver, RunDir, registry};

use super::{DocumentName, Library, Stage, listed};
use supervise::{Crew, Launch};

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
        crew: vec![Role::Sim, Role::Memory],
        window: 0,
        frame: FrameSize { width: library.frame_size, height: library.frame_size },
        ..Attach::new(&run)
    };
    // An idle lane may pin two views.
    attach.frame_capacity = VIEWS_AHEAD + 2 * attach.lanes;
    check_shared_memory(&attach)?;
    attach.write(&attach.root)?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let inbox = Inbox::new(&bus)?;
    tell(Stage::Starting);
    let crew = Crew::start(&launches(library, folder, names, run.path())?, &folder.join("logs"))?;
    Building { crew, inbox, bus: &bus, told: None }.see_through(stop, tell)
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
    hellos: Receiver<Hello>,
    pulses: Receiver<Pulse>,
    complaints: Receiver<Complaint>,
    farewells: Receiver<Farewell>,
}

impl Inbox {
    fn new(bus: &Bus) -> Result<Self> {
        Ok(Self {
            hellos: bus.receiver()?,
            pulses: bus.receiver()?,
            complaints: bus.receiver()?,
            farewells: bus.receiver()?,
        })
    }
}

/// The fields are dropped in order: the processes are gone before the services they use.
struct Building<'a> {
    crew: Crew,
    inbox: Inbox,
    bus: &'a Bus,
    /// Stage that was told last: views come first.
    told: Option<Stage>,
}

impl Building<'_> {
    fn see_through(mut self, stop: &AtomicBool, tell: &mut dyn FnMut(Stage)) -> Result<bool> {
        let mut complaint = None;
        loop {
            self.bus.doorbell().wait(TICK)?;
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            self.inbox.hellos.drain()?;
            for pulse in self.inbox.pulses.drain()? {
                if pulse.role == Role::Memory as u32 {
                    self.tell(pulse, tell);
                }
            }
            for said in self.inbox.complaints.drain()? {
                complaint = read_text(&said.text, said.text_len).ok().map(str::to_owned);
            }
            let farewells = self.inbox.farewells.drain()?;
            if farewells.iter().any(|farewell| farewell.role == Role::Memory as u32) {
                self.finish()?;
                return Ok(true);
            }
            if let Some(death) = self.crew.death() {
                let complaint = complaint.map(|said| format!("{said}; ")).unwrap_or_default();
                bail!("{complaint}{death}");
            }
        }
    }

    /// Views are counted until none waits, then parts of documents.
    fn tell(&mut self, pulse: Pulse, tell: &mut dyn FnMut(Stage)) {
        let (done, total) = (pulse.done, pulse.done.saturating_add(pulse.waiting));
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
            self.bus.bell(role)?.ring()?;
        }
        // Nobody is asked for an account; that they end is enough.
        let deadline = Instant::now() + FAREWELL_PATIENCE;
        while Instant::now() < deadline && self.inbox.farewells.drain()?.is_empty() {
            self.bus.doorbell().wait(TICK)?;
        }
        self.crew.disband(FAREWELL_PATIENCE);
        Ok(())
    }
}
