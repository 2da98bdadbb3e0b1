//! Which steps of a demonstration are its keyframes (specification, section 5).
//!
//! 1. *A share is filled in this order:* the start, the end, completions of sub-goals, moments before turns (the view in
//!    which the expert decides to turn), all others. A step of several kinds counts as the first.
//! 2. *Moments of one kind that do not all fit are sampled evenly:* of `m` moments, `k` are kept, with the numbers
//!    `floor((2i + 1) m / 2k)` from 0.

/// The kinds of step, most important first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Moment {
    /// The first step.
    Start,
    /// The last step.
    End,
    /// A sub-goal was completed by the action before.
    SubGoal,
    /// The action is a turn.
    BeforeTurn,
    /// Any other.
    Other,
}

impl Moment {
    const ALL: [Self; 5] = [Self::Start, Self::End, Self::SubGoal, Self::BeforeTurn, Self::Other];

    /// The kind of a step: `stages` are the completed sub-goals by step, and `is_turn` says whether the action at a step is a
    /// turn.
    pub fn of(stages: &[u32], step: usize, is_turn: impl Fn(usize) -> bool) -> Self {
        match step {
            0 => Self::Start,
            _ if step + 1 == stages.len() => Self::End,
            _ if stages[step] > stages[step - 1] => Self::SubGoal,
            _ if is_turn(step) => Self::BeforeTurn,
            _ => Self::Other,
        }
    }
}

/// The steps of `share` keyframes, ascending; all steps, if there are no more. Arguments as for [`Moment::of`].
pub fn keyframes(stages: &[u32], share: usize, is_turn: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut chosen = Vec::with_capacity(share.min(stages.len()));
    for moment in Moment::ALL {
        let steps = 0..stages.len();
        let members: Vec<usize> =
            steps.filter(|&step| Moment::of(stages, step, &is_turn) == moment).collect();
        let places = members.len().min(share - chosen.len());
        chosen.extend((0..places).map(|i| members[(2 * i + 1) * members.len() / (2 * places)]));
    }
    chosen.sort_unstable();
    chosen
}
