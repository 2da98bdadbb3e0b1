//! The grounded policy: a scripted stand-in for a model that needs no network and no key.
//!
//! It uses what a model would be given and nothing else. At each step it
//! - perceives: reads plates and barricades from the frames (`perception`, `barricade`);
//! - remembers: locates the demonstrations that memory supplies by the views they share with the window
//!   (`demonstration`), and parses documents (`document`); together that is its `knowledge`;
//! - maps: marks free and occupied cells around the agent (`local_map`);
//! - plans: follows what memory plans, or follows or joins a demonstrated `tour`, else goes to what the instruction asks for, else explores
//!   (`plan`).
//!
//! It keeps no state of an episode: its `beliefs` are derived from each request anew. Its results show that
//! the harness works; they say nothing about any model. It ignores the hint of the original start. It leaves out a memory that
//! was made in another warehouse: what it reads from memory are positions and routes, and none of them is of this one.

mod barricade;
mod beliefs;
mod cache;
mod demonstration;
mod document;
mod geometry;
mod instruction;
mod knowledge;
mod local_map;
mod perception;
mod plan;
mod recent;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tour;

use beliefs::{Beliefs, PolicyCaches};
use instruction::NavigationGoal;
use peer::{Answer, Decision, Policy, Request};

/// The grounded policy. Its only state is caches of what frames and documents show.
#[derive(Debug, Default)]
pub struct Grounded {
    caches: PolicyCaches,
}

impl Policy for Grounded {
    fn name(&self) -> &str {
        "grounded"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("stand_in", "true".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let decide = |request: &Request<'_>| {
            let items = if request.demonstrated_elsewhere { &[][..] } else { request.items };
            let request = &Request { items, ..*request };
            let goal = NavigationGoal::read(request.instruction);
            match Beliefs::new(request, goal.as_ref(), &mut self.caches) {
                Ok(beliefs) => {
                    Decision::act(request, plan::next_action(request, goal.as_ref(), &beliefs))
                }
                // Another world, which a run refuses before it begins.
                Err(_) => Decision { answer: Answer::Unreadable, images: 0, usage: None },
            }
        };
        batch.iter().map(decide).collect()
    }
}
