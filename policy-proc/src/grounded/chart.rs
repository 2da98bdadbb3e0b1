//! A remembered walk in its own terms: where its views were taken and which plates they show, relative to
//! where it began.
//!
//! Memory supplies views and actions, never a pose. The actions say how the poses lie to one another, so one
//! view that is recognised gives away the whole walk ([`locate`](super::locate)).

use std::hash::{Hash, Hasher};
use std::sync::Arc;

use domain::{Action, Heading, Pose};
use plates::Landmark;
use rustc_hash::{FxHashMap, FxHasher};
use shm_types::message::FrameId;

use super::geometry::after;
use super::percept::{Percept, Percepts, PlacedView};
use super::recognise;
use crate::FrameView;

/// Where a chart's own grid has its walk begin: far from its edges.
pub(super) const START: Pose = Pose::new(128, 128, Heading::N);

/// Charts that are kept; a few kilobytes each.
const MOST_KEPT: usize = 4096;

/// A pose and what the expert did in it; `None` where that is not known or the walk ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct PathStep {
    pub(super) pose: Pose,
    pub(super) action: Option<Action>,
}

/// A remembered walk in its own grid.
#[derive(Debug)]
pub(super) struct Chart {
    /// Names it among the charts of one policy; never used again.
    pub(super) serial: u64,
    /// From its start on, as far as its poses are known.
    pub(super) steps: Vec<PathStep>,
    /// Its views: which step each was taken at, and what it shows.
    pub(super) views: Vec<(usize, Arc<Percept>)>,
    /// Every plate in them, sorted.
    pub(super) landmarks: Vec<Landmark>,
    /// The view that follows the last known pose, when nobody said what was done there.
    pub(super) beyond: Option<Arc<Percept>>,
}

/// A step as memory supplies it.
pub(super) type Supplied<'a> = (Option<FrameView<'a>>, Option<Action>);

