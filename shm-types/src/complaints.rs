//! Saying what could not be used: counted, logged, and told to the orchestrator.

use bytemuck::Zeroable;

use crate::bus::{Bus, BusError, Sender};
use crate::message::{Complaint, Role, write_text};

/// A process's complaints to the orchestrator.
///
/// A complaint is made on the way of something that already went wrong, so it never fails and never
/// waits: one that cannot be delivered is counted and logged all the same.
#[derive(Debug)]
pub struct Complaints {
    sender: Sender<Complaint>,
    role: Role,
    count: u32,
}

impl Complaints {
    /// For the process that joined `bus`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self { sender: bus.sender()?, role: bus.role(), count: 0 })
    }

    /// Complains: what, which value, what was expected. Ring the orchestrator with the batch.
    pub fn raise(&mut self, what: impl std::fmt::Display) {
        let what = what.to_string();
        self.count = self.count.saturating_add(1);
        tracing::warn!(role = self.role.word(), count = self.count, "{what}");
        let mut complaint =
            Complaint { role: self.role as u32, count: self.count, ..Zeroable::zeroed() };
        complaint.text_len = write_text(&mut complaint.text, &what);
        if let Err(error) = self.sender.send_now(&complaint) {
            tracing::debug!(%error, "the complaint was not delivered");
        }
    }

    /// How many were made.
    pub fn count(&self) -> u32 {
        self.count
    }
}
