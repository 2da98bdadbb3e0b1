//! From where was a remembered view taken, if it shows the place that is seen now?
//!
//! Two pictures that are alike were taken from the same pose. Otherwise plates that are in both give it
//! away: each says where the remembered camera must have stood for the plate to be where it is, and when
//! several agree and none objects, it is believed.

use domain::Pose;

use super::percept::Percept;
use plates::{Landmark, Sighting};

/// Plates that must agree.
pub(super) const LEAST_AGREEING: i32 = 3;

/// Where `remembered` was taken, given that `current` is what is seen from `here`.
pub(super) fn pose_of(remembered: &Percept, current: &Percept, here: Pose) -> Option<Pose> {
    if remembered.is_like(current) {
        return Some(here);
    }
    by_landmarks(&remembered.sightings, &current.sightings, here)
}

fn by_landmarks(remembered: &[Sighting], current: &[Sighting], here: Pose) -> Option<Pose> {
    let landmarks: Vec<Landmark> =
        current.iter().filter_map(|sighting| sighting.seen_from(here)).collect();
    let mut candidates: Vec<Pose> = Vec::new();
    for landmark in &landmarks {
        for sighting in remembered.iter().filter(|sighting| sighting.plate == landmark.plate) {
            candidates.extend(camera_of(*sighting, landmark));
        }
    }
    candidates.sort_unstable();
    candidates.dedup();
    let mut scored: Vec<(i32, Pose)> = candidates
        .into_iter()
        .filter_map(|pose| Some((support(pose, remembered, &landmarks, here)?, pose)))
        .collect();
    scored.sort_unstable_by_key(|&(score, _)| std::cmp::Reverse(score));
    match scored[..] {
        [(best, pose)] if best > 0 => Some(pose),
        [(best, pose), (second, _), ..] if best > 0 && best > second => Some(pose),
        _ => None,
    }
}

/// The pose from which `landmark` is seen as `sighting`.
pub(super) fn camera_of(sighting: Sighting, landmark: &Landmark) -> Option<Pose> {
    let heading = landmark.face.turned(-sighting.face);
    let standpoint = Pose { cell: landmark.standpoint, heading };
    Some(Pose { cell: standpoint.cell_at(-sighting.ahead, -sighting.right)?, heading })
}

/// How well the plates of both views go together when the remembered one was taken from `pose`: `None`
/// when too few agree, or one says something else than the plate in the same place.
fn support(pose: Pose, remembered: &[Sighting], current: &[Landmark], here: Pose) -> Option<i32> {
    let placed: Vec<Landmark> =
        remembered.iter().filter_map(|sighting| sighting.seen_from(pose)).collect();
    let (mut agreeing, mut missing) = (0, 0);
    for landmark in &placed {
        let same_place = |other: &&Landmark| {
            other.standpoint == landmark.standpoint && other.face == landmark.face
        };
        match current.iter().find(same_place) {
            Some(other) if other.plate == landmark.plate => agreeing += 1,
            Some(_) => return None,
            None => missing += i32::from(is_easily_seen(landmark, here)),
        }
    }
    let unremembered =
        |landmark: &&Landmark| is_easily_seen(landmark, pose) && !placed.contains(landmark);
    missing += current.iter().filter(unremembered).count() as i32;
    (agreeing >= LEAST_AGREEING).then_some(agreeing - missing)
}

/// Whether a plate would be read from `camera` unless something stands in between.
pub(super) fn is_easily_seen(landmark: &Landmark, camera: Pose) -> bool {
    let (ahead, right) = camera.offset_of(landmark.standpoint);
    match camera.heading.quarters_to(landmark.face) {
        0 => (1..=5).contains(&ahead) && right.abs() <= ahead,
        1 => (1..=5).contains(&ahead) && (0..ahead).contains(&right),
        3 => (1..=5).contains(&ahead) && (0..ahead).contains(&-right),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;
    use crate::FrameView;
    use crate::grounded::testing::view;
    use plates::painter::{Aisle, Picture};

    fn percept(pose: Pose) -> Percept {
        Percept::of(&view(&Aisle::new().picture(pose), 1))
    }

    #[test]
    fn poses_along_an_aisle_are_told_apart() {
        let here = Pose::new(10, 12, Heading::N);
        for remembered in [
            here,
            Pose::new(10, 13, Heading::N),
            Pose::new(10, 10, Heading::N),
            Pose::new(11, 12, Heading::N),
            Pose::new(11, 19, Heading::S),
        ] {
            assert_eq!(pose_of(&percept(remembered), &percept(here), here), Some(remembered));
        }
    }

    #[test]
    fn what_shares_nothing_with_the_view_is_not_recognised() {
        let here = Pose::new(10, 12, Heading::N);
        for remembered in [
            Pose::new(10, 12, Heading::S),
            Pose::new(10, 12, Heading::W),
            Pose::new(10, 18, Heading::N),
        ] {
            assert_eq!(pose_of(&percept(remembered), &percept(here), here), None, "{remembered}");
        }
    }

    #[test]
    fn one_plate_that_says_something_else_refutes_a_place() {
        let here = Pose::new(10, 12, Heading::N);
        let mut other = Aisle::new();
        other.landmarks[4].plate = other.landmarks[0].plate;
        let other = Percept::of(&view(&other.picture(here), 1));
        assert_eq!(pose_of(&other, &percept(here), here), None);
    }

    #[test]
    fn blank_views_are_never_recognised() {
        let here = Pose::new(10, 12, Heading::N);
        let blank = FrameView {
            id: 1,
            width: 64,
            height: 64,
            pixels: &[128; 64 * 64 * 4],
            ..FrameView::NONE
        };
        let blank = Percept::of(&blank);
        assert_eq!(pose_of(&blank, &blank, here), None);
        assert_eq!(pose_of(&percept(here), &blank, here), None);
        let bare = |seed| Percept::of(&view(&Picture::background(448, seed), 1));
        assert_eq!(
            pose_of(&bare(1), &bare(1), here),
            Some(here),
            "texture without plates is enough"
        );
        assert_eq!(pose_of(&bare(1), &bare(2), here), None);
    }
}
