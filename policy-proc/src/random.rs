//! The random policy: the lower bound.

use peer::{ActionCode, Decision, Policy, Request};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Draws one of the world's actions with equal probability from the episode's seed and the step alone, so an episode does not
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
            .map(|request| {
                let action = draw(request.world.actions.len(), request.episode_seed, request.step);
                Decision::act(request, action)
            })
            .collect()
    }
}

/// One of `count` actions.
pub(crate) fn draw(count: usize, episode_seed: u64, step: u32) -> ActionCode {
    let mut rng = ChaCha8Rng::seed_from_u64(episode_seed);
    rng.set_stream(u64::from(step));
    // The bias of the remainder is at most 64 / 2^64.
    ActionCode((rng.next_u64() % count as u64) as u8)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use conformance::messages::scripted_world;
    use peer::{FeedbackCode, FrameView, State};

    use super::*;

    #[test]
    fn actions_depend_on_the_seed_and_are_equally_frequent() {
        let actions = |seed| (0..7000).map(move |step| draw(7, seed, step));
        assert!(actions(1).eq(actions(1)));
        assert!(actions(1).ne(actions(2)));
        let mut counts = [0; 7];
        actions(3).for_each(|action| counts[usize::from(action.0)] += 1);
        assert!(counts.iter().all(|count| (850..1150).contains(count)), "{counts:?}");
    }

    #[test]
    fn every_action_of_a_world_is_drawn_and_no_other() {
        for count in [1, 3, 64] {
            let mut counts = vec![0; count];
            let steps = 0..1000 * count as u32;
            steps.for_each(|step| counts[usize::from(draw(count, 3, step).0)] += 1);
            assert!(counts.iter().all(|count| (850..1150).contains(count)), "{counts:?}");
        }
    }

    #[test]
    fn a_world_of_three_actions_gets_its_own() {
        let mut world = scripted_world();
        world.actions.truncate(3);
        let world = Arc::new(world);
        let request = |step| Request {
            lane: 0,
            step,
            episode: 1,
            episode_seed: 20_260_101,
            repeat: 1,
            instruction: "",
            state: State::new(&[0.0; 3]).unwrap(),
            feedback: FeedbackCode::START,
            frame: FrameView::NONE,
            window: &[],
            items: &[],
            starts_as_demonstrated: false,
            demonstrated_elsewhere: false,
            world: &world,
        };
        let requests: Vec<_> = (0..24).map(request).collect();
        let actions = Random.act(&requests).into_iter().map(|decision| decision.answer.action());
        insta::assert_snapshot!(world.letters(actions), @"blfffllbfbbblflbfbbllllf");
    }

    #[test]
    fn the_first_actions_of_a_seed_are_stable() {
        let letter = |step| {
            let ActionCode(code) = draw(7, 20_260_101, step);
            domain::Action::try_from(code).unwrap().letter()
        };
        let letters: String = (0..24).map(letter).collect();
        insta::assert_snapshot!(letters, @"fblLRlbrlbbfUUrLlRrbllbR");
    }
}
