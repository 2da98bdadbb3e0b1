//! The poses of the last steps, reconstructed from the current pose and the window.

use domain::{Action, Cell, Feedback, Pose, UnknownCode};
use peer::Request;

use super::geometry::after;

/// One past step, with the pose in which the action was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PastPose {
    pub(super) pose: Pose,
    pub(super) action: Option<Action>,
    pub(super) feedback: Feedback,
}

/// The last steps, oldest first, and the current pose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RecentSteps {
    pub(super) past: Vec<PastPose>,
    pub(super) here: Pose,
    /// The pose in which the episode started, if the window reaches back to it.
    pub(super) origin: Option<Pose>,
}

impl RecentSteps {
    /// # Errors
    /// When the request is about another world than the warehouse.
    pub(super) fn of(request: &Request<'_>) -> Result<Self, UnknownCode> {
        let here = Pose::try_from(request.state)?;
        let mut pose = here;
        let mut past = Vec::with_capacity(request.window.len());
        for step in request.window.iter().rev() {
            let action = step.action.map(Action::try_from).transpose()?;
            let feedback = Feedback::try_from(step.feedback)?;
            pose = before(pose, action, feedback);
            past.push(PastPose { pose, action, feedback });
        }
        past.reverse();
        let is_complete = past.len() == request.step as usize;
        Ok(Self { past, here, origin: is_complete.then_some(pose) })
    }

    /// The cells occupied so far, oldest first, ending with the current one.
    pub(super) fn cells(&self) -> impl DoubleEndedIterator<Item = Cell> + '_ {
        self.past.iter().map(|past| past.pose.cell).chain([self.here.cell])
    }

    /// How many past steps started in `pose`.
    pub(super) fn times_in(&self, pose: Pose) -> usize {
        self.past.iter().filter(|past| past.pose == pose).count()
    }

    /// Cells that a move failed to enter.
    pub(super) fn blocked_cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let blocked = self.past.iter().filter(|past| past.feedback == Feedback::Blocked);
        blocked.filter_map(|past| Some(after(past.pose, past.action?)?.cell))
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
    use std::sync::Arc;

    use conformance::messages::scripted_world;
    use peer::{FrameView, PastView};
    use proptest::prelude::*;

    use super::*;

    fn pose() -> impl Strategy<Value = Pose> {
        (1..250_u8, 1..250_u8, 0..4_u8)
            .prop_map(|(x, y, heading)| Pose::new(x, y, heading.try_into().unwrap()))
    }

    proptest! {
        #[test]
        fn past_poses_are_reconstructed(
            start in pose(),
            walk in prop::collection::vec((0..7_u8, prop::bool::weighted(0.2)), 0..9),
        ) {
            let frame = FrameView::NONE;
            let (mut at, mut window, mut past) = (start, Vec::new(), Vec::new());
            for (code, blocked) in walk {
                let action = Action::try_from(code).unwrap();
                let to = after(at, action);
                let feedback = match (action.move_direction(), to) {
                    (None, _) => Feedback::Turned,
                    (Some(_), Some(_)) if !blocked => Feedback::Moved,
                    _ => Feedback::Blocked,
                };
                past.push(PastPose { pose: at, action: Some(action), feedback });
                let (taken, told) = (Some(action.into()), feedback.into());
                window.push(PastView { frame, action: taken, feedback: told });
                at = if feedback == Feedback::Blocked { at } else { to.unwrap() };
            }
            let request = Request {
                lane: 0,
                step: window.len() as u32,
                episode: 1,
                repeat: 1,
                episode_seed: 0,
                instruction: "",
                state: at.into(),
                feedback: Feedback::Start.into(),
                frame,
                window: &window,
                items: &[],
                starts_as_demonstrated: false,
                demonstrated_elsewhere: false,
                world: &Arc::new(scripted_world()),
            };
            let recent = RecentSteps::of(&request).unwrap();
            prop_assert_eq!(recent.past, past);
            prop_assert_eq!(recent.origin, Some(start));
            let later = Request { step: request.step + 1, ..request };
            prop_assert_eq!(RecentSteps::of(&later).unwrap().origin, None);
        }
    }
}
