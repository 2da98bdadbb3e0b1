use proptest::prelude::*;

use super::*;
use crate::painter::PlateImage as Painting;

fn plate(code: u32) -> Plate {
    Plate(std::array::from_fn(|i| (code / 7_u32.pow(i as u32) % 7) as u8))
}

fn look(painting: &Painting) -> Vec<Sighting> {
    read(painting.width(), painting.width(), painting.pixels())
}

fn seen(width: u32, plates: &[Sighting]) -> Vec<Sighting> {
    look(&Painting::background(width, 1).with(plates))
}

#[test]
fn every_band_colour_is_read_at_every_place() {
    for shift in 0..7 {
        let plate = Plate(std::array::from_fn(|i| ((i + shift) % 7) as u8));
        let sighting = Sighting { ahead: 1, right: 0, face: 0, plate };
        assert_eq!(seen(448, &[sighting]), [sighting]);
    }
}

#[test]
fn plates_are_read_across_the_floor_and_along_aisles() {
    // How far ahead, at 448 pixels, a plate is read: in rows to the side of the agent's own.
    let reach = |face: i8, right: i8| {
        let first = if face == 0 { right.abs() } else { right.abs() + 1 };
        (first..12)
            .take_while(|&ahead| {
                let sighting = Sighting { ahead, right, face, plate: plate(12_345) };
                seen(448, &[sighting]) == [sighting]
            })
            .last()
    };
    for right in [0, 1, 3, -2] {
        assert_eq!(reach(0, right), Some(7), "facing, {right} to the right");
    }
    for (face, sign) in [(1, 1), (3, -1)] {
        assert!(reach(face, 0) >= Some(5), "in a narrow aisle: {:?}", reach(face, 0));
        for side in [1, 2, 3] {
            assert!(reach(face, sign * side) >= Some(6), "{side}: {:?}", reach(face, sign * side));
        }
    }
}

#[test]
fn a_whole_aisle_is_read_at_once() {
    let aisle: Vec<_> = (1..=4)
        .flat_map(|ahead| {
            [
                Sighting { ahead, right: 0, face: 3, plate: plate(7 * ahead as u32) },
                Sighting { ahead, right: 1, face: 1, plate: plate(7 * ahead as u32) },
            ]
        })
        .filter(|plate| plate.ahead > plate.right)
        .collect();
    assert_eq!(seen(448, &aisle), aisle);
}

#[test]
fn a_plate_that_hides_another_is_the_one_that_is_read() {
    let near = Sighting { ahead: 1, right: 0, face: 0, plate: plate(1000) };
    let far = Sighting { ahead: 3, right: 0, face: 0, plate: plate(2000) };
    assert_eq!(seen(448, &[near, far]), [near]);
}

#[test]
fn sightings_become_landmarks_in_the_world() {
    let ahead_to_the_left = Sighting { ahead: 3, right: -1, face: 3, plate: plate(5) };
    let at = |heading| ahead_to_the_left.seen_from(Pose::new(5, 5, heading));
    let landmark = |x, y, face| {
        Some(Landmark { standpoint: Cell::new(x, y), face, plate: ahead_to_the_left.plate })
    };
    assert_eq!(at(Heading::N), landmark(4, 8, Heading::W));
    assert_eq!(at(Heading::E), landmark(8, 6, Heading::N));
    assert_eq!(at(Heading::S), landmark(6, 2, Heading::E));
    assert_eq!(at(Heading::W), landmark(2, 4, Heading::S));
    assert_eq!(ahead_to_the_left.seen_from(Pose::new(0, 5, Heading::N)), None);
}

#[test]
fn an_image_of_the_wrong_size_shows_nothing() {
    let pixels = [255, 0, 255, 255].repeat(64 * 64);
    let cut = |width, height, bytes: usize| read(width, height, &pixels[..bytes]);
    assert_eq!(cut(64, 64, 64 * 64 * 4), []);
    assert_eq!(cut(64, 64, 64 * 64 * 4 - 1), []);
    assert_eq!(cut(0, 0, 0), []);
    assert_eq!(cut(0, 9, 0), []);
}

fn sighting() -> impl Strategy<Value = Sighting> {
    let facing = (0..6_i8, -3..=3_i8).prop_map(|(ahead, right)| (ahead.max(right.abs()), right, 0));
    let along = (1..4_i8, 0..3_i8, prop::bool::ANY).prop_map(|(ahead, side, left)| {
        let (side, ahead) = (side.min(ahead - 1), ahead);
        if left { (ahead, -side, 3) } else { (ahead, side, 1) }
    });
    (prop_oneof![facing, along], 0..7_u32.pow(6)).prop_map(|((ahead, right, face), code)| {
        Sighting { ahead, right, face, plate: plate(code) }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_plate_in_view_is_read_and_nothing_else(sighting in sighting(), seed in 0..1000_u32) {
        let picture = Painting::background(448, seed).with(&[sighting]);
        prop_assert_eq!(look(&picture), [sighting]);
    }

    #[test]
    fn any_bytes_are_accepted(
        pixels in prop::collection::vec(prop::sample::select(vec![0_u8, 128, 255]), 64 * 64 * 4),
        width in 0..80_u32,
    ) {
        let height = (64 * 64) / width.max(1);
        let bytes = &pixels[..4 * (width * height) as usize];
        read(width, height, bytes);
    }
}