impl Chart {
    fn of(serial: u64, supplied: &[Supplied<'_>], percepts: &mut Percepts) -> Self {
        let (mut steps, mut views) = (Vec::new(), Vec::new());
        let mut landmarks: Vec<Landmark> = Vec::new();
        let mut pose = Some(START);
        for (at, (frame, action)) in supplied.iter().enumerate() {
            let Some(here) = pose else { break };
            let percept = frame.as_ref().map(|frame| percepts.of(frame));
            if let Some(percept) = &percept {
                landmarks.extend(percept.sightings.iter().filter_map(|seen| seen.seen_from(here)));
                views.push((at, Arc::clone(percept)));
            }
            let next = supplied.get(at + 1).and_then(|(frame, _)| frame.as_ref());
            let action = action.or_else(|| between(here, percept.as_deref()?, &percepts.of(next?)));
            steps.push(PathStep { pose: here, action });
            pose = action.and_then(|action| after(here, action));
        }
        landmarks.sort_unstable();
        landmarks.dedup();
        let beyond = supplied.get(steps.len()).and_then(|(frame, _)| frame.as_ref());
        let beyond = beyond.map(|frame| percepts.of(frame));
        Self { serial, steps, views, landmarks, beyond }
    }

    /// Whether its first view may be the oldest of `views`: as far as it has one, they are the same.
    pub(super) fn begins_with(&self, views: &[Arc<PlacedView>]) -> bool {
        match (self.views.first(), views.first()) {
            (Some((0, view)), Some(oldest)) => view.is_like(&oldest.percept),
            _ => true,
        }
    }
}

/// The action that leads from one view to the next, where both show enough of the same place.
fn between(here: Pose, view: &Percept, next: &Percept) -> Option<Action> {
    let there = recognise::pose_of(next, view, here)?;
    Action::ALL.into_iter().find(|&action| after(here, action) == Some(there))
}

/// A supplied step by name: its frame, if it has one, and its action.
type Named = (FrameId, Option<Action>);

/// Charts by what they are made of, which names frames and therefore never changes.
#[derive(Debug, Default)]
pub(super) struct Charts {
    kept: FxHashMap<u64, (Vec<Named>, Arc<Chart>)>,
    made: u64,
}

impl Charts {
    /// The chart of the walk that is `supplied`.
    pub(super) fn of<'a>(
        &mut self,
        supplied: impl Iterator<Item = Supplied<'a>> + Clone,
        percepts: &mut Percepts,
    ) -> Arc<Chart> {
        const NO_FRAME: FrameId = FrameId::MAX;
        let named =
            |(frame, action): Supplied<'_>| (frame.map_or(NO_FRAME, |frame| frame.id), action);
        let names = supplied.clone().map(named);
        let mut hasher = FxHasher::default();
        names.clone().for_each(|name| name.hash(&mut hasher));
        let hash = hasher.finish();
        if let Some((known, chart)) = self.kept.get(&hash)
            && known.iter().copied().eq(names.clone())
        {
            return Arc::clone(chart);
        }
        if self.kept.len() >= MOST_KEPT {
            self.kept.clear();
        }
        self.made += 1;
        let supplied: Vec<Supplied<'_>> = supplied.collect();
        let chart = Arc::new(Chart::of(self.made, &supplied, percepts));
        self.kept.insert(hash, (names.collect(), Arc::clone(&chart)));
        chart
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grounded::testing::view;
    use plates::painter::{Aisle, Picture};

    fn pictures(poses: &[Pose]) -> Vec<Picture> {
        poses.iter().map(|&pose| Aisle::new().picture(pose)).collect()
    }

    #[test]
    fn poses_follow_from_actions_and_plates_from_poses() {
        let pictures = pictures(&[Pose::new(10, 12, Heading::N), Pose::new(10, 14, Heading::N)]);
        let supplied = [
            (Some(view(&pictures[0], 1)), Some(Action::Forward)),
            (None, Some(Action::Forward)),
            (Some(view(&pictures[1], 2)), None),
        ];
        let chart = Charts::default().of(supplied.iter().copied(), &mut Percepts::default());
        let poses: Vec<_> = chart.steps.iter().map(|step| step.pose).collect();
        assert_eq!(poses, [0, 1, 2].map(|y| Pose::new(128, 128 + y, Heading::N)));
        let moved = |landmark: &Landmark| {
            let cell = landmark.standpoint;
            let standpoint = domain::Cell::new(cell.x - 118, cell.y - 116);
            Aisle::new().landmarks.contains(&Landmark { standpoint, ..*landmark })
        };
        assert!(chart.landmarks.len() > 8 && chart.landmarks.iter().all(moved));
    }

    #[test]
    fn moves_between_images_alone_are_inferred() {
        let poses = [(10, 12), (10, 13), (11, 13)].map(|(x, y)| Pose::new(x, y, Heading::N));
        let turned = Pose::new(11, 13, Heading::E);
        let pictures = pictures(&[poses[0], poses[1], poses[2], turned]);
        let supplied: Vec<_> =
            (1..).zip(&pictures).map(|(id, picture)| (Some(view(picture, id)), None)).collect();
        let chart = Charts::default().of(supplied.iter().copied(), &mut Percepts::default());
        let actions: Vec<_> = chart.steps.iter().map(|step| step.action).collect();
        assert_eq!(actions, [Some(Action::Forward), Some(Action::Right), None]);
    }

    #[test]
    fn the_same_walk_is_charted_once() {
        let pictures = pictures(&[Pose::new(10, 12, Heading::N)]);
        let mut charts = Charts::default();
        let mut serial = |id, action| {
            let supplied = [(Some(view(&pictures[0], id)), Some(action)), (None, None)];
            charts.of(supplied.iter().copied(), &mut Percepts::default()).serial
        };
        let first = serial(1, Action::Forward);
        assert_eq!(serial(1, Action::Forward), first);
        assert_ne!(serial(1, Action::Left), first);
        assert_ne!(serial(2, Action::Forward), first);
    }
}
