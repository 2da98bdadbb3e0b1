//! Episodic retrieval (equation 7 of the paper): the remembered view nearest to the current one, and what the expert did
//! from there.
//!
//! Equal distances are ordered by task stage, then by elapsed steps ([`search::Index`]). The stage of a view is the number
//! of sub-goals that *its own* demonstration had completed of *its own* task. In a set that mixes in histories of other
//! tasks, stages of different tasks are compared as numbers: retrieval does not know whose history a view comes from.

use anyhow::bail;
use domain::SegmentContent;
use domain::{Action, Pose};
use shm_types::message::{FrameId, NO_ACTION, SegmentStep};

use super::{
    DocumentSupplier, Memory, MemoryBuilder, MemorySpec, RecallQuery, RecalledItems,
    RetrievedSegment, StoredViews,
};
use crate::demonstrations::Demonstration;
use search::{Index, Query, ViewEntry};

/// Builds an index of the demonstrations' views.
#[derive(Debug)]
pub(super) struct Episodic {
    demonstrations: Vec<Demonstration>,
    horizon: usize,
    content: SegmentContent,
    poses: Vec<Pose>,
}

impl Episodic {
    pub(super) fn new(spec: MemorySpec) -> Self {
        let MemorySpec { demonstrations, horizon, segment: content, .. } = spec;
        let poses = demonstrations.iter().flat_map(|demonstration| &demonstration.poses);
        let mut poses: Vec<Pose> = poses.copied().collect();
        poses.sort_unstable();
        poses.dedup();
        Self { demonstrations, horizon, content, poses }
    }
}

impl MemoryBuilder for Episodic {
    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn build(
        &self,
        views: &StoredViews,
        _: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Box<dyn Memory>> {
        let mut entries = Vec::new();
        let mut trajectories = Vec::new();
        for (position, demonstration) in (0..).zip(&self.demonstrations) {
            let mut frames = Vec::with_capacity(demonstration.poses.len());
            let states = demonstration.poses.iter().zip(&demonstration.stages);
            for (step, (&pose, &stage)) in (0..).zip(states) {
                let view = views.of(pose)?;
                let Some(embedding) = &view.embedding else {
                    bail!("the view of {pose} has not been embedded");
                };
                frames.push(view.frame);
                let entry = ViewEntry { demonstration: position, step, stage };
                entries.push((entry, view.content, embedding));
            }
            let Demonstration { case, number, ref actions, .. } = *demonstration;
            trajectories.push(IndexedTrajectory { case, number, frames, actions: actions.clone() });
        }
        let (horizon, content) = (self.horizon, self.content);
        Ok(Box::new(Indexed { trajectories, index: Index::new(entries), horizon, content }))
    }
}

/// The demonstrations' views, indexed by embedding, and their trajectories.
struct Indexed {
    trajectories: Vec<IndexedTrajectory>,
    index: Index,
    horizon: usize,
    content: SegmentContent,
}

struct IndexedTrajectory {
    case: u32,
    number: u16,
    frames: Vec<FrameId>,
    actions: Vec<Action>,
}

impl Memory for Indexed {
    fn recall(&self, now: &RecallQuery<'_>) -> RecalledItems {
        RecalledItems { segment: self.retrieve(now), documents: Vec::new() }
    }
}

impl Indexed {
    fn retrieve(&self, now: &RecallQuery<'_>) -> Option<RetrievedSegment> {
        let query = Query { embedding: now.embedding?, stage: now.stage, elapsed: now.elapsed };
        let nearest = self.index.nearest(query)?;
        let ViewEntry { demonstration, step, .. } = nearest.entry;
        let trajectory = &self.trajectories[usize::from(demonstration)];
        Some(RetrievedSegment {
            segment: trajectory.segment(usize::from(step), self.horizon, self.content),
            case: trajectory.case,
            demonstration: trajectory.number,
            step,
            distance: nearest.distance,
        })
    }
}

impl IndexedTrajectory {
    /// The view at `step` and at most `horizon` actions from there, with the views that they lead to.
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
    use super::super::testing::{TestDocuments, demonstration, spec};
    use super::super::{StoredView, StoredViews};
    use super::*;
    use domain::Heading;
    use search::Embedding;

    /// Every cell has another view: frame and content are its row, the embedding is an angle.
    fn view(pose: Pose) -> StoredView {
        let row = pose.cell.y;
        let angle = f32::from(row) / 40.0;
        let embedding = Embedding::normalised(&[angle.cos(), angle.sin()]);
        StoredView { frame: u64::from(row), content: [row; 16], embedding }
    }

