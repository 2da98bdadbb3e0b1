//! What the heartbeats of the worlds and of memory say: which of them keeps an answer waiting.
//!
//! Memory needs frames for its answers. So when its answer is overdue, a world may be the one that hangs.

use std::collections::BTreeMap;
use std::time::Duration;

use shm_types::heartbeats;
use shm_types::message::{Heartbeat, Role};

use super::Participant;

/// A serve loop that runs is heard several times in this time.
const SILENCE: Duration = Duration::from_secs(3 * heartbeats::INTERVAL.as_secs());

/// The last heartbeats of the worlds and of memory.
#[derive(Debug, Clone)]
pub(super) struct VitalSigns {
    worlds: BTreeMap<Participant, ProcessSigns>,
    memory: ProcessSigns,
}

#[derive(Debug, Clone, Copy)]
struct ProcessSigns {
    /// When the last heartbeat arrived.
    heard_ns: u64,
    /// Frames rendered, or images embedded, and when that was last known to grow.
    done: u64,
    progress_ns: u64,
    /// Views, or images, that were waiting.
    waiting: u64,
}

impl VitalSigns {
    /// Before the first heartbeats of processes that are ready at `now_ns`, so many worlds among them.
    pub(super) fn new(worlds: u8, now_ns: u64) -> Self {
        let signs = ProcessSigns { heard_ns: now_ns, done: 0, progress_ns: 0, waiting: 0 };
        let worlds = (0..worlds).map(|index| (Participant::world(index), signs)).collect();
        Self { worlds, memory: signs }
    }

    /// A heartbeat of `sender` arrived.
    pub(super) fn heard(&mut self, sender: Participant, heartbeat: &Heartbeat, now_ns: u64) {
        let signs = match sender.role {
            Role::Memory => Some(&mut self.memory),
            _ => self.worlds.get_mut(&sender),
        };
        let Some(signs) = signs else { return };
        signs.heard_ns = now_ns;
        signs.waiting = heartbeat.waiting;
        if heartbeat.done > signs.done {
            signs.done = heartbeat.done;
            signs.progress_ns = now_ns;
        }
    }

    /// When memory was last known to embed an image; 0: never.
    pub(super) fn memory_busy_ns(&self) -> u64 {
        self.memory.progress_ns
    }

    /// The world that is silent while memory is not, if one is, and how that shows.
    pub(super) fn simulator_is_silent(&self, now_ns: u64) -> Option<(Participant, String)> {
        let passed = |since: u64| Duration::from_nanos(now_ns.saturating_sub(since));
        let (&world, sim) = self.worlds.iter().min_by_key(|(_, signs)| signs.heard_ns)?;
        let silence = passed(sim.heard_ns);
        let is_memory_alive = passed(self.memory.heard_ns) < silence / 2;
        let (name, seconds) = (world.in_words(), silence.as_secs());
        (silence >= SILENCE && is_memory_alive).then(|| {
            let why = format!(
                "{name} has not reported for {seconds} s and seems to hang; memory waits for its frames"
            );
            (world, why)
        })
    }

    /// The world because of which an answer of memory that is awaited since `since_ns` is overdue, if one is, and how that
    /// shows. A world that has no room for frames, because an external memory pins them, cannot be distinguished from one that hangs.
    pub(super) fn simulator_hangs(
        &self,
        since_ns: u64,
        now_ns: u64,
    ) -> Option<(Participant, String)> {
        if let Some(silent) = self.simulator_is_silent(now_ns) {
            return Some(silent);
        }
        self.worlds.iter().find_map(|(&world, sim)| {
            let idle = Duration::from_nanos(now_ns.saturating_sub(sim.progress_ns.max(since_ns)));
            (sim.waiting > 0 && sim.progress_ns <= since_ns && idle >= SILENCE).then(|| {
                let why = format!(
                    "{} has rendered none of {} views for {} s and seems to hang; memory waits for its frames",
                    world.in_words(),
                    sim.waiting,
                    idle.as_secs()
                );
                (world, why)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    /// The signs after heartbeats at these seconds, with frames rendered or images embedded, and what waits.
    fn signs(beats: &[(Role, u64, u64, u64)]) -> VitalSigns {
        let mut signs = VitalSigns::new(1, 0);
        for &(role, second, done, waiting) in beats {
            let heartbeat = Heartbeat { done, waiting, ..Zeroable::zeroed() };
            signs.heard(role.into(), &heartbeat, second * 1_000_000_000);
        }
        signs
    }

    fn hangs(beats: &[(Role, u64, u64, u64)], since: u64, now: u64) -> Option<String> {
        let hangs = signs(beats).simulator_hangs(since * 1_000_000_000, now * 1_000_000_000);
        hangs.map(|(_, why)| why)
    }

    #[test]
    fn the_silent_one_of_simulator_and_memory_is_the_one_that_hangs() {
        let (sim, memory) = (Role::Sim, Role::Memory);
        let found = hangs(&[(sim, 10, 5, 0), (memory, 119, 3, 2)], 1, 120).unwrap();
        assert!(found.contains("sim process has not reported for 110 s"), "{found}");
        assert_eq!(hangs(&[(sim, 119, 5, 0), (memory, 10, 3, 2)], 1, 120), None);
        assert_eq!(hangs(&[(sim, 119, 5, 0), (memory, 119, 3, 2)], 1, 120), None);
        assert_eq!(hangs(&[], 1, 120), None, "both are silent");
        assert_eq!(signs(&[(memory, 7, 1, 0), (memory, 9, 1, 0)]).memory_busy_ns(), 7_000_000_000);
    }

    #[test]
    fn the_silent_one_of_several_worlds_is_named() {
        let mut signs = VitalSigns::new(3, 0);
        for (sender, second) in [
            (Participant::world(0), 119),
            (Participant::world(1), 10),
            (Participant::world(2), 119),
            (Role::Memory.into(), 119),
        ] {
            signs.heard(sender, &Heartbeat::zeroed(), second * 1_000_000_000);
        }
        let (world, found) = signs.simulator_is_silent(120_000_000_000).unwrap();
        assert_eq!(world, Participant::world(1));
        assert!(found.starts_with("the sim process 1 has not reported for 110 s"), "{found}");
    }

    #[test]
    fn a_simulator_that_renders_nothing_of_what_waits_hangs() {
        let alive = (Role::Memory, 119, 3, 2);
        let found = hangs(&[(Role::Sim, 2, 5, 1), (Role::Sim, 119, 5, 4), alive], 3, 120).unwrap();
        assert!(found.contains("rendered none of 4 views for 117 s"), "{found}");
        assert_eq!(hangs(&[(Role::Sim, 2, 5, 1), (Role::Sim, 119, 6, 4), alive], 3, 120), None);
        assert_eq!(hangs(&[(Role::Sim, 2, 5, 1), (Role::Sim, 119, 5, 0), alive], 3, 120), None);
    }
}
