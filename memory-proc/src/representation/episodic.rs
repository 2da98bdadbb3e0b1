//! Episodic retrieval (equation 7 of the paper): the remembered view nearest to the current one, and what the
//! expert did from there.

use shm_types::message::{FrameId, NO_ACTION, SegmentStep};
use shm_types::{Action, Pose};

use super::{Memory, Retrieved, Situation, View};
use crate::demonstrations::Demonstration;
use crate::index::{Entry, Index, Query};

/// All frames of the demonstrations, indexed by embedding, with their trajectories.
pub struct Episodic {
    trajectories: Vec<Trajectory>,
    index: Index,
    horizon: usize,
}

struct Trajectory {
    case: u32,
    number: u16,
    frames: Vec<FrameId>,
    actions: Vec<Action>,
}

impl Episodic {
    /// Indexes every step of every demonstration. `None` when `view` does not know a pose.
    pub fn build(
        demonstrations: &[Demonstration],
        horizon: usize,
        view: impl Fn(Pose) -> Option<View>,
    ) -> Option<Self> {
        let mut views = Vec::new();
        let mut trajectories = Vec::new();
        for (position, demonstration) in (0..).zip(demonstrations) {
            let mut frames = Vec::with_capacity(demonstration.poses.len());
            let states = demonstration.poses.iter().zip(&demonstration.stages);
            for (step, (&pose, &stage)) in (0..).zip(states) {
                let view = view(pose)?;
                frames.push(view.frame);
                views.push((Entry { demonstration: position, step, stage }, view));
            }
            let Demonstration { case, number, ref actions, .. } = *demonstration;
            trajectories.push(Trajectory { case, number, frames, actions: actions.clone() });
        }
        let index = Index::new(views.iter().map(|(entry, v)| (*entry, v.content, &v.embedding)));
        Some(Self { trajectories, index, horizon })
    }
}

impl Memory for Episodic {
    fn access(&self, now: &Situation<'_>) -> Option<Retrieved> {
        let query = Query { embedding: now.embedding?, stage: now.stage, elapsed: now.elapsed };
        let nearest = self.index.nearest(query)?;
        let Entry { demonstration, step, .. } = nearest.entry;
        let trajectory = &self.trajectories[usize::from(demonstration)];
        Some(Retrieved {
            segment: trajectory.segment(usize::from(step), self.horizon),
            case: trajectory.case,
            demonstration: trajectory.number,
            step,
            distance: nearest.distance,
        })
    }
}

impl Trajectory {
    /// The view at `step` and what follows: at most `horizon` actions, none past the demonstration's end.
    fn segment(&self, step: usize, horizon: usize) -> Vec<SegmentStep> {
        let end = (step + horizon).min(self.frames.len() - 1);
        let views = step..=end;
        let entry = |at: usize| SegmentStep {
            frame: self.frames[at],
            action: if at < end { self.actions[at] as u8 } else { NO_ACTION },
            reserved: [0; 7],
        };
        views.map(entry).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedding::Embedding;
    use shm_types::Heading;

    /// A straight walk north from (3, `from`) of `steps` steps; sub-goal 1 is completed at step 2.
    fn walk(number: u16, from: u8, steps: u8) -> Demonstration {
        Demonstration {
            case: 8,
            number,
            poses: (0..=steps).map(|t| Pose::new(3, from + t, Heading::N)).collect(),
            stages: (0..=steps).map(|t| u32::from(t >= 2)).collect(),
            actions: vec![Action::Forward; usize::from(steps)],
        }
    }

    /// Every cell looks different: frame and content are its row, the embedding is an angle.
    fn view(pose: Pose) -> Option<View> {
        let row = pose.cell.y;
        let angle = f32::from(row) / 40.0;
        let embedding = Embedding::normalised(&[angle.cos(), angle.sin()])?;
        Some(View { frame: u64::from(row), content: [row; 16], embedding })
    }

    fn access(memory: &Episodic, row: u8, stage: u32, elapsed: u32) -> Retrieved {
        let view = view(Pose::new(0, row, Heading::N)).unwrap();
        let now = Situation { embedding: Some(&view.embedding), stage, elapsed };
        memory.access(&now).unwrap()
    }

    #[test]
    fn a_segment_follows_the_expert_for_the_horizon_and_not_past_the_end() {
        let memory = Episodic::build(&[walk(1, 5, 9)], 6, view).unwrap();
        for (row, frames) in [(5, 5..=11), (8, 8..=14), (9, 9..=14), (14, 14..=14)] {
            let found = access(&memory, row, 0, 0);
            assert_eq!((found.case, found.demonstration, found.distance), (8, 1, 0.0));
            assert_eq!(found.step, u16::from(row) - 5);
            let expected: Vec<u64> = frames.collect();
            assert_eq!(found.segment.iter().map(|s| s.frame).collect::<Vec<_>>(), expected);
            let (last, before) = found.segment.split_last().unwrap();
            assert_eq!(last.action, NO_ACTION);
            assert!(before.iter().all(|step| step.action == Action::Forward as u8));
        }
        assert_eq!(access(&memory, 30, 0, 0).step, 9);
        assert_eq!(
            Episodic::build(&[walk(1, 5, 9)], 0, view).map(|m| access(&m, 7, 0, 0).segment.len()),
            Some(1)
        );
    }

    #[test]
    fn a_shared_view_is_told_apart_by_stage_and_then_by_elapsed_steps() {
        let demonstrations = [walk(0, 5, 9), walk(3, 7, 4)];
        let memory = Episodic::build(&demonstrations, 6, view).unwrap();
        assert_eq!(access(&memory, 8, 1, 0).demonstration, 0);
        assert_eq!(access(&memory, 8, 0, 9).demonstration, 3);
        assert_eq!(access(&memory, 9, 1, 4).demonstration, 0);
        assert_eq!(access(&memory, 9, 1, 2).demonstration, 3);
    }

    #[test]
    fn a_missing_view_is_no_memory() {
        let lacking = |pose: Pose| view(pose).filter(|_| pose.cell.y != 9);
        assert!(Episodic::build(&[walk(1, 5, 9)], 6, lacking).is_none());
    }
}
