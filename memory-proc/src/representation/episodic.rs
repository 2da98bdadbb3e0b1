//! Episodic retrieval (equation 7 of the paper): the remembered views nearest to the current one, and what the expert did
//! from there.
//!
//! Equal distances are ordered by task stage, then by elapsed steps ([`search::Index`]). The stage of a view is the number
//! of sub-goals that *its own* demonstration had completed of *its own* task, and the stage of the agent, whose progress is not
//! told, that of the view that was supplied to it last, or of the next one if it did what the expert did. In a set that mixes in histories of other tasks, stages of different
//! tasks are compared as numbers: retrieval does not know whose history a view comes from.

use std::sync::Arc;

use domain::{ActionCode, SegmentContent};
use peer::memory::{Demonstration, Memory, MemoryError, MemoryItem, Query, Source, Views};
use search::{Index, IndexBuilder, Neighbour, ViewEntry};

use super::{KnownStages, MemorySettings, SuppliedStage, dimension};
use crate::bank::Embeddings;

/// An index of the demonstrations' views.
#[derive(Debug)]
pub(super) struct Episodic {
    horizon: u32,
    content: SegmentContent,
    hits: usize,
    index: Option<Index>,
    stages: KnownStages,
    /// The stage and the action of each step of each demonstration.
    demonstrations: Vec<Vec<(u32, Option<ActionCode>)>>,
    /// Until the index is built.
    embeddings: Arc<Embeddings>,
}

impl Episodic {
    pub(super) fn new(settings: &MemorySettings) -> Self {
        let &MemorySettings { horizon, segment: content, hits, .. } = settings;
        let embeddings = settings.embeddings.clone();
        let stages = KnownStages::default();
        let demonstrations = Vec::new();
        Self { horizon, content, hits, index: None, stages, demonstrations, embeddings }
    }

    /// The view at `entry`, and at most `horizon` actions from there, with the views that they lead to.
    fn segment(&self, Neighbour { entry, distance }: Neighbour) -> MemoryItem {
        let first = u32::from(entry.step);
        let length = self.demonstrations[usize::from(entry.demonstration)].len() as u32;
        let count = (self.horizon + 1).min(length - first);
        let demonstration = entry.demonstration.into();
        MemoryItem::Steps {
            source: Source { demonstration, first, count },
            views: Views::All,
            actions: self.content == SegmentContent::Actions,
            distance: Some(distance),
        }
    }
}

