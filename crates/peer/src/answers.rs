//! The way back: what a policy says to its requests, from any thread and at any time.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, ThreadId};

use domain::prompt_log::Exchange;
use shm_types::Notifier;
use shm_types::process::monotonic_ns;

use crate::{Decision, RequestId};

/// What a policy says.
#[derive(Debug)]
pub(super) enum Said {
    /// What was said to a model about a request, and what it said.
    Exchanged(RequestId, Box<Exchange>),
    /// The answer to a request, and when it was there.
    Decided(RequestId, Decision, u64),
    /// There will be no answer to a request.
    Failed(RequestId, String),
    /// The run should stop.
    Halt(String),
    /// Decisions wait for this, or for nothing any longer if it is empty.
    Waiting(String),
}

/// Takes a policy's answers. Clones go to whatever thread has something to say.
#[derive(Debug, Clone)]
pub struct Answers {
    said: Sender<Said>,
    /// Wakes the serving thread.
    notifier: Arc<Notifier>,
    serving: ThreadId,
    /// Whether somebody wants to know what was said to a model.
    logged: bool,
}

impl Answers {
    /// The way to the thread that calls this, which `bell` wakes, and its end there. `logged`: whether prompts
    /// are.
    pub(super) fn new(notifier: Notifier, logged: bool) -> (Self, Receiver<Said>) {
        let (said, heard) = channel();
        (
            Self { said, notifier: Arc::new(notifier), serving: thread::current().id(), logged },
            heard,
        )
    }

    /// Whether prompts are logged, for who has to keep something to [`record`](Self::record).
    pub fn logs_prompts(&self) -> bool {
        self.logged
    }

    /// For the prompt log, before [`Self::decide`]: what was said to a model about the request that `ticket`
    /// names, and what it said. `exchange` is called only where prompts are logged.
    pub fn record(&self, ticket: RequestId, exchange: impl FnOnce() -> Exchange) {
        if self.logged {
            // Nobody need be woken for it: the decision follows.
            let _ = self.said.send(Said::Exchanged(ticket, Box::new(exchange())));
        }
    }

    /// Answers the request that `ticket` names. An answer that comes when its episode is over is dropped.
    pub fn decide(&self, ticket: RequestId, decision: Decision) {
        self.say(Said::Decided(ticket, decision, monotonic_ns()));
    }

    /// No answer can be had to the request that `ticket` names, for a reason that is not the policy's: its
    /// episode ends without a result, and is not scored.
    pub fn fail(&self, ticket: RequestId, why: impl Into<String>) {
        self.say(Said::Failed(ticket, why.into()));
    }

    /// No answer can be had to any request now: the run should stop, to be gone on with later.
    pub fn halt(&self, why: impl Into<String>) {
        self.say(Said::Halt(why.into()));
    }

    /// Reports that decisions wait for `reason`, such as a server that does not answer; an empty one ends the wait. The
    /// orchestrator shows it.
    pub fn waiting(&self, reason: impl Into<String>) {
        self.say(Said::Waiting(reason.into()));
    }

    fn say(&self, said: Said) {
        // When serving has ended, nobody wants to know any more.
        if self.said.send(said).is_err() || thread::current().id() == self.serving {
            return;
        }
        if let Err(error) = self.notifier.notify() {
            tracing::warn!(%error, "the answer waits until somebody else wakes the process");
        }
    }
}
