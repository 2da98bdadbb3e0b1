//! Remembered demonstrations: paths and plates in their own coordinates, and where those lie in the world.
//!
//! Memory supplies views and actions but no poses. The actions relate a demonstration's poses to each other,
//! so a single view that is recognised locates the whole demonstration.

use std::sync::Arc;

use domain::{Action, Heading, Pose};
use peer::{FrameId, FrameView};
use plates::Landmark;

use super::cache::BoundedCache;
use super::geometry::{PathStep, after, relocated};
use super::perception::{FrameCache, FrameContent, PlacedFrame};

/// Where every demonstration starts in its own coordinates: far from the grid's edges.
const START: Pose = Pose::new(128, 128, Heading::N);

/// Minimum number of plates that agree on a location.
const LEAST_AGREEING: u32 = 3;

/// The weight of two equal views: more than any number of plates.
const SAME_VIEW: u32 = 1000;

/// One step as memory supplies it: the view, if it is kept, and the expert's action, if it is known.
pub(super) type RememberedStep<'a> = (Option<FrameView<'a>>, Option<Action>);

/// A demonstration, or a segment of one, in coordinates in which it begins at `START`.
#[derive(Debug)]
pub(super) struct RelativePath {
    /// Identifies the demonstration among those of one policy.
    pub(super) serial: u64,
    path: Vec<PathStep>,
    /// The views, with the poses they were taken from.
    views: Vec<(Pose, Arc<FrameContent>)>,
    /// The plates in all views, sorted.
    landmarks: Vec<Landmark>,
}

impl RelativePath {
    fn new(serial: u64, supplied: &[RememberedStep<'_>], cache: &mut FrameCache) -> Self {
        let mut demonstration =
            Self { serial, path: Vec::new(), views: Vec::new(), landmarks: Vec::new() };
        let mut pose = Some(START);
        for (at, (frame, action)) in supplied.iter().enumerate() {
            let Some(here) = pose else { break };
            let mut action = *action;
            if let Some(frame) = frame {
                let view = cache.placed(frame, here);
                if action.is_none()
                    && let Some((Some(next), _)) = supplied.get(at + 1)
                {
                    action = action_between(&view, cache.content(next));
                }
                demonstration.landmarks.extend_from_slice(&view.landmarks);
                demonstration.views.push((here, Arc::clone(&view.content)));
            }
            demonstration.path.push(PathStep { pose: here, action });
            pose = action.and_then(|action| after(here, action));
        }
        demonstration.landmarks.sort_unstable();
        demonstration.landmarks.dedup();
        demonstration
    }

    /// The pose in the world in which the demonstration began, according to `views`; `None` if they do not determine
    /// it.
    ///
    /// Each view that equals a remembered one votes for a pose, and so does each pair of equal plates. A pose is
    /// rejected when a plate is seen where the demonstration has only other plates.
    pub(super) fn locate(&self, views: &[Arc<PlacedFrame>]) -> Option<Pose> {
        let mut votes: Vec<(Pose, u32)> = Vec::new();
        for view in views {
            let same = self.views.iter().filter(|(_, known)| known.shows_same(&view.content));
            let starts = same.filter_map(|&(pose, _)| relocated(START, pose, view.pose));
            votes.extend(starts.map(|start| (start, SAME_VIEW)));
        }
        let mut seen: Vec<&Landmark> = views.iter().flat_map(|view| &view.landmarks).collect();
        seen.sort_unstable();
        seen.dedup();
        for known in &self.landmarks {
            let alike = seen.iter().filter(|landmark| landmark.plate == known.plate);
            let starts =
                alike.filter_map(|landmark| relocated(START, facing(known), facing(landmark)));
            votes.extend(starts.map(|start| (start, 1)));
        }
        votes.sort_unstable();
        let tallies = votes.chunk_by(|a, b| a.0 == b.0);
        let tallies = tallies.map(|same| (same.iter().map(|vote| vote.1).sum::<u32>(), same[0].0));
        let mut tallies: Vec<(u32, Pose)> =
            tallies.filter(|&(votes, _)| votes >= LEAST_AGREEING).collect();
        tallies.sort_unstable_by_key(|&(votes, start)| (std::cmp::Reverse(votes), start));
        let mut possible = tallies.into_iter().filter(|&(_, start)| !self.is_refuted(start, &seen));
        let (votes, start) = possible.next()?;
        let is_unique = possible.next().is_none_or(|(others, _)| others < votes);
        is_unique.then_some(start)
    }

    fn is_refuted(&self, start: Pose, seen: &[&Landmark]) -> bool {
        seen.iter().any(|landmark| {
            let Some(place) = relocated(facing(landmark), start, START) else { return false };
            let first = self.landmarks.partition_point(|known| facing(known) < place);
            let mut there = self.landmarks[first..]
                .iter()
                .take_while(|known| facing(known) == place)
                .peekable();
            there.peek().is_some() && there.all(|known| known.plate != landmark.plate)
        })
    }

    /// The path in the world, if it began in `start` there.
    pub(super) fn path_from(&self, start: Pose) -> Vec<PathStep> {
        let place =
            |step: &PathStep| Some(PathStep { pose: relocated(step.pose, START, start)?, ..*step });
        self.path.iter().map_while(place).collect()
    }

    /// The plates in the world, if the demonstration began in `start` there.
    pub(super) fn landmarks_from(&self, start: Pose) -> impl Iterator<Item = Landmark> + '_ {
        self.landmarks.iter().filter_map(move |landmark| {
            let Pose { cell, heading } = relocated(facing(landmark), START, start)?;
            Some(Landmark { standpoint: cell, face: heading, plate: landmark.plate })
        })
    }
}