impl Memory for Episodic {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        let embeddings = std::mem::take(&mut self.embeddings);
        let mut index = IndexBuilder::with_capacity(dimension(&embeddings), embeddings.len());
        for (number, of) in (0..).zip(demonstrations) {
            for (at, (step, &stage)) in of.steps.iter().zip(of.stages).enumerate() {
                let embedding = embeddings.get(&step.content_hash).ok_or_else(|| {
                    MemoryError::new(format_args!(
                        "the view of {} has not been embedded",
                        step.state
                    ))
                })?;
                let entry = ViewEntry { demonstration: number, step: at as u16, stage };
                index.add(entry, step.content_hash, embedding.as_slice());
            }
            let steps = of.stages.iter().zip(of.steps);
            self.demonstrations.push(steps.map(|(&stage, step)| (stage, step.action)).collect());
        }
        self.index = Some(index.build());
        Ok(())
    }

    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let (Some(index), Some(embedding)) = (&self.index, query.now.embedding) else {
            return Err(MemoryError::new("the current view has not been embedded"));
        };
        let (stage, elapsed) = (self.stages.of(&query.now), query.now.step);
        let asked = search::SearchQuery { embedding, stage, elapsed };
        let nearest: Vec<Neighbour> = match self.hits {
            1 => index.nearest(asked).into_iter().collect(),
            hits => index.nearest_of_many(&[asked], hits).pop().unwrap_or_default(),
        };
        if let Some(Neighbour { entry, .. }) = nearest.first() {
            let steps = &self.demonstrations[usize::from(entry.demonstration)];
            let (stage, action) = steps[usize::from(entry.step)];
            let next = steps.get(usize::from(entry.step) + 1).map_or(stage, |next| next.0);
            self.stages.supplied(&query.now, SuppliedStage { stage, action, next });
        }
        Ok(nearest.into_iter().map(|found| self.segment(found)).collect())
    }

    fn store_bytes(&self) -> Option<u64> {
        self.index.as_ref().map(|index| index.bytes() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{build, build_with_views, demonstration, recall, settings};
    use super::*;
    use crate::bank::KnownView;
    use crate::demonstrations::RememberedDemonstration;
    use domain::{Heading, Pose};
    use search::Embedding;

    /// Every cell has another view: frame and content are its row, the embedding is an angle.
    fn view(pose: Pose) -> KnownView {
        let row = pose.cell.y;
        let angle = f32::from(row) / 40.0;
        let embedding = Embedding::normalised(&[angle.cos(), angle.sin()]);
        KnownView { frame: row.into(), content: [row; 16], embedding }
    }

    fn memory(demonstrations: &[RememberedDemonstration], settings: &MemorySettings) -> Episodic {
        build_with_views(Episodic::new, settings, demonstrations, view)
    }

    /// Demonstration, first step, number of steps and distance of each hit.
    fn hits(memory: &mut Episodic, row: u8, elapsed: u32) -> Vec<(u32, u32, u32, f32)> {
        let view = view(Pose::new(0, row, Heading::N));
        let embedding = view.embedding.as_ref().map(Embedding::as_slice);
        let items = recall(memory, embedding, elapsed).unwrap();
        let hit = |item| match item {
            MemoryItem::Steps { source, views: Views::All, distance: Some(distance), .. } => {
                (source.demonstration, source.first, source.count, distance)
            }
            other => panic!("{other:?}"),
        };
        items.into_iter().map(hit).collect()
    }

    #[test]
    fn a_segment_follows_the_expert_for_the_horizon_and_not_past_the_end() {
        let memory_of =
            |horizon| memory(&[demonstration(1, 5, 9)], &MemorySettings { horizon, ..settings() });
        let mut six = memory_of(6);
        for (row, steps) in [(5, 7), (8, 7), (9, 6), (14, 1)] {
            assert_eq!(hits(&mut six, row, 0), [(0, u32::from(row) - 5, steps, 0.0)]);
        }
        assert_eq!(hits(&mut six, 30, 0)[0].1, 9);
        assert_eq!(hits(&mut memory_of(0), 7, 0)[0].2, 1);
    }

    #[test]
    fn only_a_segment_with_actions_has_actions() {
        for segment in [SegmentContent::Actions, SegmentContent::Images] {
            let settings = MemorySettings { segment, ..settings() };
            let mut memory = memory(&[demonstration(1, 5, 9)], &settings);
            let items = recall(&mut memory, Some(&[1.0, 0.0]), 0).unwrap();
            let [MemoryItem::Steps { actions, .. }] = items[..] else { panic!("{items:?}") };
            assert_eq!(actions, segment == SegmentContent::Actions);
        }
    }

    #[test]
    fn equal_views_are_ordered_by_stage_and_then_by_elapsed_steps() {
        let both = [demonstration(0, 5, 9), demonstration(3, 7, 4)];
        let mut memory = memory(&both, &settings());
        let mut first = |row, elapsed| hits(&mut memory, row, elapsed)[0].0;
        assert_eq!(first(8, 3), 1, "of stage 0, as the agent before anything was supplied");
        assert_eq!(first(13, 8), 0, "of stage 1, and the only one");
        assert_eq!(first(8, 3), 0, "of stage 1, as what was supplied last");
        assert_eq!(first(9, 4), 0);
        assert_eq!(first(9, 2), 1);
    }

    #[test]
    fn the_stage_goes_on_with_an_agent_that_does_what_the_expert_did() {
        let mut stages = KnownStages::default();
        let forward = Some(domain::Action::Forward.into());
        let step = |episode, last_action| peer::memory::Step {
            lane: 1,
            episode,
            step: 1,
            state: Pose::new(0, 0, Heading::N).into(),
            last_action,
            feedback: domain::Feedback::Moved.into(),
            frame: None,
            embedding: None,
            pinned: None,
        };
        stages.supplied(&step(7, None), SuppliedStage { stage: 2, action: forward, next: 3 });
        assert_eq!(stages.of(&step(7, forward)), 3);
        assert_eq!(stages.of(&step(7, Some(domain::Action::TurnLeft.into()))), 2);
        assert_eq!(stages.of(&step(8, forward)), 0, "of another episode");
    }

    #[test]
    fn several_hits_come_nearest_first_in_the_same_order_of_ties() {
        let both = [demonstration(0, 5, 9), demonstration(3, 7, 4)];
        let one = hits(&mut memory(&both, &settings()), 8, 0);
        let mut memory = memory(&both, &MemorySettings { hits: 4, ..settings() });
        let four = hits(&mut memory, 8, 0);
        assert_eq!(four[0], one[0]);
        assert_eq!(
            four.iter().map(|hit| (hit.0, hit.1)).collect::<Vec<_>>()[..2],
            [(1, 1), (0, 3)]
        );
        assert!(four.len() == 4 && four.is_sorted_by(|a, b| a.3 <= b.3));
    }

    #[test]
    fn a_missing_embedding_is_an_error() {
        let mut memory = Episodic::new(&settings());
        let error = build(&mut memory, &[demonstration(1, 5, 9)]).unwrap_err().to_string();
        assert_eq!(error, "the view of 3,5,0 has not been embedded");
    }
}
