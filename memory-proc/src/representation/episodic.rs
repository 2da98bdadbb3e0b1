//! Episodic retrieval (equation 7 of the paper): the remembered view nearest to the current one, and what the
//! expert did from there.
//!
//! Equal distances are decided by task stage, then by elapsed steps ([`crate::index`]). The stage of a view is
//! the number of sub-goals that *its own* demonstration had completed of *its own* task. In a set that mixes
//! in other tasks' histories, stages of different tasks are compared as numbers: whose history a view comes
//! from is nothing that retrieval knows.

use anyhow::bail;
use domain::{Action, Pose, SegmentContent};
use shm_types::message::{FrameId, NO_ACTION, SegmentStep};

use super::{Blueprint, Documents, Ingredients, Memory, Retrieved, Situation, Supply, Views};
use crate::demonstrations::Demonstration;
use crate::index::{Entry, Index, Query};

/// Demonstrations whose views are to be indexed.
#[derive(Debug)]
pub(super) struct Episodic {
    demonstrations: Vec<Demonstration>,
    horizon: usize,
    content: SegmentContent,
    poses: Vec<Pose>,
}

impl Episodic {
    pub(super) fn new(ingredients: Ingredients) -> Self {
        let Ingredients { demonstrations, horizon, segment: content, .. } = ingredients;
        let poses = demonstrations.iter().flat_map(|demonstration| &demonstration.poses);
        let mut poses: Vec<Pose> = poses.copied().collect();
        poses.sort_unstable();
        poses.dedup();
        Self { demonstrations, horizon, content, poses }
    }
}

impl Blueprint for Episodic {
    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn build(&self, views: &Views, _: &mut dyn Documents) -> anyhow::Result<Box<dyn Memory>> {
        let mut entries = Vec::new();
        let mut trajectories = Vec::new();
        for (position, walk) in (0..).zip(&self.demonstrations) {
            let mut frames = Vec::with_capacity(walk.poses.len());
            let states = walk.poses.iter().zip(&walk.stages);
            for (step, (&pose, &stage)) in (0..).zip(states) {
                let view = views.of(pose)?;
                let Some(embedding) = &view.embedding else {
                    bail!("episodic memory is built before the view of {pose} is embedded");
                };
                frames.push(view.frame);
                let entry = Entry { demonstration: position, step, stage };
                entries.push((entry, view.content, embedding));
            }
            let Demonstration { case, number, ref actions, .. } = *walk;
            trajectories.push(Trajectory { case, number, frames, actions: actions.clone() });
        }
        let (horizon, content) = (self.horizon, self.content);
        Ok(Box::new(Indexed { trajectories, index: Index::new(entries), horizon, content }))
    }
}

/// All frames of the demonstrations, indexed by embedding, with their trajectories.
struct Indexed {
    trajectories: Vec<Trajectory>,
    index: Index,
    horizon: usize,
    content: SegmentContent,
}

struct Trajectory {
    case: u32,
    number: u16,
    frames: Vec<FrameId>,
    actions: Vec<Action>,
}

impl Memory for Indexed {
    fn access(&self, now: &Situation<'_>) -> Supply {
        Supply { segment: self.retrieve(now), documents: Vec::new() }
    }
}

impl Indexed {
    fn retrieve(&self, now: &Situation<'_>) -> Option<Retrieved> {
        let query = Query { embedding: now.embedding?, stage: now.stage, elapsed: now.elapsed };
        let nearest = self.index.nearest(query)?;
        let Entry { demonstration, step, .. } = nearest.entry;
        let trajectory = &self.trajectories[usize::from(demonstration)];
        Some(Retrieved {
            segment: trajectory.segment(usize::from(step), self.horizon, self.content),
            case: trajectory.case,
            demonstration: trajectory.number,
            step,
            distance: nearest.distance,
        })
    }
}

impl Trajectory {
    /// The view at `step` and what follows: at most `horizon` actions, none past the demonstration's end.
    fn segment(&self, step: usize, horizon: usize, content: SegmentContent) -> Vec<SegmentStep> {
        let end = (step + horizon).min(self.frames.len() - 1);
        let action = |at: usize| match content {
            SegmentContent::Actions if at < end => self.actions[at] as u8,
            SegmentContent::Actions | SegmentContent::Images => NO_ACTION,
        };
        let entry =
            |at| SegmentStep { frame: self.frames[at], action: action(at), reserved: [0; 7] };
        (step..=end).map(entry).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Shelf, ingredients, walk};
    use super::super::{View, Views};
    use super::*;
    use crate::embedding::Embedding;
    use domain::Heading;

