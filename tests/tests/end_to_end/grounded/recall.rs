//! What memory supplies: demonstrations with keyframes, and the segment after the nearest view.

use std::sync::Arc;

use domain::Action;
use peer::StepView;
use warehouse::{Case, TrajectoryKind, Variant, Warehouse};

use super::views::{Image, Views};

/// Actions after a retrieved view, and keyframes of all demonstrations together (specification, section 5).
const HORIZON: usize = 6;
const KEYFRAMES: usize = 40;

/// One step of a demonstration: the view, the expert's action, and the sub-goals completed.
pub(crate) struct DemonstrationStep {
    image: Arc<Image>,
    action: Option<Action>,
    stage: u32,
    is_keyframe: bool,
}

/// A demonstration from start to end.
pub(crate) type Demonstration = Vec<DemonstrationStep>;

/// The demonstrations of `case` of these `kinds`.
pub(crate) fn demonstrations(
    warehouse: &Warehouse,
    views: &mut Views,
    case: &Case,
    kinds: &[TrajectoryKind],
) -> Vec<Demonstration> {
    let record = |&kind: &TrajectoryKind| {
        let replay = case.replay(warehouse, kind);
        let actions = &case.trajectory(kind).actions;
        let keyframes = keyframes(actions, &replay.goal_steps, KEYFRAMES / kinds.len());
        let steps = replay.poses.iter().zip(&replay.stages).enumerate();
        let step = |(at, (&pose, &stage))| DemonstrationStep {
            image: views.of(pose, &Variant::UNCHANGED),
            action: actions.get(at).copied(),
            stage,
            is_keyframe: keyframes.contains(&at),
        };
        steps.map(step).collect()
    };
    kinds.iter().map(record).collect()
}

/// Start, sub-goal completions, end, moments before turns, then evenly sampled.
fn keyframes(actions: &[Action], goal_steps: &[u32], budget: usize) -> Vec<usize> {
    let mut keyframes = vec![0];
    keyframes.extend(goal_steps.iter().map(|&step| step as usize));
    keyframes.push(actions.len());
    let is_turn = |&at: &usize| actions[at].turn_quarters().is_some();
    keyframes.extend((0..actions.len()).filter(is_turn));
    keyframes.truncate(budget);
    let left = budget.saturating_sub(keyframes.len());
    keyframes.extend((1..=left).map(|i| i * actions.len() / (left + 1)));
    keyframes
}

/// A demonstration as full-context memory supplies it.
pub(crate) fn trajectory(demonstration: &Demonstration) -> Vec<StepView<'_>> {
    let view = |step: &'_ DemonstrationStep| step.is_keyframe;
    let steps = demonstration.iter();
    steps
        .map(|step| StepView {
            frame: view(step).then(|| step.image.frame()),
            action: step.action.map(Into::into),
        })
        .collect()
}

/// The task stage of an agent, as memory knows it: that of the view supplied last, or the next one if the agent did there what the
/// expert did.
#[derive(Default)]
pub(crate) struct KnownStage {
    supplied: u32,
    action: Option<Action>,
    next: u32,
}

impl KnownStage {
    fn after(&self, action: Option<Action>) -> u32 {
        if action.is_some() && action == self.action { self.next } else { self.supplied }
    }
}

/// The nearest demonstrated view and the steps after it, for an agent that has taken `taken` steps, the last with `action`; ties by
/// task stage, then by elapsed steps.
pub(crate) fn retrieve<'a>(
    memory: &'a [Demonstration],
    image: &Image,
    known: &mut KnownStage,
    (taken, action): (u32, Option<Action>),
    with_actions: bool,
) -> Option<(f32, Vec<StepView<'a>>)> {
    let stage = known.after(action);
    let views = memory.iter().flat_map(|demonstration| demonstration.iter().enumerate());
    let nearest = |(at, view): &(usize, &DemonstrationStep)| {
        let elapsed = (*at as u32).abs_diff(taken);
        // The bits of a number that is not negative have its order.
        (image.distance(&view.image).to_bits(), stage.abs_diff(view.stage), elapsed)
    };
    let least = views.map(|view| nearest(&view)).min()?;
    let (from, at) = memory.iter().find_map(|demonstration| {
        let mut steps = demonstration.iter().enumerate();
        steps.find(|step| nearest(step) == least).map(|(at, _)| (demonstration, at))
    })?;
    let next = from[(at + 1).min(from.len() - 1)].stage;
    *known = KnownStage { supplied: from[at].stage, action: from[at].action, next };
    let end = (at + HORIZON).min(from.len() - 1);
    let view = |i: usize| StepView {
        frame: Some(from[i].image.frame()),
        action: from[i].action.filter(|_| i < end && with_actions).map(Into::into),
    };
    Some((if least.0 == 0 { 0.0 } else { 1.0 }, (at..=end).map(view).collect()))
}
