//! Whether an item is in view, computed on the grid in integers.
//!
//! An item is in view from a pose if some point of its rack face lies within the camera's 90 degrees and nothing solid is
//! in between, at any distance. This is conservative: such an item may cover three pixels at the far end of an aisle, but
//! an item that is *not* in view by this rule is in no image. It serves the constraint that the first view must not show
//! the target. Racks hide everything behind them, and items are visible through their own face only; barricades hide
//! nothing.

use domain::{Cell, Heading, Pose};

use crate::layout::Layout;
use crate::world::Item;

/// Length units in a cell: faces are sampled every 10 cm, at odd offsets, so never at a corner.
const CELL: i32 = 20;

/// Offsets of the sampled points from the middle of a rack face, along it.
const SAMPLES: [i32; 10] = [-9, -7, -5, -3, -1, 1, 3, 5, 7, 9];

type FacePoint = (i32, i32);

/// Whether the face of `item` is in view from `pose`.
pub fn sees(layout: &Layout, pose: Pose, item: &Item) -> bool {
    let camera = centre(pose.cell);
    let (face_x, face_y) = vector(item.face);
    let (rack_x, rack_y) = centre(item.rack);
    let middle = (rack_x + face_x * CELL / 2, rack_y + face_y * CELL / 2);
    let in_front = (camera.0 - middle.0) * face_x + (camera.1 - middle.1) * face_y > 0;
    in_front
        && SAMPLES.iter().any(|offset| {
            let point = (middle.0 + face_y * offset, middle.1 + face_x * offset);
            in_frustum(camera, pose.heading, point)
                && is_clear(layout, pose.cell, point, item.standpoint)
        })
}

/// The free cells whose middle is in view from `pose`, its own first.
pub fn cells(layout: &Layout, pose: Pose) -> impl Iterator<Item = Cell> + '_ {
    let camera = centre(pose.cell);
    let in_view = move |cell: &Cell| {
        let point = centre(*cell);
        in_frustum(camera, pose.heading, point) && is_clear(layout, pose.cell, point, *cell)
    };
    [pose.cell].into_iter().chain(layout.free_cells().filter(in_view))
}

fn centre(cell: Cell) -> FacePoint {
    (i32::from(cell.x) * CELL + CELL / 2, i32::from(cell.y) * CELL + CELL / 2)
}

fn vector(heading: Heading) -> FacePoint {
    let (x, y) = heading.vector();
    (i32::from(x), i32::from(y))
}

/// Within 45 degrees of the heading to either side.
fn in_frustum(camera: FacePoint, heading: Heading, point: FacePoint) -> bool {
    let (x, y) = vector(heading);
    let (dx, dy) = (point.0 - camera.0, point.1 - camera.1);
    let (ahead, aside) = (dx * x + dy * y, dx * y - dy * x);
    ahead > 0 && aside.abs() <= ahead
}