/// The pose that looks straight at a plate from its standpoint.
fn facing(landmark: &Landmark) -> Pose {
    Pose { cell: landmark.standpoint, heading: landmark.face }
}

/// The action that leads from one view to the next, if both show enough of the same plates.
fn action_between(view: &Arc<PlacedFrame>, next: Arc<FrameContent>) -> Option<Action> {
    let mut landmarks = PlacedFrame::new(Arc::clone(&next), START).landmarks;
    landmarks.sort_unstable();
    let next = RelativePath { serial: 0, path: Vec::new(), views: vec![(START, next)], landmarks };
    let there = next.locate(std::slice::from_ref(view))?;
    Action::ALL.into_iter().find(|&action| after(view.pose, action) == Some(there))
}

/// Supplied steps without their pixels. Frame ids are never reused.
type DemonstrationId = Vec<(Option<FrameId>, Option<Action>)>;

/// Demonstrations by what memory supplied.
#[derive(Debug, Default)]
pub(super) struct RelativePaths {
    known: BoundedCache<DemonstrationId, RelativePath, 4096>,
    created: u64,
}

impl RelativePaths {
    pub(super) fn get(
        &mut self,
        supplied: &[RememberedStep<'_>],
        views: &mut FrameCache,
    ) -> Arc<RelativePath> {
        let id = supplied.iter().map(|(frame, action)| (frame.map(|frame| frame.id), *action));
        let created = &mut self.created;
        self.known.get(id.collect(), || {
            *created += 1;
            RelativePath::new(*created, supplied, views)
        })
    }
}

#[cfg(test)]
mod tests {
    use domain::Cell;
    use plates::painter::{PlateAisle, PlateImage};

    use super::*;
    use crate::grounded::testing::{blank_frame, frame};

    fn pictures(poses: &[Pose]) -> Vec<PlateImage> {
        poses.iter().map(|&pose| PlateAisle::new().picture(pose)).collect()
    }

    #[test]
    fn poses_follow_from_actions_and_plates_from_poses() {
        let pictures = pictures(&[Pose::new(10, 12, Heading::N), Pose::new(10, 14, Heading::N)]);
        let supplied = [
            (Some(frame(&pictures[0], 1)), Some(Action::Forward)),
            (None, Some(Action::Forward)),
            (Some(frame(&pictures[1], 2)), None),
        ];
        let demonstration = RelativePath::new(1, &supplied, &mut FrameCache::default());
        let poses: Vec<_> = demonstration.path.iter().map(|step| step.pose).collect();
        assert_eq!(poses, [0, 1, 2].map(|y| Pose::new(128, 128 + y, Heading::N)));
        let is_real = |landmark: &Landmark| {
            let Cell { x, y } = landmark.standpoint;
            let standpoint = Cell::new(x - 118, y - 116);
            PlateAisle::new().landmarks.contains(&Landmark { standpoint, ..*landmark })
        };
        assert!(demonstration.landmarks.len() > 8 && demonstration.landmarks.iter().all(is_real));
    }

