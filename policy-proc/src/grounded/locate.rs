//! Where in the world a remembered walk took place, judged by the last views.
//!
//! Each view is held against the whole chart: a remembered view that is the same puts the camera into its
//! pose; plates that are in both allow so many poses, as in [`recognise`](super::recognise). Every such
//! pose says where the walk must have begun, and the beginning that most speaks for and nothing against is
//! believed. What one view says of one chart never changes and is worked out once.

use std::sync::Arc;

use domain::Pose;
use plates::Landmark;
use rustc_hash::FxHashMap;
use shm_types::message::FrameId;

use super::chart::{Chart, START};
use super::percept::{Percept, PlacedView};
use super::recognise::{LEAST_AGREEING, camera_of, is_easily_seen};

/// Pairs of chart and view that are kept.
const MOST_KEPT: usize = 65_536;

/// Poses that are considered for one view.
const MOST_FITS: usize = 8;

/// From where in a chart a view may have been taken.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Fit {
    camera: Pose,
    /// It is the same as a remembered view from there.
    same: bool,
    /// Landmarks of the chart that are seen where they should be, by position in the list.
    agreeing: Vec<u16>,
    /// Landmarks that should be seen and are not.
    missing: u32,
}

/// What views say of charts.
#[derive(Debug, Default)]
pub(super) struct Locator {
    kept: FxHashMap<(u64, FrameId), Arc<[Fit]>>,
}

impl Locator {
    /// The pose in the world in which the walk of `chart` began, judged by `views`; `None` when they do
    /// not tell.
    pub(super) fn start_of(&mut self, chart: &Chart, views: &[Arc<PlacedView>]) -> Option<Pose> {
        let mut beginnings: Vec<Beginning> = Vec::new();
        for view in views.iter().rev() {
            for fit in self.fits(chart, view).iter() {
                let Some(start) = relocated(START, fit.camera, view.pose) else { continue };
                let at = beginnings.iter().position(|known| known.start == start);
                let at = at.unwrap_or_else(|| {
                    beginnings.push(Beginning { start, same: 0, agreeing: Vec::new(), missing: 0 });
                    beginnings.len() - 1
                });
                let known = &mut beginnings[at];
                known.same += u32::from(fit.same);
                known.agreeing.extend(&fit.agreeing);
                known.missing += fit.missing;
            }
        }
        let mut scored: Vec<(i32, Pose)> =
            beginnings.iter_mut().filter_map(|known| Some((known.score()?, known.start))).collect();
        scored.sort_unstable_by_key(|&(score, start)| (std::cmp::Reverse(score), start));
        let mut believed =
            scored.into_iter().filter(|&(_, start)| !self.is_refuted(chart, start, views));
        let (best, start) = believed.next()?;
        let second = believed.next().map_or(0, |(score, _)| score);
        (best > second).then_some(start)
    }

    /// Whether some plate seen hangs where the chart, begun in `start`, has another one.
    fn is_refuted(&mut self, chart: &Chart, start: Pose, views: &[Arc<PlacedView>]) -> bool {
        views.iter().any(|view| {
            let Some(camera) = relocated(view.pose, start, START) else { return true };
            // What fits from there has been looked at, and nothing contradicts it.
            if self.fits(chart, view).iter().any(|fit| fit.camera == camera) {
                return false;
            }
            let seen = view.percept.sightings.iter();
            let mut seen = seen.filter_map(|sighting| sighting.seen_from(camera));
            seen.any(|landmark| contradicts(chart, &landmark))
        })
    }

    fn fits(&mut self, chart: &Chart, view: &PlacedView) -> Arc<[Fit]> {
        if self.kept.len() >= MOST_KEPT {
            self.kept.clear();
        }
        let fits = self.kept.entry((chart.serial, view.frame));
        Arc::clone(fits.or_insert_with(|| fits_of(chart, &view.percept).into()))
    }
}

/// A pose in which the walk may have begun.
struct Beginning {
    start: Pose,
    same: u32,
    agreeing: Vec<u16>,
    missing: u32,
}

impl Beginning {
    /// How much speaks for it; `None` when that is too little.
    fn score(&mut self) -> Option<i32> {
        self.agreeing.sort_unstable();
        self.agreeing.dedup();
        let agreeing = self.agreeing.len() as i32;
        let seen = agreeing - self.missing as i32;
        let enough = self.same > 0 || (agreeing >= LEAST_AGREEING && seen > 0);
        // Views that are the same outweigh any plates.
        enough.then_some(1000 * self.same as i32 + seen.max(1))
    }
}

/// `pose` of a chart in the world, when the chart's `from` is `to` there.
pub(super) fn relocated(pose: Pose, from: Pose, to: Pose) -> Option<Pose> {
    let (ahead, right) = from.offset_of(pose.cell);
    let cell = to.cell_at(ahead.try_into().ok()?, right.try_into().ok()?)?;
    Some(Pose { cell, heading: to.heading.turned(from.heading.quarters_to(pose.heading)) })
}

/// `landmark` of a chart in the world, when its walk began in `start` there.
pub(super) fn relocated_landmark(landmark: &Landmark, start: Pose) -> Option<Landmark> {
    let facing = Pose { cell: landmark.standpoint, heading: landmark.face };
    let Pose { cell, heading } = relocated(facing, START, start)?;
    Some(Landmark { standpoint: cell, face: heading, plate: landmark.plate })
}

