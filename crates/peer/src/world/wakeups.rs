//! Which processes to wake at the end of a turn: each at most once, and of those that get an observation only the next
//! one in line.
//!
//! Waking a process costs far more than a message. Memory answers an observation, its answer wakes the policy, and the
//! policy's decision wakes the orchestrator; both find the observation in their queues then. Only the last observation of
//! an episode is for the orchestrator directly, and every observation of a run without a policy process.

use shm_types::message::Role;
use shm_types::{Bus, BusError, Notifier};

/// The other processes of a run, and which of them to wake.
#[derive(Debug)]
pub(crate) struct Wakeups {
    processes: [(Role, Notifier, bool); 3],
    has_policy: bool,
}

impl Wakeups {
    /// For the simulator of the run that `bus` has joined.
    ///
    /// # Errors
    /// When a process cannot be reached.
    pub(crate) fn new(bus: &Bus) -> Result<Self, BusError> {
        let process = |role| Ok::<_, BusError>((role, bus.notifier(role)?, false));
        Ok(Self {
            processes: [
                process(Role::Memory)?,
                process(Role::Policy)?,
                process(Role::Orchestrator)?,
            ],
            has_policy: bus.attach().participants.contains(&Role::Policy),
        })
    }

    /// Wakes `role` at the next [`Self::send`].
    pub(crate) fn add(&mut self, role: Role) {
        for (process, _, is_due) in &mut self.processes {
            *is_due |= *process == role;
        }
    }

    /// Adds the process that handles an observation first; `last` is whether it ends an episode.
    pub(crate) fn add_for_observation(&mut self, last: bool) {
        self.add(Role::Memory);
        if last || !self.has_policy {
            self.add(Role::Orchestrator);
        }
    }

    /// Wakes all processes added since the last call.
    ///
    /// # Errors
    /// When the transport fails.
    pub(crate) fn send(&mut self) -> Result<(), BusError> {
        for (_, notifier, is_due) in &mut self.processes {
            if std::mem::take(is_due) {
                notifier.notify()?;
            }
        }
        Ok(())
    }

    /// Wakes all processes.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub(crate) fn send_to_all(&mut self) -> Result<(), BusError> {
        for (_, _, is_due) in &mut self.processes {
            *is_due = true;
        }
        self.send()
    }
}
