//! Reporting progress to the orchestrator, about once a second: also when there is none, as a sign that the serve loop runs.

use std::time::Duration;

use crate::bus::{Bus, BusError, Sender};
use crate::clock::Instant;
use crate::message::{Heartbeat, Role};

/// Minimum time between two heartbeats. Serve loops sleep no longer, so it is also about the maximum.
pub const INTERVAL: Duration = Duration::from_secs(1);

/// Sends the heartbeats of a process.
#[derive(Debug)]
pub struct Heartbeats {
    sender: Sender<Heartbeat>,
    role: Role,
    index: u32,
    sent: Instant,
}

impl Heartbeats {
    /// Creates the sender for the process that joined `bus`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        let (sender, role, index) = (bus.sender()?, bus.role(), bus.index().into());
        Ok(Self { sender, role, index, sent: Instant::now() })
    }

    /// Sends `heartbeat` (the role is filled in) if the last one was sent a second ago.
    /// Returns whether it was due; notify the orchestrator then. Call it in every iteration of the serve loop.
    ///
    /// Never fails and never waits: a heartbeat may be lost.
    pub fn beat(&mut self, heartbeat: impl FnOnce() -> Heartbeat) -> bool {
        if self.sent.elapsed() < INTERVAL {
            return false;
        }
        self.sent = Instant::now();
        let (role, index) = (self.role as u32, self.index);
        let heartbeat = Heartbeat { role, index, ..heartbeat() };
        if let Err(error) = self.sender.send(&heartbeat) {
            tracing::debug!(%error, "the heartbeat was not delivered");
        }
        true
    }
}
