//! The grounded policy: a scripted stand-in for a model, so that everything runs offline.
//!
//! It looks at the pixels of the frames it is given and at nothing a model would not get. It reads label
//! plates ([`plate`](shm_types::plate)), sees barricades and compares pictures. Whatever memory supplies becomes
//! part of one picture of the world (`scene`): walks that were recognised (`chart`, `locate`), places,
//! floor and routes that a document tells (`document`, `lore`), and what the last views show. One procedure
//! (`decide`) uses it, wherever it is from: follow a walk, go round past everything that is known to be
//! wanted, walk to what is in sight, look where things of the kind were seen, or explore. It keeps nothing of an
//! episode: what it knows of earlier steps it works out anew from the window each time, and beyond the window
//! from where it is on a fixed way (`course`).
//!
//! It is a stand-in: its results say that the machinery works, not how well a model would do.

mod barricade;
mod chart;
mod course;
mod decide;
mod document;
mod explore;
mod geometry;
mod history;
mod instruction;
mod lasting;
mod locate;
mod lore;
mod percept;
mod recognise;
mod scene;
mod sketch;
mod surroundings;
#[cfg(test)]
mod testing;

use crate::{Decision, Policy, Request};
use chart::Charts;
use course::Courses;
use lasting::Lastings;
use locate::Locator;
use lore::Lores;
use percept::Percepts;

/// The grounded policy. All it keeps is what it worked out from frames and documents, which never change.
#[derive(Debug, Default)]
pub struct Grounded {
    mind: Mind,
}

/// What was worked out, by what it was worked out from; each is bounded. To forget any of it costs time and
/// changes no answer.
#[derive(Debug, Default)]
struct Mind {
    percepts: Percepts,
    charts: Charts,
    locator: Locator,
    lores: Lores,
    lastings: Lastings,
    courses: Courses,
}

impl Policy for Grounded {
    fn name(&self) -> &str {
        "grounded"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("stand_in", "true".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let mind = &mut self.mind;
        let decide = |request| Decision::act(request, decide::action(request, mind));
        batch.iter().map(decide).collect()
    }
}
