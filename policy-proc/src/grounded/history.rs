//! Where the agent was in the last steps, worked out backwards from where it is.

use domain::{Action, Cell, Feedback, Pose};

use super::geometry::after;
use crate::Request;

/// One past step, with the pose it was taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PastPose {
    pub(super) pose: Pose,
    pub(super) action: Option<Action>,
    pub(super) feedback: Feedback,
}

/// The last steps, oldest first, and where they led.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct History {
    pub(super) past: Vec<PastPose>,
    pub(super) here: Pose,
    /// Where the episode began, if the window reaches back to that.
    pub(super) origin: Option<Pose>,
}

impl History {
    pub(super) fn of(request: &Request<'_>) -> Self {
        let mut pose = request.pose;
        let mut past = Vec::with_capacity(request.window.len());
        for step in request.window.iter().rev() {
            pose = before(pose, step.action, step.feedback);
            past.push(PastPose { pose, action: step.action, feedback: step.feedback });
        }
        past.reverse();
        let whole = past.len() == request.step as usize;
        let first = past.first().map_or(request.pose, |first| first.pose);
        Self { past, here: request.pose, origin: whole.then_some(first) }
    }

    /// Cells stood on, oldest first, the present one last.
    pub(super) fn stood_on(&self) -> impl DoubleEndedIterator<Item = Cell> + '_ {
        self.past.iter().map(|past| past.pose).chain([self.here]).map(|pose| pose.cell)
    }

    /// How often the agent was in `pose`, not counting now.
    pub(super) fn times_in(&self, pose: Pose) -> usize {
        self.past.iter().filter(|past| past.pose == pose).count()
    }

    /// Cells that a move failed to enter.
    pub(super) fn blocked(&self) -> impl Iterator<Item = Cell> + '_ {
        self.past
            .iter()
            .filter(|past| past.feedback == Feedback::Blocked)
            .filter_map(|past| past.action.and_then(|action| after(past.pose, action)))
            .map(|pose| pose.cell)
    }
}

/// The pose from which `action`, answered with `feedback`, led to `pose`.
fn before(pose: Pose, action: Option<Action>, feedback: Feedback) -> Pose {
    let Some(action) = action else { return pose };
    match feedback {
        Feedback::Moved => {
            let back = action.move_direction().map(|direction| pose.heading.turned(direction + 2));
            let cell = back.and_then(|back| pose.cell.step(back)).unwrap_or(pose.cell);
            Pose { cell, ..pose }
        }
        Feedback::Turned => {
            let heading = pose.heading.turned(-action.turn_quarters().unwrap_or(0));
            Pose { heading, ..pose }
        }
        Feedback::Start | Feedback::Blocked | Feedback::NotUnderstood => pose,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{FrameView, PastView};

    fn pose() -> impl Strategy<Value = Pose> {
        (1..250_u8, 1..250_u8, 0..4_u8)
            .prop_map(|(x, y, heading)| Pose::new(x, y, heading.try_into().unwrap()))
    }

    proptest! {
        #[test]
        fn walking_back_ends_where_the_walk_began(
            start in pose(),
            walk in prop::collection::vec((0..7_u8, prop::bool::weighted(0.2)), 0..9),
        ) {
            let frame = FrameView { id: 1, width: 0, height: 0, pixels: &[], ..FrameView::NONE };
            let (mut at, mut window, mut past) = (start, Vec::new(), Vec::new());
            for (code, hindered) in walk {
                let action = Action::try_from(code).unwrap();
                let to = after(at, action);
                let feedback = match (action.move_direction(), to) {
                    (None, _) => Feedback::Turned,
                    (Some(_), Some(_)) if !hindered => Feedback::Moved,
                    _ => Feedback::Blocked,
                };
                past.push(PastPose { pose: at, action: Some(action), feedback });
                window.push(PastView { frame, action: Some(action), feedback });
                at = if feedback == Feedback::Blocked { at } else { to.unwrap() };
            }
            let request = Request {
                lane: 0,
                step: window.len() as u32,
                episode: 1,
                repeat: 1,
                episode_seed: 0,
                instruction: "",
                pose: at,
                feedback: Feedback::Start,
                frame,
                window: &window,
                segment: None,
                documents: &[],
                trajectories: &[],
                starts_as_demonstrated: false,
            };
            let history = History::of(&request);
            prop_assert_eq!(history.past, past);
            prop_assert_eq!(history.origin, Some(start));
            let later = Request { step: request.step + 1, ..request };
            prop_assert_eq!(History::of(&later).origin, None);
        }
    }
}