    #[test]
    fn actions_between_images_alone_are_inferred() {
        let poses = [(10, 12), (10, 13), (11, 13)].map(|(x, y)| Pose::new(x, y, Heading::N));
        let pictures = pictures(&[poses[0], poses[1], poses[2], Pose::new(11, 13, Heading::E)]);
        let supplied: Vec<_> =
            (1..).zip(&pictures).map(|(id, picture)| (Some(frame(picture, id)), None)).collect();
        let demonstration = RelativePath::new(1, &supplied, &mut FrameCache::default());
        let actions: Vec<_> = demonstration.path.iter().map(|step| step.action).collect();
        assert_eq!(actions, [Some(Action::Forward), Some(Action::Right), None]);
    }

    /// Where a demonstration of six steps north from `start` with these keyframes is located from `here`.
    fn located(start: Pose, keyframes: &[usize], here: Pose) -> Option<Pose> {
        let poses: Vec<Pose> =
            (0..6).map(|y| Pose::new(start.cell.x, start.cell.y + y, start.heading)).collect();
        let pictures = pictures(&poses);
        let supplied: Vec<RememberedStep<'_>> = (0..6)
            .map(|at| {
                let keyframe = keyframes.contains(&at).then(|| frame(&pictures[at], at as u64));
                (keyframe, (at < 5).then_some(Action::Forward))
            })
            .collect();
        let mut views = FrameCache::default();
        let demonstration = RelativePath::new(1, &supplied, &mut views);
        let picture = PlateAisle::new().picture(here);
        demonstration.locate(&[views.placed(&frame(&picture, 99), here)])
    }

    #[test]
    fn one_equal_view_locates_a_demonstration() {
        let start = Pose::new(10, 11, Heading::N);
        for at in [0, 3, 5] {
            let here = Pose::new(10, 11 + at as u8, Heading::N);
            assert_eq!(located(start, &[at], here), Some(start), "by the view at step {at}");
        }
    }

    #[test]
    fn common_plates_locate_a_demonstration() {
        let start = Pose::new(10, 11, Heading::N);
        for here in [Pose::new(11, 12, Heading::N), Pose::new(11, 19, Heading::S)] {
            assert_eq!(located(start, &[0, 2], here), Some(start), "from {here}");
        }
        assert_eq!(located(start, &[0], Pose::new(10, 12, Heading::S)), None, "nothing in common");
        assert_eq!(located(start, &[], start), None, "no view at all");
    }

    #[test]
    fn one_different_plate_refutes_a_location() {
        let here = Pose::new(10, 12, Heading::N);
        let mut other = PlateAisle::new();
        other.landmarks[4].plate = other.landmarks[0].plate;
        let (here_picture, other_picture) = (PlateAisle::new().picture(here), other.picture(here));
        let mut views = FrameCache::default();
        let supplied = [(Some(frame(&other_picture, 1)), None)];
        let demonstration = RelativePath::new(1, &supplied, &mut views);
        assert_eq!(demonstration.locate(&[views.placed(&frame(&here_picture, 2), here)]), None);
    }

    #[test]
    fn blank_views_locate_nothing() {
        let mut views = FrameCache::default();
        let demonstration = RelativePath::new(1, &[(Some(blank_frame(1)), None)], &mut views);
        assert_eq!(demonstration.locate(&[views.placed(&blank_frame(1), START)]), None);
    }

    #[test]
    fn equal_supplies_are_the_same_demonstration() {
        let pictures = pictures(&[Pose::new(10, 12, Heading::N)]);
        let (mut cache, mut views) = (RelativePaths::default(), FrameCache::default());
        let mut serial = |id, action| {
            let supplied = [(Some(frame(&pictures[0], id)), Some(action)), (None, None)];
            cache.get(&supplied, &mut views).serial
        };
        let first = serial(1, Action::Forward);
        assert_eq!(serial(1, Action::Forward), first);
        assert_ne!(serial(1, Action::Left), first);
        assert_ne!(serial(2, Action::Forward), first);
    }
}
