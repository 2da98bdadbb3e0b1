//! Where to go when nothing seen or remembered says where.

use domain::{Action, Cell, Heading};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::geometry::turn_towards;
use super::history::History;
use super::surroundings::Surroundings;

/// The next action: on ahead while that is possible, now and then to a side where no rack is known, and
/// rather to cells that were not stood on lately. Ties and whims come from the episode's seed and the step.
pub(super) fn action(
    history: &History,
    surroundings: &Surroundings,
    episode_seed: u64,
    step: u32,
) -> Action {
    let mut rng = ChaCha8Rng::seed_from_u64(episode_seed);
    rng.set_stream(u64::from(step));
    let here = history.here;
    let best = [0, 1, 3, 2]
        .map(|quarters| here.heading.turned(quarters))
        .into_iter()
        .map(|direction| (appeal(direction, history, surroundings) + whim(&mut rng), direction))
        .max_by_key(|&(appeal, _)| appeal);
    let direction = best.map_or(here.heading, |(_, direction)| direction);
    turn_towards(here.heading, direction).unwrap_or(Action::Forward)
}

/// How good it seems to go on in `direction`.
fn appeal(direction: Heading, history: &History, surroundings: &Surroundings) -> i32 {
    let here = history.here;
    let Some(cell) = here.cell.step(direction) else { return -100 };
    if surroundings.is_solid(cell) {
        return -100;
    }
    let turned = history.past.last().is_some_and(|past| past.pose.cell == here.cell);
    let habit = match direction {
        ahead if ahead == here.heading => 8 + if turned { 12 } else { 0 },
        back if back == here.heading.opposite() => -8,
        _ => 0,
    };
    let known = if surroundings.is_free(cell) { 3 } else { 0 };
    habit + known - staleness(cell, history)
}

/// More for a cell that was stood on, and more the later that was.
fn staleness(cell: Cell, history: &History) -> i32 {
    let since = history.stood_on().rev().position(|stood_on| stood_on == cell);
    since.map_or(0, |since| (12 - since as i32).max(2))
}

fn whim(rng: &mut ChaCha8Rng) -> i32 {
    (rng.next_u32() % 12) as i32
}
