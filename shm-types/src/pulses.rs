//! Telling the orchestrator, about once a second, what one is at.

use std::time::{Duration, Instant};

use bytemuck::Zeroable;

use crate::bus::{Bus, BusError, Sender};
use crate::message::{Pulse, Role};

/// Time between two pulses.
const INTERVAL: Duration = Duration::from_secs(1);

/// A process's account of what it is at.
#[derive(Debug)]
pub struct Pulses {
    sender: Sender<Pulse>,
    role: Role,
    last: Pulse,
    sent: Instant,
}

impl Pulses {
    /// For the process that joined `bus`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        let (sender, role) = (bus.sender()?, bus.role());
        Ok(Self { sender, role, last: Zeroable::zeroed(), sent: Instant::now() })
    }

    /// Sends what `pulse` says (its role is filled in), if the last one was a second ago and something has
    /// changed since. Returns whether there was something to send; ring the orchestrator then. Call it at every
    /// turn.
    ///
    /// A pulse never fails and never waits: one that nobody receives is no loss.
    pub fn beat(&mut self, pulse: impl FnOnce() -> Pulse) -> bool {
        if self.sent.elapsed() < INTERVAL {
            return false;
        }
        self.sent = Instant::now();
        let pulse = Pulse { role: self.role as u32, ..pulse() };
        let is_news = pulse != self.last;
        if is_news && let Err(error) = self.sender.send_now(&pulse) {
            tracing::debug!(%error, "the pulse was not delivered");
        }
        self.last = pulse;
        is_news
    }
}