    fn build(builder: &Episodic) -> anyhow::Result<Box<dyn Memory>> {
        let mut views = StoredViews::default();
        builder.poses().iter().for_each(|&pose| views.insert(pose, view(pose)));
        builder.build(&views, &mut TestDocuments::default())
    }

    fn memory(demonstrations: &[Demonstration], horizon: usize) -> Box<dyn Memory> {
        let builder = Episodic::new(MemorySpec { horizon, ..spec(demonstrations.to_vec()) });
        build(&builder).unwrap()
    }

    fn recall(memory: &dyn Memory, row: u8, stage: u32, elapsed: u32) -> RetrievedSegment {
        let view = view(Pose::new(0, row, Heading::N));
        let now = RecallQuery { embedding: view.embedding.as_ref(), stage, elapsed };
        let supply = memory.recall(&now);
        assert!(supply.documents.is_empty());
        supply.segment.unwrap()
    }

    #[test]
    fn a_segment_follows_the_expert_for_the_horizon_and_not_past_the_end() {
        let memory_of = |horizon| memory(&[demonstration(1, 5, 9)], horizon);
        let six = memory_of(6);
        for (row, frames) in [(5, 5..=11), (8, 8..=14), (9, 9..=14), (14, 14..=14)] {
            let found = recall(&*six, row, 0, 0);
            assert_eq!((found.case, found.demonstration, found.distance), (8, 1, 0.0));
            assert_eq!(found.step, u16::from(row) - 5);
            let expected: Vec<u64> = frames.collect();
            assert_eq!(found.segment.iter().map(|s| s.frame).collect::<Vec<_>>(), expected);
            let (last, before) = found.segment.split_last().unwrap();
            assert_eq!(last.action, NO_ACTION);
            assert!(before.iter().all(|step| step.action == Action::Forward as u8));
        }
        assert_eq!(recall(&*six, 30, 0, 0).step, 9);
        assert_eq!(recall(&*memory_of(0), 7, 0, 0).segment.len(), 1);
    }

    #[test]
    fn a_segment_of_images_alone_has_the_same_views_and_no_actions() {
        let with_actions = memory(&[demonstration(1, 5, 9)], 6);
        let images = MemorySpec {
            segment: SegmentContent::Images,
            horizon: 6,
            ..spec(vec![demonstration(1, 5, 9)])
        };
        let images = build(&Episodic::new(images)).unwrap();
        for row in 5..=14 {
            let (with, without) = (recall(&*with_actions, row, 0, 0), recall(&*images, row, 0, 0));
            assert!(without.segment.iter().all(|step| step.action == NO_ACTION));
            let frames = |found: &RetrievedSegment| {
                found.segment.iter().map(|s| s.frame).collect::<Vec<_>>()
            };
            assert_eq!(frames(&with), frames(&without));
            assert_eq!((with.step, with.distance), (without.step, without.distance));
        }
    }

    #[test]
    fn equal_views_are_ordered_by_stage_and_then_by_elapsed_steps() {
        let memory = memory(&[demonstration(0, 5, 9), demonstration(3, 7, 4)], 6);
        assert_eq!(recall(&*memory, 8, 1, 0).demonstration, 0);
        assert_eq!(recall(&*memory, 8, 0, 9).demonstration, 3);
        assert_eq!(recall(&*memory, 9, 1, 4).demonstration, 0);
        assert_eq!(recall(&*memory, 9, 1, 2).demonstration, 3);
    }

    #[test]
    fn a_segment_of_a_mixed_set_names_its_origin() {
        let foreign = Demonstration { case: 41, ..demonstration(2, 16, 4) };
        let memory = memory(&[demonstration(0, 5, 9), foreign], 6);
        let source = |row| {
            let found = recall(&*memory, row, 0, 0);
            (found.case, found.demonstration, found.step)
        };
        assert_eq!((source(6), source(19)), ((8, 0, 1), (41, 2, 3)));
    }

    #[test]
    fn a_missing_view_is_an_error() {
        let builder = Episodic::new(spec(vec![demonstration(1, 5, 9)]));
        let mut views = StoredViews::default();
        let error = builder.build(&views, &mut TestDocuments::default()).err().unwrap().to_string();
        assert_eq!(error, "the memory did not request the view of 3,5,N");
        for &pose in builder.poses() {
            views.insert(pose, StoredView { embedding: None, ..view(pose) });
        }
        let error = builder.build(&views, &mut TestDocuments::default()).err().unwrap().to_string();
        assert_eq!(error, "the view of 3,5,N has not been embedded");
    }
}
