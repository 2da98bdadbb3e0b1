//! Full-context memory: every action of the demonstrations, and keyframes of what the expert saw, all of it
//! supplied at every step (SPEC section 5).
//!
//! Which views are keyframes, exactly:
//!
//! 1. *The budget is shared fairly.* The demonstrations take one frame each in turn, in their order, until
//!    the budget is spent; one that has no more frames is passed over. So shares differ by one at most, what
//!    a short demonstration leaves goes to the others, and where the demonstrations have as many frames as
//!    the budget, all of it is used. With fewer frames than that, every frame is a keyframe.
//! 2. *A share goes to a demonstration's moments in this order:* the start, the end, the completions of
//!    sub-goals, the moments before turns (the view in which the expert decides to turn), all others. A step
//!    that is several of these is the first of them, and takes one frame.
//! 3. *Moments of one kind that do not all fit are sampled evenly:* of `m` moments in their order `k` are
//!    kept, the middle ones of `k` equal stretches, numbers `floor((2i + 1) m / 2k)` from 0.
//!
//! A frame is a step, not a view: a place that the expert saw twice may be shown twice. Actions are never left
//! out, whatever the budget.

use anyhow::Context;
use domain::{Action, Pose};
use shm_types::documents::Content;
use shm_types::message::{NO_ACTION, NO_FRAME, TrajectoryStep};

use super::{Blueprint, Documents, Ingredients, Memory, Views, fixed};
use crate::demonstrations::Demonstration;

/// Demonstrations, and which of their steps are keyframes.
#[derive(Debug)]
pub(super) struct FullContext {
    episode: (u32, u64),
    /// Each with its keyframes: the steps, ascending.
    walks: Vec<(Demonstration, Vec<usize>)>,
    poses: Vec<Pose>,
}

impl FullContext {
    pub(super) fn new(ingredients: Ingredients) -> Self {
        let Ingredients { episode, demonstrations, keyframes: budget, .. } = ingredients;
        let lengths: Vec<usize> = demonstrations.iter().map(|walk| walk.poses.len()).collect();
        let shares = shares(&lengths, budget);
        let chosen = |(walk, share)| {
            let keyframes = keyframes(&walk, share);
            (walk, keyframes)
        };
        let walks: Vec<_> = demonstrations.into_iter().zip(shares).map(chosen).collect();
        let shown = walks.iter().flat_map(|(walk, steps)| steps.iter().map(|&t| walk.poses[t]));
        let mut poses: Vec<Pose> = shown.collect();
        poses.sort_unstable();
        poses.dedup();
        Self { episode, walks, poses }
    }
}

impl Blueprint for FullContext {
    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn build(
        &self,
        views: &Views,
        documents: &mut dyn Documents,
    ) -> anyhow::Result<Box<dyn Memory>> {
        let mut steps = Vec::new();
        for (number, (walk, keyframes)) in self.walks.iter().enumerate() {
            let trajectory = u8::try_from(number).context("more than 256 demonstrations")?;
            for (step, &pose) in walk.poses.iter().enumerate() {
                let is_keyframe = keyframes.binary_search(&step).is_ok();
                steps.push(TrajectoryStep {
                    frame: if is_keyframe { views.of(pose)?.frame } else { NO_FRAME },
                    action: walk.actions.get(step).map_or(NO_ACTION, |&action| action as u8),
                    trajectory,
                    reserved: [0; 6],
                });
            }
        }
        let id = documents.publish(self.episode, &Content::Trajectories(steps))?;
        Ok(Box::new(fixed::Fixed(vec![id])))
    }
}

/// How many of `budget` frames each demonstration gets, of as many as it has.
fn shares(lengths: &[usize], budget: usize) -> Vec<usize> {
    let mut shares = vec![0; lengths.len()];
    let mut left = budget.min(lengths.iter().sum());
    while left > 0 {
        for (share, &length) in shares.iter_mut().zip(lengths) {
            if left > 0 && *share < length {
                *share += 1;
                left -= 1;
            }
        }
    }
    shares
}

/// What a step of a demonstration is, most important first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Moment {
    Start,
    End,
    SubGoal,
    BeforeTurn,
    Other,
}

impl Moment {
    const ALL: [Self; 5] = [Self::Start, Self::End, Self::SubGoal, Self::BeforeTurn, Self::Other];

    fn of(walk: &Demonstration, step: usize) -> Self {
        const TURNS: [Action; 3] = [Action::TurnLeft, Action::TurnRight, Action::TurnAround];
        match step {
            0 => Self::Start,
            _ if step + 1 == walk.poses.len() => Self::End,
            _ if walk.stages[step] > walk.stages[step - 1] => Self::SubGoal,
            _ if TURNS.contains(&walk.actions[step]) => Self::BeforeTurn,
            _ => Self::Other,
        }
    }
}

/// The steps, ascending, whose views are kept when `share` of them are.
fn keyframes(walk: &Demonstration, share: usize) -> Vec<usize> {
    let mut chosen = Vec::with_capacity(share);
    for moment in Moment::ALL {
        let steps = 0..walk.poses.len();
        let members: Vec<usize> = steps.filter(|&step| Moment::of(walk, step) == moment).collect();
        let places = members.len().min(share - chosen.len());
        chosen.extend((0..places).map(|i| members[(2 * i + 1) * members.len() / (2 * places)]));
    }
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests;
