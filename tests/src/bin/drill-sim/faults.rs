//! The faults of a trial, drawn from its seed.

use durable::Operation;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use shm_types::message::Role;

/// Faults of one trial, at most.
const MOST_FAULTS: u64 = 6;

/// The stream of the generator that faults are drawn from; the scheduler draws from another.
const STREAM: u64 = 1;

/// A process of the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Process {
    Orchestrator,
    Child(Role),
}

/// A fault and its moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fault {
    /// After so many points of the scheduler; for one of the disk, operations on files.
    pub(crate) at: u64,
    pub(crate) trouble: Trouble,
}

/// What happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trouble {
    /// A process dies.
    Death(Process),
    /// A process does nothing for so many milliseconds.
    Stall(Process, u64),
    /// The clock jumps forward by so many milliseconds.
    Jump(u64),
    /// An operation on a file goes wrong.
    Disk(Damage),
    /// A message that is about to be sent finds its queue full.
    FullQueue,
    /// All processes die, and the last lines of journals are lost or torn.
    PowerLoss,
}

/// What goes wrong with an operation on a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Damage {
    /// The disk is full in the middle of a write.
    Full,
    /// The system reports an input/output error.
    Broken,
    /// The process dies in the middle of a write.
    TornByDeath,
    /// A read returns few bytes at a time.
    ShortReads,
}

impl Damage {
    pub(crate) fn concerns(self, operation: Operation) -> bool {
        match (self, operation) {
            (Self::Full | Self::TornByDeath, Operation::Write(_)) => true,
            (Self::ShortReads, Operation::Read) | (Self::Broken, _) => true,
            (Self::Full | Self::TornByDeath | Self::ShortReads, _) => false,
        }
    }

    pub(crate) fn class(self) -> &'static str {
        match self {
            Self::Full => "disk full (ENOSPC)",
            Self::Broken => "input/output error (EIO)",
            Self::TornByDeath => "death in the middle of a write",
            Self::ShortReads => "short reads",
        }
    }
}

impl Trouble {
    /// Whether it happens to an operation of a process, and not by itself.
    pub(crate) const fn is_of_an_operation(self) -> bool {
        matches!(self, Self::Disk(_) | Self::FullQueue)
    }

    pub(crate) fn class(self) -> &'static str {
        match self {
            Self::Death(Process::Orchestrator) => "death of the orchestrator",
            Self::Death(Process::Child(Role::ExternalMemory)) => "death of an external memory",
            Self::Death(Process::Child(_)) => "death of another process",
            Self::Stall(..) => "stall of a process",
            Self::Jump(_) => "clock jump",
            Self::Disk(damage) => damage.class(),
            Self::FullQueue => "full queue",
            Self::PowerLoss => "power loss",
        }
    }
}

/// What is known about a scenario before its trials.
pub(crate) struct Undisturbed {
    /// Points of the scheduler, and operations on files.
    pub(crate) steps: u64,
    pub(crate) operations: u64,
    pub(crate) has_external_memory: bool,
    /// The lines of the log, sorted.
    pub(crate) log: Vec<String>,
}

/// When a process that could go on is interrupted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Preemption {
    /// Of 1,024 points, how many let the scheduler pick another process.
    pub(crate) of_1024: u32,
    /// None after so many points.
    pub(crate) until: u64,
}

impl Preemption {
    /// Never.
    pub(crate) const NONE: Self = Self { of_1024: 0, until: 0 };
}

/// What a seed decides beside the order of events.
pub(crate) struct Plan {
    /// The number of the scenario, below the number that there are.
    pub(crate) scenario: usize,
    pub(crate) lanes: u32,
    pub(crate) worlds: u32,
    /// Frames beyond the least that the run needs.
    pub(crate) spare_frames: u32,
    pub(crate) preemption: Preemption,
    pub(crate) faults: Vec<Fault>,
}

impl Plan {
    /// The plan of `seed` for one of the scenarios that have these undisturbed runs.
    pub(crate) fn draw(seed: u64, scenarios: &[Undisturbed]) -> Self {
        let mut draws = ChaCha8Rng::seed_from_u64(seed);
        draws.set_stream(STREAM);
        let mut below = |limit: u64| draws.next_u64() % limit;
        let scenario = below(scenarios.len() as u64) as usize;
        let Undisturbed { steps, operations, has_external_memory, .. } = scenarios[scenario];
        let processes = if has_external_memory { 5 } else { 4 };
        let lanes = 1 + below(4) as u32;
        let spare_frames = [0, 1, 4, 64][below(4) as usize];
        let of_1024 = [2, 16, 128, 1024][below(4) as usize];
        let preemption = Preemption { of_1024, until: u64::MAX };
        let mut faults = Vec::new();
        for _ in 0..below(MOST_FAULTS + 1) {
            let process = |draw| match draw {
                0 => Process::Orchestrator,
                1 => Process::Child(Role::Sim),
                2 => Process::Child(Role::Memory),
                3 => Process::Child(Role::Policy),
                _ => Process::Child(Role::ExternalMemory),
            };
            let trouble = match below(13) {
                0..3 => Trouble::Death(process(below(processes))),
                3 | 4 => Trouble::Stall(process(below(processes)), 1 << below(18)),
                5 => Trouble::Jump(1 << below(20)),
                6 => Trouble::PowerLoss,
                7 | 8 => Trouble::Disk(Damage::TornByDeath),
                9 => Trouble::Disk(Damage::Full),
                10 => Trouble::Disk(Damage::Broken),
                11 => Trouble::FullQueue,
                _ => Trouble::Disk(Damage::ShortReads),
            };
            let most = if matches!(trouble, Trouble::Disk(_)) { operations } else { steps };
            faults.push(Fault { at: 1 + below(most + most / 3), trouble });
        }
        faults.sort_by_key(|fault| fault.at);
        let worlds = 1 + below(3) as u32;
        Self { scenario, lanes, worlds, spare_frames, preemption, faults }
    }
}
