//! Saying what went wrong: counted, logged, and told to the orchestrator.

use bytemuck::Zeroable;

use crate::bus::{Bus, BusError, Sender};
use crate::message::{Complaint, ComplaintKind, Role, write_text};

/// A process's complaints to the orchestrator.
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

    /// Complains of a message that could not be used: what, which value, what was expected. Ring the
    /// orchestrator with the batch.
    ///
    /// Such a complaint is made on the way of something that already went wrong, so it never fails and never
    /// waits: one that cannot be delivered is counted and logged all the same.
    pub fn raise(&mut self, what: impl std::fmt::Display) {
        let complaint = self.complaint(ComplaintKind::Message, &what.to_string());
        if let Err(error) = self.sender.send_now(&complaint) {
            tracing::debug!(%error, "the complaint was not delivered");
        }
    }

    /// Says that no decision will come for the step of `episode` in `lane`, and why: the episode ends without
    /// a result. Ring the orchestrator.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn end_episode(&mut self, lane: u32, episode: u64, why: &str) -> Result<(), BusError> {
        let complaint = Complaint { lane, episode, ..self.complaint(ComplaintKind::Episode, why) };
        self.sender.send(&complaint)
    }

    /// Says that there is no point in going on with the run now, and why. Ring the orchestrator.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn end_run(&mut self, why: &str) -> Result<(), BusError> {
        let complaint = self.complaint(ComplaintKind::Run, why);
        self.sender.send(&complaint)
    }

    /// How many were made.
    pub fn count(&self) -> u32 {
        self.count
    }

    fn complaint(&mut self, kind: ComplaintKind, what: &str) -> Complaint {
        self.count = self.count.saturating_add(1);
        tracing::warn!(role = self.role.word(), count = self.count, "{what}");
        let mut complaint = Complaint {
            role: self.role as u32,
            count: self.count,
            kind: kind as u32,
            ..Zeroable::zeroed()
        };
        complaint.text_len = write_text(&mut complaint.text, what);
        complaint
    }
}
