//! Where the agent was during an episode, from its record alone.

use std::collections::BTreeSet;

use domain::{Action, Feedback, Pose};

use super::{EpisodeRecord, StreamRecord};

impl EpisodeRecord {
    /// The pose at the start and after each step, with the feedback.
    ///
    /// The record says which moves were blocked, so no map is needed.
    pub fn replay(&self) -> Vec<(Pose, Feedback)> {
        let blocked: BTreeSet<u32> = self.blocked_moves.iter().copied().collect();
        let mut pose = self.start_pose;
        let mut visited = vec![(pose, Feedback::Start)];
        for (step, letter) in (1..).zip(self.actions.chars()) {
            let feedback = match Action::from_letter(letter) {
                None => Feedback::NotUnderstood,
                Some(_) if blocked.contains(&step) => Feedback::Blocked,
                Some(action) => apply(&mut pose, action),
            };
            visited.push((pose, feedback));
        }
        visited
    }

    /// The poses of [`EpisodeRecord::replay`].
    pub fn poses(&self) -> Vec<Pose> {
        self.replay().into_iter().map(|(pose, _)| pose).collect()
    }
}

impl StreamRecord {
    /// The poses of the reference of an episode that begins at `start`. Empty if the record does not have its actions.
    pub fn reference_poses(&self, start: Pose) -> Vec<Pose> {
        let mut pose = start;
        let actions = self.reference_actions.chars().filter_map(Action::from_letter);
        let visited = actions.map(|action| {
            apply(&mut pose, action);
            pose
        });
        let mut poses: Vec<Pose> = visited.collect();
        if !poses.is_empty() {
            poses.insert(0, start);
        }
        poses
    }
}

/// Applies an action that is not blocked.
fn apply(pose: &mut Pose, action: Action) -> Feedback {
    match action.move_direction() {
        Some(direction) => {
            pose.cell = pose.cell.step(pose.heading.turned(direction)).unwrap_or(pose.cell);
            Feedback::Moved
        }
        None => {
            pose.heading = pose.heading.turned(action.turn_quarters().unwrap_or(0));
            Feedback::Turned
        }
    }
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use crate::records::record;

    use super::*;

    #[test]
    fn an_episode_is_replayed_from_its_record() {
        let mut record = record("a", true);
        record.start_pose = Pose::new(5, 0, Heading::N);
        record.actions = "fRf?lbU".to_owned();
        record.blocked_moves = vec![3];
        let replayed = record.replay();
        let shown: Vec<String> = replayed.iter().map(|(pose, _)| pose.to_string()).collect();
        insta::assert_snapshot!(shown.join(" "), @"5,0,N 5,1,N 5,1,E 5,1,E 5,1,E 5,2,E 4,2,E 4,2,W");
        use Feedback::{Blocked, Moved, NotUnderstood, Start, Turned};
        let feedback: Vec<Feedback> = replayed.iter().map(|(_, feedback)| *feedback).collect();
        assert_eq!(feedback, [Start, Moved, Turned, Blocked, NotUnderstood, Moved, Moved, Turned]);
    }
}
