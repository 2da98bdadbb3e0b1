//! Answers from the policy to the serve loop, from any thread and at any time.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, ThreadId};

use domain::prompt_log::RecordedExchange;
use shm_types::Notifier;
use shm_types::message::RequestId;
use shm_types::process::monotonic_ns;

use super::Decision;

/// A message from the policy to the serve loop.
#[derive(Debug)]
pub(super) enum AnswerEvent {
    /// The exchange with a model about a request, for the prompt log.
    Exchanged(RequestId, Box<RecordedExchange>),
    /// The decision, and when it was made.
    Decided(RequestId, Decision, u64),
    /// The request has no answer: its episode ends without a result.
    Failed(RequestId, String),
    /// No request can be answered: the run stops.
    Stopped(String),
    /// Decisions wait for this; empty when they no longer do.
    Waiting(String),
    /// Facts learned since the handshake.
    Learned(Vec<(&'static str, String)>),
}

/// Passes a policy's answers to the serve loop. Clone it for each thread that answers.
#[derive(Debug, Clone)]
pub struct Answers {
    events: Sender<AnswerEvent>,
    /// Wakes the serve loop.
    notifier: Arc<Notifier>,
    serving: ThreadId,
    logs_prompts: bool,
}

impl Answers {
    /// Answers to the calling thread, which `notifier` wakes, and their receiver.
    pub(super) fn new(notifier: Notifier, logs_prompts: bool) -> (Self, Receiver<AnswerEvent>) {
        let (events, received) = channel();
        let (notifier, serving) = (Arc::new(notifier), thread::current().id());
        (Self { events, notifier, serving, logs_prompts }, received)
    }

    /// Whether the run logs prompts, so that [`record`](Self::record) has an effect.
    pub fn logs_prompts(&self) -> bool {
        self.logs_prompts
    }

    /// Adds the exchange with a model about request `id` to the prompt log. Call it before [`Self::decide`].
    /// `exchange` is called only if the run logs prompts.
    pub fn record(&self, id: RequestId, exchange: impl FnOnce() -> RecordedExchange) {
        if self.logs_prompts {
            // Does not notify: the decision follows.
            let _ = self.events.send(AnswerEvent::Exchanged(id, Box::new(exchange())));
        }
    }

    /// Answers request `id`. An answer to an episode that is over is dropped.
    pub fn decide(&self, id: RequestId, decision: Decision) {
        self.send(AnswerEvent::Decided(id, decision, monotonic_ns()));
    }

    /// Gives up request `id`, for a reason that is not the policy's: its episode ends without a result and is not
    /// scored.
    pub fn fail(&self, id: RequestId, why: impl Into<String>) {
        self.send(AnswerEvent::Failed(id, why.into()));
    }

    /// Stops the run, because no request can be answered. The user can resume it.
    pub fn stop_run(&self, why: impl Into<String>) {
        self.send(AnswerEvent::Stopped(why.into()));
    }

    /// Reports that decisions wait for `reason`, such as a server that does not answer; an empty one ends the wait. The
    /// orchestrator shows it.
    pub fn waiting(&self, reason: impl Into<String>) {
        self.send(AnswerEvent::Waiting(reason.into()));
    }

    /// Reports facts for the manifest that the policy has learned since its handshake, from a server's replies for example.
    /// Together they have at most 480 bytes of JSON.
    pub fn learned(&self, facts: Vec<(&'static str, String)>) {
        self.send(AnswerEvent::Learned(facts));
    }

    fn send(&self, event: AnswerEvent) {
        // Fails when serving has ended.
        if self.events.send(event).is_err() || thread::current().id() == self.serving {
            return;
        }
        if let Err(error) = self.notifier.notify() {
            tracing::warn!(%error, "the answer waits until something else wakes the process");
        }
    }
}
