//! Full-context memory: every action of the demonstrations and keyframes of the expert's views, supplied at every step
//! (specification, section 5).
//!
//! Keyframes are chosen by these rules:
//!
//! 1. *The budget is shared fairly.* The demonstrations take one frame each in turn until the budget is spent. A
//!    demonstration without frames left is skipped. Shares of long demonstrations therefore differ by one at most, and
//!    with fewer frames than the budget every frame is a keyframe.
//! 2. *A demonstration's share is filled in this order:* the start, the end, completions of sub-goals, moments before
//!    turns (the view in which the expert decides to turn), all others. A step of several kinds counts as the first.
//! 3. *Moments of one kind that do not all fit are sampled evenly:* of `m` moments, `k` are kept, with the numbers
//!    `floor((2i + 1) m / 2k)` from 0.
//!
//! A keyframe is a step, not a view: a view that the expert saw twice may appear twice. Actions are always complete.

use anyhow::Context;
use domain::{Action, Pose};
use shm_types::documents::Content;
use shm_types::message::{NO_ACTION, NO_FRAME, TrajectoryStep};

use super::{DocumentSupplier, Memory, MemoryBuilder, MemorySpec, StoredViews, consolidated};
use crate::demonstrations::Demonstration;

/// Builds the document of a case's demonstrations.
#[derive(Debug)]
pub(super) struct FullContext {
    episode: (u32, u64),
    /// Each with the steps of its keyframes, ascending.
    demonstrations: Vec<(Demonstration, Vec<usize>)>,
    poses: Vec<Pose>,
}

impl FullContext {
    pub(super) fn new(spec: MemorySpec) -> Self {
        let MemorySpec { episode, demonstrations, keyframes: budget, .. } = spec;
        let lengths: Vec<usize> =
            demonstrations.iter().map(|demonstration| demonstration.poses.len()).collect();
        let shares = shares(&lengths, budget);
        let choose = |(demonstration, share)| {
            let keyframes = keyframes(&demonstration, share);
            (demonstration, keyframes)
        };
        let chosen: Vec<_> = demonstrations.into_iter().zip(shares).map(choose).collect();
        let shown = chosen
            .iter()
            .flat_map(|(demonstration, steps)| steps.iter().map(|&t| demonstration.poses[t]));
        let mut poses: Vec<Pose> = shown.collect();
        poses.sort_unstable();
        poses.dedup();
        Self { episode, demonstrations: chosen, poses }
    }
}

impl MemoryBuilder for FullContext {
    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn build(
        &self,
        views: &StoredViews,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Box<dyn Memory>> {
        let mut steps = Vec::new();
        for (number, (demonstration, keyframes)) in self.demonstrations.iter().enumerate() {
            let trajectory = u8::try_from(number).context("more than 256 demonstrations")?;
            for (step, &pose) in demonstration.poses.iter().enumerate() {
                let is_keyframe = keyframes.binary_search(&step).is_ok();
                steps.push(TrajectoryStep {
                    frame: if is_keyframe { views.of(pose)?.frame } else { NO_FRAME },
                    action: demonstration
                        .actions
                        .get(step)
                        .map_or(NO_ACTION, |&action| action as u8),
                    trajectory,
                    reserved: [0; 6],
                });
            }
        }
        let id = documents.publish(self.episode, &Content::Trajectories(steps))?;
        Ok(Box::new(consolidated::SameDocuments(vec![id])))
    }
}

/// Distributes `budget` frames over demonstrations with these many frames.
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

/// The kinds of step, most important first.
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

    fn of(demonstration: &Demonstration, step: usize) -> Self {
        const TURNS: [Action; 3] = [Action::TurnLeft, Action::TurnRight, Action::TurnAround];
        match step {
            0 => Self::Start,
            _ if step + 1 == demonstration.poses.len() => Self::End,
            _ if demonstration.stages[step] > demonstration.stages[step - 1] => Self::SubGoal,
            _ if TURNS.contains(&demonstration.actions[step]) => Self::BeforeTurn,
            _ => Self::Other,
        }
    }
}

/// The steps of `share` keyframes, ascending.
fn keyframes(demonstration: &Demonstration, share: usize) -> Vec<usize> {
    let mut chosen = Vec::with_capacity(share);
    for moment in Moment::ALL {
        let steps = 0..demonstration.poses.len();
        let members: Vec<usize> =
            steps.filter(|&step| Moment::of(demonstration, step) == moment).collect();
        let places = members.len().min(share - chosen.len());
        chosen.extend((0..places).map(|i| members[(2 * i + 1) * members.len() / (2 * places)]));
    }
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests;
