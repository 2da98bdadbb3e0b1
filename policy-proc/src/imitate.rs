//! The imitating policy: a scripted stand-in for a model in any world. It needs no network, no key and no knowledge of the world.
//!
//! It does what memory proposes, or what the expert did:
//!
//! 1. where memory supplies a plan, its first action;
//! 2. where memory supplies a retrieved segment, the expert's action at its first step, of the first segment that has one;
//! 3. where memory supplies whole demonstrations, the expert's action at the step that shows the same picture as the current
//!    view; or, if the pictures of the last steps were those of a demonstration, what comes next in it;
//! 4. otherwise, and where that action has just changed nothing, one of the world's actions, drawn by seed and step.
//!
//! It reads no texts. Its results show that a world works and what can be had by imitation; they say nothing about any model.

use domain::ActionCode;
use peer::{Decision, FrameView, Policy, Request, StepsView};

use crate::random::draw;

/// The imitating policy. It keeps no state: it decides from each request alone.
#[derive(Debug, Clone, Copy, Default)]
pub struct Imitate;

impl Policy for Imitate {
    fn name(&self) -> &str {
        "imitate"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("stand_in", "true".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let decide = |request: &Request<'_>| {
            let explored = || draw(request.world.actions.len(), request.episode_seed, request.step);
            let imitated = imitated(request).filter(|action| !changes_nothing(request, *action));
            Decision::act(request, imitated.unwrap_or_else(explored))
        };
        batch.iter().map(decide).collect()
    }
}

/// What memory proposes, or what the expert did where the agent is, as far as memory shows it.
fn imitated(request: &Request<'_>) -> Option<ActionCode> {
    if let Some(planned) = request.plans().find_map(|plan| plan.actions().next()) {
        return Some(planned);
    }
    let retrieved = request.segments().find_map(|segment| segment.steps.first()?.action);
    retrieved.or_else(|| request.trajectories().find_map(|whole| continued(request, &whole)))
}

/// What comes next in a whole demonstration: after the latest of its pictures that the agent has seen, and the actions since, if
/// those are the expert's.
fn continued(request: &Request<'_>, whole: &StepsView<'_>) -> Option<ActionCode> {
    // The current view, then those before it, each with the number of steps since.
    let seen = std::iter::once(request.frame);
    let seen = seen.chain(request.window.iter().rev().map(|past| past.frame));
    seen.enumerate().find_map(|(since, view)| {
        let at = whole.steps.iter().position(|step| is_same(step.frame, view))?;
        let taken = &request.window[request.window.len() - since..];
        let expert = whole.steps.get(at..at + since)?;
        let follows = taken.iter().zip(expert).all(|(past, step)| past.action == step.action);
        whole.steps.get(at + since)?.action.filter(|_| follows)
    })
}

/// Whether a remembered view shows the same picture as one that the agent sees.
fn is_same(remembered: Option<FrameView<'_>>, seen: FrameView<'_>) -> bool {
    remembered.is_some_and(|view| view.content_hash == seen.content_hash)
}

/// Whether the agent has just taken this action, and sees what it saw before.
fn changes_nothing(request: &Request<'_>, action: ActionCode) -> bool {
    request.window.last().is_some_and(|past| {
        past.action == Some(action) && past.frame.content_hash == request.frame.content_hash
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use conformance::messages::scripted_world;
    use peer::{FeedbackCode, Item, PastView, PlanView, PlannedActions, State, StepView};

    use super::*;

    /// A view that shows picture `number`.
    fn view(number: u8) -> FrameView<'static> {
        FrameView { content_hash: [number; 16], ..FrameView::NONE }
    }

    fn step(picture: Option<u8>, action: Option<u8>) -> StepView<'static> {
        StepView { frame: picture.map(view), action: action.map(ActionCode) }
    }

    /// What it does when it sees `picture`, after `past` pictures and actions, with these items.
    fn decided(picture: u8, past: &[(u8, u8)], items: &[Item<'_>]) -> u8 {
        let window: Vec<PastView<'_>> = past
            .iter()
            .map(|&(picture, action)| PastView {
                frame: view(picture),
                action: Some(ActionCode(action)),
                feedback: FeedbackCode(1),
            })
            .collect();
        let world = Arc::new(scripted_world());
        let request = Request {
            lane: 0,
            step: 40,
            episode: 1,
            episode_seed: 7,
            repeat: 1,
            instruction: "",
            state: State::default(),
            feedback: FeedbackCode::START,
            frame: view(picture),
            window: &window,
            items,
            starts_as_demonstrated: false,
            demonstrated_elsewhere: false,
            world: &world,
        };
        Imitate.act(&[request])[0].answer.action().unwrap().0
    }

    #[test]
    fn it_does_what_the_expert_did_and_explores_otherwise() {
        let explored = draw(7, 7, 40).0;
        let taken = (0..7).filter(|action| *action != explored).collect::<Vec<u8>>();
        let [one, two, three] = [taken[0], taken[1], taken[2]];
        assert_eq!(decided(9, &[], &[]), explored);
        let segment = [step(Some(3), Some(one)), step(Some(4), Some(two))];
        let segment =
            StepsView { distance: Some(0.1), is_whole: false, instruction: "", steps: &segment };
        let whole = [
            step(Some(1), Some(one)),
            step(None, Some(two)),
            step(None, Some(three)),
            step(Some(2), None),
        ];
        let whole = StepsView { distance: None, is_whole: true, instruction: "", steps: &whole };
        let own = PlannedActions { instruction: None, actions: &[ActionCode(two)] };
        let of_expert = PlannedActions { instruction: Some(""), actions: &[ActionCode(one)] };
        let parts = [own, of_expert];
        let planned = [Item::Steps(segment), Item::Plan(PlanView { parts: &parts })];
        let (segment, whole) = ([Item::Steps(segment)], [Item::Steps(whole)]);
        assert_eq!(decided(9, &[], &segment), one, "at the first step of what was retrieved");
        assert_eq!(decided(9, &[(9, one)], &segment), explored, "it changed nothing");
        assert_eq!(decided(9, &[], &planned), two, "the first action of the plan");
        assert_eq!(
            decided(9, &[(9, two)], &planned),
            explored,
            "the plan's action changed nothing"
        );
        assert_eq!(decided(1, &[], &whole), one, "the picture of the first step");
        assert_eq!(decided(9, &[(1, one)], &whole), two, "a step after it");
        assert_eq!(decided(8, &[(1, one), (9, two)], &whole), three);
        assert_eq!(decided(9, &[(1, two)], &whole), explored, "the agent went another way");
        assert_eq!(decided(2, &[], &whole), explored, "the end");
    }
}