    /// Every cell looks different: frame and content are its row, the embedding is an angle.
    fn view(pose: Pose) -> View {
        let row = pose.cell.y;
        let angle = f32::from(row) / 40.0;
        let embedding = Embedding::normalised(&[angle.cos(), angle.sin()]);
        View { frame: u64::from(row), content: [row; 16], embedding }
    }

    fn build(blueprint: &Episodic) -> anyhow::Result<Box<dyn Memory>> {
        let mut views = Views::default();
        blueprint.poses().iter().for_each(|&pose| views.insert(pose, view(pose)));
        blueprint.build(&views, &mut Shelf::default())
    }

    fn memory(demonstrations: &[Demonstration], horizon: usize) -> Box<dyn Memory> {
        let blueprint =
            Episodic::new(Ingredients { horizon, ..ingredients(demonstrations.to_vec()) });
        build(&blueprint).unwrap()
    }

    fn access(memory: &dyn Memory, row: u8, stage: u32, elapsed: u32) -> Retrieved {
        let view = view(Pose::new(0, row, Heading::N));
        let now = Situation { embedding: view.embedding.as_ref(), stage, elapsed };
        let supply = memory.access(&now);
        assert!(supply.documents.is_empty());
        supply.segment.unwrap()
    }

    #[test]
    fn a_segment_follows_the_expert_for_the_horizon_and_not_past_the_end() {
        let memory_of = |horizon| memory(&[walk(1, 5, 9)], horizon);
        let six = memory_of(6);
        for (row, frames) in [(5, 5..=11), (8, 8..=14), (9, 9..=14), (14, 14..=14)] {
            let found = access(&*six, row, 0, 0);
            assert_eq!((found.case, found.demonstration, found.distance), (8, 1, 0.0));
            assert_eq!(found.step, u16::from(row) - 5);
            let expected: Vec<u64> = frames.collect();
            assert_eq!(found.segment.iter().map(|s| s.frame).collect::<Vec<_>>(), expected);
            let (last, before) = found.segment.split_last().unwrap();
            assert_eq!(last.action, NO_ACTION);
            assert!(before.iter().all(|step| step.action == Action::Forward as u8));
        }
        assert_eq!(access(&*six, 30, 0, 0).step, 9);
        assert_eq!(access(&*memory_of(0), 7, 0, 0).segment.len(), 1);
    }

    #[test]
    fn a_segment_of_images_alone_has_the_same_views_and_no_actions() {
        let with_actions = memory(&[walk(1, 5, 9)], 6);
        let images = Ingredients {
            segment: SegmentContent::Images,
            horizon: 6,
            ..ingredients(vec![walk(1, 5, 9)])
        };
        let images = build(&Episodic::new(images)).unwrap();
        for row in 5..=14 {
            let (with, without) = (access(&*with_actions, row, 0, 0), access(&*images, row, 0, 0));
            assert!(without.segment.iter().all(|step| step.action == NO_ACTION));
            let frames =
                |found: &Retrieved| found.segment.iter().map(|s| s.frame).collect::<Vec<_>>();
            assert_eq!(frames(&with), frames(&without));
            assert_eq!((with.step, with.distance), (without.step, without.distance));
        }
    }

    #[test]
    fn a_shared_view_is_told_apart_by_stage_and_then_by_elapsed_steps() {
        let memory = memory(&[walk(0, 5, 9), walk(3, 7, 4)], 6);
        assert_eq!(access(&*memory, 8, 1, 0).demonstration, 0);
        assert_eq!(access(&*memory, 8, 0, 9).demonstration, 3);
        assert_eq!(access(&*memory, 9, 1, 4).demonstration, 0);
        assert_eq!(access(&*memory, 9, 1, 2).demonstration, 3);
    }

    #[test]
    fn where_a_segment_of_a_mixed_set_comes_from_is_told() {
        let foreign = Demonstration { case: 41, ..walk(2, 16, 4) };
        let memory = memory(&[walk(0, 5, 9), foreign], 6);
        let source = |row| {
            let found = access(&*memory, row, 0, 0);
            (found.case, found.demonstration, found.step)
        };
        assert_eq!((source(6), source(19)), ((8, 0, 1), (41, 2, 3)));
    }

    #[test]
    fn a_missing_view_is_an_error() {
        let blueprint = Episodic::new(ingredients(vec![walk(1, 5, 9)]));
        let mut views = Views::default();
        let error = blueprint.build(&views, &mut Shelf::default()).err().unwrap().to_string();
        assert_eq!(error, "a memory uses the view of 3,5,N unasked");
        for &pose in blueprint.poses() {
            views.insert(pose, View { embedding: None, ..view(pose) });
        }
        let error = blueprint.build(&views, &mut Shelf::default()).err().unwrap().to_string();
        assert_eq!(error, "episodic memory is built before the view of 3,5,N is embedded");
    }
}
