//! The grounded policy: a scripted stand-in for a model, so that everything runs offline.
//!
//! It looks at the pixels of the frames it is given and at nothing a model would not get. It reads label
//! plates ([`plate`](shm_types::plate)) and compares pictures; it follows what memory offers where that fits what it sees,
//! walks to what is asked for when it sees it, and explores otherwise. It keeps nothing of an episode: what
//! it knows of earlier steps it works out anew from the window each time.
//!
//! It is a stand-in: its results say that the machinery works, not how well a model would do.

mod decide;
mod explore;
mod geometry;
mod history;
mod instruction;
mod percept;
mod recognise;
mod sketch;
mod surroundings;
#[cfg(test)]
mod testing;

use crate::{Decision, Policy, Request};
use percept::Percepts;

/// The grounded policy. All it keeps is what it saw in frames, which never change.
#[derive(Debug, Default)]
pub struct Grounded {
    percepts: Percepts,
}

impl Policy for Grounded {
    fn name(&self) -> &str {
        "grounded"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("stand_in", "true".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let percepts = &mut self.percepts;
        let decide = |request| Decision::act(request, decide::action(request, percepts));
        batch.iter().map(decide).collect()
    }
}