fn contradicts(chart: &Chart, landmark: &Landmark) -> bool {
    let place = (landmark.standpoint, landmark.face);
    let first = chart.landmarks.partition_point(|known| (known.standpoint, known.face) < place);
    let there = chart.landmarks[first..].iter();
    let mut there = there.take_while(|known| (known.standpoint, known.face) == place).peekable();
    there.peek().is_some() && there.all(|known| known.plate != landmark.plate)
}

/// The poses in `chart` that a view of `percept` may have been taken from.
fn fits_of(chart: &Chart, percept: &Percept) -> Vec<Fit> {
    let same_as = |(_, view): &&(usize, Arc<Percept>)| view.is_like(percept);
    let mut same: Vec<Pose> =
        chart.views.iter().filter(same_as).map(|&(step, _)| chart.steps[step].pose).collect();
    same.sort_unstable();
    same.dedup();
    let mut cameras = same.clone();
    for landmark in &chart.landmarks {
        let alike = percept.sightings.iter().filter(|seen| seen.plate == landmark.plate);
        cameras.extend(alike.filter_map(|sighting| camera_of(*sighting, landmark)));
    }
    cameras.sort_unstable();
    cameras.dedup();
    let fit = |camera| fit(chart, percept, camera, same.contains(&camera));
    let mut fits: Vec<Fit> = cameras.into_iter().filter_map(fit).collect();
    let weight = |fit: &Fit| (fit.same, fit.agreeing.len() as i32 - fit.missing as i32, fit.camera);
    fits.sort_unstable_by_key(|fit| std::cmp::Reverse(weight(fit)));
    fits.truncate(MOST_FITS);
    fits
}

/// How a view of `percept` from `camera` goes together with `chart`; `None` when a plate contradicts it.
fn fit(chart: &Chart, percept: &Percept, camera: Pose, same: bool) -> Option<Fit> {
    let seen: Vec<Landmark> =
        percept.sightings.iter().filter_map(|sighting| sighting.seen_from(camera)).collect();
    let (mut agreeing, mut missing) = (Vec::new(), 0);
    for landmark in &seen {
        match chart.landmarks.binary_search(landmark) {
            Ok(at) => agreeing.push(at as u16),
            Err(_) if contradicts(chart, landmark) => return None,
            Err(_) => {
                let overlooked =
                    |(step, _): &(usize, _)| is_easily_seen(landmark, chart.steps[*step].pose);
                missing += u32::from(chart.views.iter().any(overlooked));
            }
        }
    }
    let expected = chart.landmarks.iter().filter(|landmark| is_easily_seen(landmark, camera));
    missing += expected.filter(|landmark| !seen.contains(landmark)).count() as u32;
    Some(Fit { camera, same, agreeing, missing })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameView;
    use crate::grounded::chart::{Charts, Supplied};
    use crate::grounded::percept::Percepts;
    use crate::grounded::testing::view;
    use domain::{Action, Heading};
    use plates::painter::{Aisle, Picture};

    fn located(walk: Pose, keyframes: &[usize], here: Pose) -> Option<Pose> {
        let aisle = Aisle::new();
        let ahead = |t: usize| Pose::new(walk.cell.x, walk.cell.y + t as u8, walk.heading);
        let pictures: Vec<Picture> = (0..6).map(|t| aisle.picture(ahead(t))).collect();
        let supplied: Vec<Supplied<'_>> = (0..6)
            .map(|t| {
                let frame = keyframes.contains(&t).then(|| view(&pictures[t], t as u64));
                (frame, (t < 5).then_some(Action::Forward))
            })
            .collect();
        let mut percepts = Percepts::default();
        let chart = Charts::default().of(supplied.iter().copied(), &mut percepts);
        let picture = aisle.picture(here);
        let seen = percepts.placed(&view(&picture, 99), here);
        Locator::default().start_of(&chart, &[seen])
    }

    #[test]
    fn one_view_that_is_the_same_gives_the_walk_away() {
        let walk = Pose::new(10, 11, Heading::N);
        for at in [0, 3, 5] {
            let here = Pose::new(10, 11 + at as u8, Heading::N);
            assert_eq!(located(walk, &[at], here), Some(walk), "by the view at step {at}");
        }
    }

    #[test]
    fn plates_in_common_give_it_away_too() {
        let walk = Pose::new(10, 11, Heading::N);
        for here in [Pose::new(11, 12, Heading::N), Pose::new(11, 19, Heading::S)] {
            assert_eq!(located(walk, &[0, 2], here), Some(walk), "from {here}");
        }
        assert_eq!(located(walk, &[0], Pose::new(10, 12, Heading::S)), None, "nothing in common");
        assert_eq!(located(walk, &[], walk), None, "no view at all");
    }

    #[test]
    fn blank_views_give_nothing_away() {
        let grey = FrameView {
            id: 1,
            width: 64,
            height: 64,
            pixels: &[128; 64 * 64 * 4],
            ..FrameView::NONE
        };
        let mut percepts = Percepts::default();
        let chart = Charts::default().of([(Some(grey), None)].into_iter(), &mut percepts);
        let seen = percepts.placed(&grey, START);
        assert_eq!(Locator::default().start_of(&chart, &[seen]), None);
    }

    #[test]
    fn relocation_turns_and_shifts() {
        let to = Pose::new(20, 20, Heading::E);
        let two_north = Pose::new(128, 130, Heading::W);
        assert_eq!(relocated(two_north, START, to), Some(Pose::new(22, 20, Heading::N)));
        assert_eq!(relocated(two_north, START, Pose::new(255, 20, Heading::E)), None);
    }
}
