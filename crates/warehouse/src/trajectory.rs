//! A trajectory, and its replay with the world's dynamics.

use domain::{Action, Feedback, Pose};

use crate::dynamics::{Variant, step};
use crate::progress::Progress;
use crate::task::Task;
use crate::world::Warehouse;

/// A start pose and a list of actions. Everything else follows by replay.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Trajectory {
    /// The first pose.
    pub start: Pose,
    /// The actions, in order.
    pub actions: Vec<Action>,
}

/// A replayed trajectory. Index 0 of each list is the start, index `t` the state after action `t`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Replay {
    /// Poses.
    pub poses: Vec<Pose>,
    /// Feedback; [`Feedback::Start`] first.
    pub feedback: Vec<Feedback>,
    /// Sub-goals completed so far.
    pub stages: Vec<u32>,
    /// The steps at which sub-goals were completed, in order.
    pub goal_steps: Vec<u32>,
    /// Steps until the task was complete, `l_i` of a reference; `None` if it never was. A final turn towards the rack comes
    /// after that and does not count.
    pub length: Option<u32>,
}

impl Trajectory {
    /// Replays the trajectory with the world's dynamics and scores it for `task`.
    pub fn replay(&self, warehouse: &Warehouse, task: &Task, variant: &Variant) -> Replay {
        let mut progress = Progress::new(warehouse, task, self.start.cell);
        let mut replay = Replay {
            poses: vec![self.start],
            feedback: vec![Feedback::Start],
            stages: vec![progress.stage()],
            goal_steps: vec![0; progress.stage() as usize],
            length: progress.is_complete().then_some(0),
        };
        let mut pose = self.start;
        for (taken, &action) in (1..).zip(&self.actions) {
            let feedback;
            (pose, feedback) = step(&warehouse.layout, variant, pose, action);
            let met = progress.visit(pose.cell);
            replay.poses.push(pose);
            replay.feedback.push(feedback);
            replay.stages.push(progress.stage());
            replay.goal_steps.extend((0..met).map(|_| taken));
            if met > 0 && progress.is_complete() {
                replay.length = Some(taken);
            }
        }
        replay
    }
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;
    use crate::testing::{BLUE_BARREL, RED_BARREL, cells, tiny};

    #[test]
    fn a_replay_lists_poses_feedback_and_when_each_sub_goal_was_met() {
        let warehouse = tiny();
        let task = Task::InOrder { a: BLUE_BARREL, b: RED_BARREL };
        let actions = "fRUffrfL".chars().filter_map(Action::from_letter).collect();
        let trajectory = Trajectory { start: Pose::new(1, 3, Heading::W), actions };
        let replay = trajectory.replay(&warehouse, &task, &Variant::UNCHANGED);
        use Feedback::{Blocked, Moved, Start, Turned};
        assert_eq!(
            replay.feedback,
            [Start, Moved, Turned, Turned, Moved, Moved, Blocked, Blocked, Turned]
        );
        assert_eq!(replay.poses[5], Pose::new(0, 1, Heading::S));
        assert_eq!(replay.poses.last(), Some(&Pose::new(0, 1, Heading::E)));
        assert_eq!(replay.stages, [0, 1, 1, 1, 1, 1, 1, 1, 1]);
        assert_eq!((replay.goal_steps, replay.length), (vec![1], None));

        let there =
            Trajectory { start: Pose::new(1, 3, Heading::E), actions: vec![Action::Backward; 1] };
        let on =
            there.actions.iter().copied().chain([Action::Forward; 4]).chain([Action::TurnLeft]);
        let there = Trajectory { actions: on.collect(), ..there };
        let replay = there.replay(&warehouse, &task, &Variant::UNCHANGED);
        // The step beyond the last sub-goal and the last turn do not count.
        assert_eq!((replay.goal_steps, replay.length), (vec![1, 4], Some(4)));
        let closed = Variant::closing(cells(&[(2, 3)]));
        assert_eq!(there.replay(&warehouse, &task, &closed).length, None);
    }
}
