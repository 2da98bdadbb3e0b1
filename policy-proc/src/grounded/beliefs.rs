//! Everything the policy believes at one step, derived from the request alone.

use std::sync::Arc;

use domain::{Cell, Pose};
use peer::Request;
use plates::{ItemName, Landmark};

use super::demonstration::{RelativePath, RelativePaths, Supplied};
use super::instruction::NavigationGoal;
use super::knowledge::{Knowledge, KnowledgeBase, standpoints_among};
use super::local_map::LocalMap;
use super::perception::{FrameCache, PlacedFrame, rack_of};
use super::recent::RecentSteps;
use super::tour::Tour;

/// What was derived from frames, demonstrations and documents, which never change. Each cache is bounded;
/// losing an entry costs time and changes no decision.
#[derive(Debug, Default)]
pub(super) struct PolicyCaches {
    views: FrameCache,
    demonstrations: RelativePaths,
    knowledge: KnowledgeBase,
}

/// What the policy believes.
pub(super) struct Beliefs {
    pub(super) recent: RecentSteps,
    /// Nothing can be seen in the current frame.
    pub(super) is_blind: bool,
    pub(super) map: LocalMap,
    /// Plates in the last views and in the retrieved segment.
    seen: Vec<Landmark>,
    /// The path of the retrieved segment, if it was located.
    pub(super) segment: Option<Tour>,
    pub(super) knowledge: Arc<Knowledge>,
}

impl Beliefs {
    pub(super) fn new(
        request: &Request<'_>,
        goal: Option<&NavigationGoal<'_>>,
        caches: &mut PolicyCaches,
    ) -> Self {
        let recent = RecentSteps::of(request);
        let views = placed_views(request, &recent, &mut caches.views);
        let mut seen: Vec<Landmark> = Vec::new();
        views.iter().for_each(|view| seen.extend_from_slice(&view.landmarks));

        let segment = request.segment.map_or(&[][..], |segment| segment.steps);
        let segment = segment.iter().map(|step| (Some(step.frame), step.action));
        let segment = locate(segment, &views, caches).map(|(segment, start)| {
            seen.extend(segment.landmarks_from(start));
            Tour::along(segment.path_from(start), &[])
        });
        let trajectories = request.trajectories.iter().filter_map(|trajectory| {
            let supplied = trajectory.steps.iter().map(|step| (step.frame, step.action));
            locate(supplied, &views, caches)
        });
        let located: Vec<_> = trajectories.collect();
        let task = (request.instruction, goal);
        let knowledge = caches.knowledge.get(task, request.documents, &located);

        let mut map = LocalMap::around(request.pose.cell);
        knowledge.mark(&mut map);
        for view in &views {
            view.free.iter().for_each(|&cell| map.mark_free(cell));
        }
        for landmark in &seen {
            map.mark_free(landmark.standpoint);
            rack_of(landmark).into_iter().for_each(|rack| map.mark_occupied(rack));
        }
        segment.iter().flat_map(Tour::cells).for_each(|cell| map.mark_free(cell));
        recent.cells().for_each(|cell| map.mark_free(cell));
        recent.blocked_cells().for_each(|cell| map.mark_occupied(cell));
        let is_blind = views.last().is_none_or(|view| view.content.is_blank);
        Self { recent, is_blind, map, seen, segment, knowledge }
    }

    /// Cells from which the `nth` target of the goal can be reached.
    pub(super) fn standpoints(&self, nth: usize, target: ItemName<'_>) -> Vec<Cell> {
        let mut cells = self.knowledge.standpoints.get(nth).cloned().unwrap_or_default();
        cells.extend(standpoints_among(&self.seen, target));
        cells
    }
}

/// The views of the window and the current one, with their poses, oldest first.
fn placed_views(
    request: &Request<'_>,
    recent: &RecentSteps,
    views: &mut FrameCache,
) -> Vec<Arc<PlacedFrame>> {
    let past = request.window.iter().zip(&recent.past);
    let frames = past.map(|(step, past)| (&step.frame, past.pose));
    let frames = frames.chain([(&request.frame, recent.here)]);
    frames.map(|(frame, pose)| views.placed(frame, pose)).collect()
}

/// The supplied demonstration and the pose where it began, if `views` determine it.
fn locate<'a>(
    supplied: impl Iterator<Item = Supplied<'a>>,
    views: &[Arc<PlacedFrame>],
    caches: &mut PolicyCaches,
) -> Option<(Arc<RelativePath>, Pose)> {
    let supplied: Vec<Supplied<'_>> = supplied.collect();
    let demonstration = caches.demonstrations.get(&supplied, &mut caches.views);
    let start = demonstration.locate(views)?;
    Some((demonstration, start))
}