/// Whether the line from the centre of `from` to `point`, on the border of `last`, crosses free cells only.
/// Passing exactly through a corner counts as clear when the cell beyond is free.
fn is_clear(layout: &Layout, from: Cell, point: FacePoint, last: Cell) -> bool {
    let camera = centre(from);
    let (dx, dy) = (point.0 - camera.0, point.1 - camera.1);
    let (towards_x, towards_y) = (
        if dx > 0 { Heading::E } else { Heading::W },
        if dy > 0 { Heading::N } else { Heading::S },
    );
    // The distance along the line, times |dx * dy|, to the next border across x and across y.
    let (mut next_x, mut next_y) = (CELL / 2 * dy.abs(), CELL / 2 * dx.abs());
    let mut cell = from;
    while cell != last {
        let (cross_x, cross_y) = match (dx, dy) {
            (0, _) => (false, true),
            (_, 0) => (true, false),
            _ => (next_x <= next_y, next_y <= next_x),
        };
        let mut next = Some(cell);
        if cross_x {
            next = next.and_then(|cell| cell.step(towards_x));
            next_x += CELL * dy.abs();
        }
        if cross_y {
            next = next.and_then(|cell| cell.step(towards_y));
            next_y += CELL * dx.abs();
        }
        match next.filter(|&next| layout.is_free(next)) {
            Some(next) => cell = next,
            None => return false,
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Square;
    use crate::testing::tiny;
    use crate::world::Warehouse;
    use domain::Heading::{E, N, S, W};

    #[test]
    fn an_item_is_seen_from_before_it_within_the_frustum_and_past_no_rack() {
        let warehouse = tiny();
        let at = |x, y| warehouse.item_at(Cell::new(x, y)).unwrap();
        for (pose, item, expected, why) in [
            (Pose::new(3, 1, S), at(3, 1), true, "in front of it"),
            (Pose::new(3, 1, N), at(3, 1), false, "behind one's back"),
            (Pose::new(3, 1, E), at(3, 1), false, "beside one, just out of the frustum"),
            (Pose::new(2, 1, E), at(3, 1), true, "ahead and beside"),
            (Pose::new(3, 3, S), at(3, 1), true, "down the aisle between the racks"),
            (Pose::new(0, 1, E), at(3, 1), true, "along the wall, at a flat angle"),
            (Pose::new(2, 3, S), at(3, 1), false, "behind a rack"),
            (Pose::new(5, 1, E), at(6, 2), false, "its rack turns the face away"),
            (Pose::new(6, 3, S), at(6, 2), true, "beside and ahead"),
            (Pose::new(6, 3, W), at(6, 2), false, "the rack is in the way"),
        ] {
            assert_eq!(sees(&warehouse.layout, pose, item), expected, "{pose}: {why}");
        }
    }

    #[test]
    fn cells_in_view_are_ahead_and_not_behind_racks() {
        let warehouse = tiny();
        let seen: Vec<Cell> = cells(&warehouse.layout, Pose::new(3, 1, N)).collect();
        assert_eq!(seen[0], Cell::new(3, 1));
        assert!(seen.contains(&Cell::new(3, 3)), "{seen:?}");
        assert!(!seen.contains(&Cell::new(0, 3)) && !seen.contains(&Cell::new(2, 1)), "{seen:?}");
    }

    /// Whether the segment passes through the inside of `cell`, by clipping it to the cell.
    fn crosses(from: FacePoint, to: FacePoint, cell: Cell) -> bool {
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        let low = (i32::from(cell.x) * CELL, i32::from(cell.y) * CELL);
        for (from, to, low) in [(from.0, to.0, low.0), (from.1, to.1, low.1)] {
            let (from, span) = (f64::from(from), f64::from(to - from));
            let (low, high) = (f64::from(low), f64::from(low + CELL));
            if span == 0.0 {
                if from <= low || from >= high {
                    return false;
                }
                continue;
            }
            let (a, b) = ((low - from) / span, (high - from) / span);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        leave - enter > 1e-9
    }

    proptest::proptest! {
        #[test]
        fn the_line_of_sight_is_clear_when_it_crosses_no_rack(
            cell in 0..1000_usize, item in 0..160_usize, sample in 0..10_usize,
        ) {
            let warehouse = Warehouse::shipped();
            let layout = &warehouse.layout;
            let free: Vec<Cell> = layout.free_cells().collect();
            let (from, item) = (free[cell % free.len()], &warehouse.items[item]);
            let ((fx, fy), (x, y)) = (vector(item.face), centre(item.rack));
            let offset = SAMPLES[sample];
            let point = (x + fx * CELL / 2 + fy * offset, y + fy * CELL / 2 + fx * offset);
            let camera = centre(from);
            proptest::prop_assume!((camera.0 - point.0) * fx + (camera.1 - point.1) * fy > 0);
            let solid = layout.cells().filter(|&cell| layout.square(cell) != Square::Floor);
            let blocked = solid.into_iter().any(|cell| crosses(camera, point, cell));
            proptest::prop_assert_eq!(is_clear(layout, from, point, item.standpoint), !blocked);
        }
    }
}
