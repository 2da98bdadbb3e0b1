//! Full-context memory: every action of the demonstrations and keyframes of the expert's views, supplied at every step
//! (specification, section 5).
//!
//! *The budget of keyframes is shared fairly.* The demonstrations take one frame each in turn until the budget is spent. A
//! demonstration without frames left is skipped. Shares of long demonstrations therefore differ by one at most, and with fewer
//! frames than the budget every frame is a keyframe. Which steps a share goes to: [`case_book::keyframes`].
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

/// The steps of `share` keyframes, ascending, where `turns` are turns.
fn keyframes(
    Demonstration { steps, stages, .. }: &Demonstration<'_>,
    share: usize,
    turns: &[ActionCode],
) -> Vec<usize> {
    let is_turn = |step: usize| steps[step].action.is_some_and(|action| turns.contains(&action));
    case_book::keyframes(stages, share, is_turn)
}

#[cfg(test)]
mod tests;
