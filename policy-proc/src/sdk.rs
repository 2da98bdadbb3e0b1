//! The policy SDK: the trait a policy implements, and the loop that puts it on the wire.

use shm_types::message::FrameId;

use crate::{Decision, Request};

/// Something that decides. The built-in policies are written against this and nothing else.
pub trait Policy {
    /// What the run's manifest calls it.
    fn name(&self) -> &str;

    /// One decision for each request, in the same order. The requests are of different lanes, all that
    /// wait for an answer at this moment; a decision may not depend on what else is in the batch.
    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision>;

    /// A new episode begins in `lane`: forget whatever was kept for it.
    fn reset(&mut self, lane: u32) {
        let _ = lane;
    }

    /// No request will show this frame again: forget whatever was kept for it.
    fn forget(&mut self, frame: FrameId) {
        let _ = frame;
    }
}
