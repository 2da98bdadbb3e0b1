//! Everything the policy believes at one step, derived from the request alone.

use std::sync::Arc;

use domain::{Action, Cell, Pose, UnknownCode};
use peer::{Item, PlanView, Request, StepView};
use plates::{ItemName, Landmark};

use super::demonstration::{RelativePath, RelativePaths, RememberedStep};
use super::geometry::{PathStep, after};
use super::instruction::NavigationGoal;
use super::knowledge::{Doubt, Knowledge, KnowledgeBase, standpoints_among};
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
    /// Plates in the last views, and in what was retrieved.
    seen: Vec<Landmark>,
    /// The paths of the plans, and of the retrieved segments that were located, in order.
    pub(super) segments: Vec<Tour>,
    pub(super) knowledge: Arc<Knowledge>,
}

impl Beliefs {
    pub(super) fn new(
        request: &Request<'_>,
        goal: Option<&NavigationGoal<'_>>,
        caches: &mut PolicyCaches,
    ) -> Result<Self, UnknownCode> {
        let recent = RecentSteps::of(request)?;
        let views = placed_views(request, &recent, &mut caches.views);
        let mut seen: Vec<Landmark> = Vec::new();
        views.iter().for_each(|view| seen.extend_from_slice(&view.landmarks));
        let in_views = seen.len();

        let (mut segments, mut located) = (Vec::new(), Vec::new());
        for item in request.items {
            let supplied: Vec<RememberedStep<'_>> = match item {
                Item::Text(_) => continue,
                Item::Steps(supplied) => {
                    let action =
                        |step: &StepView<'_>| step.action.and_then(|action| action.try_into().ok());
                    supplied.steps.iter().map(|step| (step.frame, action(step))).collect()
                }
                Item::Frame(captioned) => vec![(Some(captioned.frame), None)],
                // It begins where the agent is: no view has to locate it.
                Item::Plan(plan) => {
                    segments.push(Tour::along(planned_path(plan, recent.here), &[]));
                    continue;
                }
            };
            let Some((path, start)) = locate(&supplied, &views, caches) else {
                continue;
            };
            if item.trajectory().is_some() {
                located.push((path, start));
            } else {
                seen.extend(path.landmarks_from(start));
                segments.push(Tour::along(path.path_from(start), &[]));
            }
        }
        let task = (request.instruction, goal);
        let texts: Vec<_> = request.texts().collect();
        let knowledge = caches.knowledge.get(task, &texts, &located);

        let mut map = LocalMap::around(recent.here.cell);
        knowledge.mark(&mut map, Doubt::at(request.step, request.episode_seed));
        for view in &views {
            view.free.iter().for_each(|&cell| map.mark_free(cell));
            view.occupied.iter().for_each(|&cell| map.mark_occupied(cell));
        }
        for landmark in &seen[in_views..] {
            map.mark_free(landmark.standpoint);
            rack_of(landmark).into_iter().for_each(|rack| map.mark_occupied(rack));
        }
        segments.iter().flat_map(Tour::cells).for_each(|cell| map.mark_free(cell));
        recent.cells().for_each(|cell| map.mark_free(cell));
        recent.blocked_cells().for_each(|cell| map.mark_occupied(cell));
        let is_blind = views.last().is_none_or(|view| view.content.is_blank);
        Ok(Self { recent, is_blind, map, seen, segments, knowledge })
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

/// The path that a plan describes from `here` on.
fn planned_path(plan: &PlanView<'_>, here: Pose) -> Vec<PathStep> {
    let actions = plan.actions().map_while(|action| Action::try_from(action).ok());
    let step = |pose: &mut Option<Pose>, action: Action| {
        let step = PathStep { pose: (*pose)?, action: Some(action) };
        *pose = after(step.pose, action);
        Some(step)
    };
    actions.scan(Some(here), step).collect()
}

/// The supplied demonstration and where it began, if `views` tell.
fn locate(
    supplied: &[RememberedStep<'_>],
    views: &[Arc<PlacedFrame>],
    caches: &mut PolicyCaches,
) -> Option<(Arc<RelativePath>, Pose)> {
    let demonstration = caches.demonstrations.get(supplied, &mut caches.views);
    let start = demonstration.locate(views)?;
    Some((demonstration, start))
}
