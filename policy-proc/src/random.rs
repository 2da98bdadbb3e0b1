//! The random policy: the lower end of the scale.

use domain::Action;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::{Decision, Policy, Request};

/// Draws one of the seven actions, all alike, from the episode's seed and the step alone: the same
/// episode is the same walk whatever else runs beside it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Random;

impl Policy for Random {
    fn name(&self) -> &str {
        "random"
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        batch
            .iter()
            .map(|request| Decision::act(request, draw(request.episode_seed, request.step)))
            .collect()
    }
}

fn draw(episode_seed: u64, step: u32) -> Action {
    let mut rng = ChaCha8Rng::seed_from_u64(episode_seed);
    rng.set_stream(u64::from(step));
    // 2^64 is so much larger than 7 that the remainder's bias is out of reach of any run.
    Action::ALL[(rng.next_u64() % Action::ALL.len() as u64) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_is_its_seed_and_uses_every_action_about_equally_often() {
        let walk = |seed| (0..7000).map(move |step| draw(seed, step));
        assert!(walk(1).eq(walk(1)));
        assert!(walk(1).ne(walk(2)));
        let mut counts = [0; 7];
        walk(3).for_each(|action| counts[action as usize] += 1);
        assert!(counts.iter().all(|count| (850..1150).contains(count)), "{counts:?}");
    }

    #[test]
    fn the_first_steps_never_change_between_versions() {
        let letters: String = (0..24).map(|step| draw(20_260_101, step).letter()).collect();
        insta::assert_snapshot!(letters, @"fblLRlbrlbbfUUrLlRrbllbR");
    }
}
