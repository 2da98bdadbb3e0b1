//! The grounded policy: a scripted stand-in for a model, so that everything runs offline.
//!
//! It looks at the pixels of the frames it is given and at nothing a model would not get: it reads label
//! plates ([`plates`]), compares pictures ([`likeness`]), follows what memory offers where it fits what it
//! sees, walks to what is asked for when it sees it, and explores otherwise. It keeps nothing of an
//! episode: what it knows of earlier steps it works out anew from the window each time.
//!
//! It is a stand-in: its results say that the machinery works, not how well a model would do.

mod instruction;
#[cfg(test)]
mod painter;
mod plates;

use shm_types::Action;

use crate::{Decision, Policy, Request};

/// The grounded policy. What it keeps is what it saw in frames, which never change.
#[derive(Debug, Default)]
pub struct Grounded {}

impl Policy for Grounded {
    fn name(&self) -> &str {
        "grounded"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("stand_in", "true".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        batch.iter().map(|request| Decision::act(request, Action::Forward)).collect()
    }
}
