//! Reporting errors to the orchestrator.

use bytemuck::Zeroable;

use crate::bus::{Bus, BusError, Sender};
use crate::message::{ErrorReport, ErrorReportKind, Role, write_text};

/// Reports errors to the orchestrator; counts and logs them.
#[derive(Debug)]
pub struct ErrorReporter {
    sender: Sender<ErrorReport>,
    role: Role,
    index: u32,
    count: u32,
}

impl ErrorReporter {
    /// Creates a reporter for the process that joined `bus`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self { sender: bus.sender()?, role: bus.role(), index: bus.index().into(), count: 0 })
    }

    /// Reports a message that could not be used: what is wrong, the value, and what was expected. Notify the
    /// orchestrator afterwards.
    ///
    /// Never fails and never waits: a report that cannot be delivered is still counted and logged.
    pub fn report(&mut self, what: impl std::fmt::Display) {
        let error_report = self.new_report(ErrorReportKind::Message, &what.to_string());
        if let Err(error) = self.sender.send(&error_report) {
            tracing::debug!(%error, "the error report was not delivered");
        }
    }

    /// Reports that the running step of `episode` in `lane` gets no answer, and why: the episode ends without a
    /// result. Notify the orchestrator afterwards.
    ///
    /// # Errors
    /// When the report cannot be delivered.
    pub fn fail_episode(&mut self, lane: u32, episode: u64, why: &str) -> Result<(), BusError> {
        self.end_episode(ErrorReportKind::Episode, lane, episode, why)
    }

    /// As [`Self::fail_episode`], because the episode's external memory has exceeded a time limit.
    ///
    /// # Errors
    /// When the report cannot be delivered.
    pub fn overdue(&mut self, lane: u32, episode: u64, why: &str) -> Result<(), BusError> {
        self.end_episode(ErrorReportKind::Overdue, lane, episode, why)
    }

    fn end_episode(
        &mut self,
        kind: ErrorReportKind,
        lane: u32,
        episode: u64,
        why: &str,
    ) -> Result<(), BusError> {
        let error_report = ErrorReport { lane, episode, ..self.new_report(kind, why) };
        self.sender.send(&error_report)
    }

    /// Reports that no episode can continue, and why: the run stops. Notify the orchestrator afterwards.
    ///
    /// # Errors
    /// When the report cannot be delivered.
    pub fn stop_run(&mut self, why: &str) -> Result<(), BusError> {
        let error_report = self.new_report(ErrorReportKind::Run, why);
        self.sender.send(&error_report)
    }

    /// Reports that decisions wait for `reason`, such as a server that does not answer; an empty reason ends the wait.
    /// Not an error: neither counted nor logged. Notify the orchestrator afterwards.
    ///
    /// # Errors
    /// When the report cannot be delivered.
    pub fn waiting(&self, reason: &str) -> Result<(), BusError> {
        self.sender.send(&self.filled_in(ErrorReportKind::Waiting, reason))
    }

    /// Reports facts that the process has learned since its handshake. Not an error: neither counted nor logged. Notify the
    /// orchestrator afterwards.
    ///
    /// # Errors
    /// When the report cannot be delivered.
    pub fn learned<'a>(
        &self,
        facts: impl IntoIterator<Item = (&'a str, String)>,
    ) -> Result<(), BusError> {
        let facts: serde_json::Map<_, _> =
            facts.into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
        let text = serde_json::Value::from(facts).to_string();
        self.sender.send(&self.filled_in(ErrorReportKind::Facts, &text))
    }

    /// The number of reports so far.
    pub fn count(&self) -> u32 {
        self.count
    }

    fn new_report(&mut self, kind: ErrorReportKind, what: &str) -> ErrorReport {
        self.count = self.count.saturating_add(1);
        tracing::warn!(role = self.role.word(), count = self.count, "{what}");
        self.filled_in(kind, what)
    }

    fn filled_in(&self, kind: ErrorReportKind, text: &str) -> ErrorReport {
        let mut error_report = ErrorReport {
            role: self.role as u32,
            index: self.index,
            count: self.count,
            kind: kind as u32,
            ..Zeroable::zeroed()
        };
        error_report.text_len = write_text(&mut error_report.text, text);
        error_report
    }
}
