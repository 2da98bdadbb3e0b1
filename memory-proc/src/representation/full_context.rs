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

use domain::ActionCode;
use peer::memory::{Demonstration, Memory, MemoryError, MemoryItem, Query, Source, Views};

/// All demonstrations of a case.
#[derive(Debug)]
pub(super) struct FullContext {
    budget: usize,
    /// The actions that are turns.
    turns: Vec<ActionCode>,
    items: Vec<MemoryItem>,
}

impl FullContext {
    /// With at most `budget` keyframes, in a world where `turns` are turns.
    pub(super) fn new(budget: usize, turns: Vec<ActionCode>) -> Self {
        Self { budget, turns, items: Vec::new() }
    }
}

impl Memory for FullContext {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        let lengths: Vec<usize> = demonstrations.iter().map(|of| of.steps.len()).collect();
        let shares = shares(&lengths, self.budget);
        let chosen = demonstrations.iter().zip(shares).zip(0..);
        let items = chosen.map(|((of, share), demonstration)| MemoryItem::Steps {
            source: Source { demonstration, first: 0, count: of.steps.len() as u32 },
            views: Views::Keyframes(
                keyframes(of, share, &self.turns).into_iter().map(|t| t as u32).collect(),
            ),
            actions: true,
            distance: None,
        });
        self.items = items.collect();
        Ok(())
    }

    fn recall(&mut self, _: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        Ok(self.items.clone())
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

    fn of(demonstration: &Demonstration<'_>, step: usize, turns: &[ActionCode]) -> Self {
        let Demonstration { steps, stages, .. } = demonstration;
        match step {
            0 => Self::Start,
            _ if step + 1 == steps.len() => Self::End,
            _ if stages[step] > stages[step - 1] => Self::SubGoal,
            _ if steps[step].action.is_some_and(|action| turns.contains(&action)) => {
                Self::BeforeTurn
            }
            _ => Self::Other,
        }
    }
}

/// The steps of `share` keyframes, ascending.
fn keyframes(demonstration: &Demonstration<'_>, share: usize, turns: &[ActionCode]) -> Vec<usize> {
    let mut chosen = Vec::with_capacity(share);
    for moment in Moment::ALL {
        let steps = 0..demonstration.steps.len();
        let members: Vec<usize> =
            steps.filter(|&step| Moment::of(demonstration, step, turns) == moment).collect();
        let places = members.len().min(share - chosen.len());
        chosen.extend((0..places).map(|i| members[(2 * i + 1) * members.len() / (2 * places)]));
    }
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests;
