//! The random policy: the lower bound.

use domain::Action;
use peer::{Decision, Policy, Request};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Draws one of the seven actions with equal probability from the episode's seed and the step alone, so an episode does not
/// depend on other episodes.
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
    // The bias of the remainder is 7 / 2^64.
    Action::ALL[(rng.next_u64() % Action::ALL.len() as u64) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_depend_on_the_seed_and_are_equally_frequent() {
        let actions = |seed| (0..7000).map(move |step| draw(seed, step));
        assert!(actions(1).eq(actions(1)));
        assert!(actions(1).ne(actions(2)));
        let mut counts = [0; 7];
        actions(3).for_each(|action| counts[action as usize] += 1);
        assert!(counts.iter().all(|count| (850..1150).contains(count)), "{counts:?}");
    }

    #[test]
    fn the_first_actions_of_a_seed_are_stable() {
        let letters: String = (0..24).map(|step| draw(20_260_101, step).letter()).collect();
        insta::assert_snapshot!(letters, @"fblLRlbrlbbfUUrLlRrbllbR");
    }
}
