//! Whom to wake: of those who are sent an observation, the one whose turn it is.
//!
//! A wake-up costs far more than a message. Memory answers an observation, and what it sends wakes the policy,
//! whose decision wakes the orchestrator; both find the observation in their queues then. Only the end of an
//! episode is the orchestrator's to answer at once, and every observation where it decides itself.

use shm_types::message::Role;
use shm_types::{Bus, BusError, Notifier};

/// The simulator's neighbours.
#[derive(Debug)]
pub(crate) struct Neighbours {
    pub(crate) memory: Neighbour,
    pub(crate) policy: Neighbour,
    pub(crate) orchestrator: Neighbour,
    /// Whether somebody decides but the orchestrator.
    has_policy: bool,
}

/// A neighbour, and whether it is to be woken.
#[derive(Debug)]
pub(crate) struct Neighbour {
    notifier: Notifier,
    is_due: bool,
}

impl Neighbours {
    /// Of the simulator of the run that `bus` has joined.
    ///
    /// # Errors
    /// When a doorbell cannot be reached.
    pub(crate) fn new(bus: &Bus) -> Result<Self, BusError> {
        let neighbour =
            |role| Ok::<_, BusError>(Neighbour { notifier: bus.notifier(role)?, is_due: false });
        Ok(Self {
            memory: neighbour(Role::Memory)?,
            policy: neighbour(Role::Policy)?,
            orchestrator: neighbour(Role::Orchestrator)?,
            has_policy: bus.attach().participants.contains(&Role::Policy),
        })
    }

    /// An observation was sent; `last`: an episode's last one.
    pub(crate) fn observed(&mut self, last: bool) {
        self.memory.wake();
        if last || !self.has_policy {
            self.orchestrator.wake();
        }
    }

    /// Rings at whoever is to be woken, once.
    ///
    /// # Errors
    /// When the transport fails.
    pub(crate) fn notify(&mut self) -> Result<(), BusError> {
        let Self { memory, policy, orchestrator, .. } = self;
        for neighbour in [memory, policy, orchestrator] {
            if std::mem::take(&mut neighbour.is_due) {
                neighbour.notifier.notify()?;
            }
        }
        Ok(())
    }

    /// Rings at everybody.
    ///
    /// # Errors
    /// As [`Self::ring`].
    pub(crate) fn ring_all(&mut self) -> Result<(), BusError> {
        let Self { memory, policy, orchestrator, .. } = self;
        [memory, policy, orchestrator].into_iter().for_each(Neighbour::wake);
        self.notify()
    }
}

impl Neighbour {
    /// Has it woken at the next ring.
    pub(crate) fn wake(&mut self) {
        self.is_due = true;
    }
}
