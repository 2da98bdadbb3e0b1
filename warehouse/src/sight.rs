//! Whether the camera sees an item, decided on the grid in integers.
//!
//! An item is seen from a pose when some point of its rack face lies within the camera's 90 degrees and
//! nothing solid stands between, at whatever distance. That is generous: the renderer may show such an
//! item as three pixels at the far end of an aisle. What is *not* seen by this rule is in no picture, so the rule
//! serves the constraint that a first view must not show the target. Barricades hide nothing here.

use shm_types::{Cell, Heading, Pose};

use crate::layout::Layout;
use crate::world::Item;

/// Length units in a cell: faces are sampled every 10 cm, at odd offsets, so never at a corner.
const CELL: i32 = 20;

/// Offsets of the sampled points from the middle of a rack face, along it.
const SAMPLES: [i32; 10] = [-9, -7, -5, -3, -1, 1, 3, 5, 7, 9];

type Point = (i32, i32);

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

fn centre(cell: Cell) -> Point {
    (i32::from(cell.x) * CELL + CELL / 2, i32::from(cell.y) * CELL + CELL / 2)
}

fn vector(heading: Heading) -> Point {
    let (x, y) = heading.vector();
    (i32::from(x), i32::from(y))
}

/// Within 45 degrees of the heading to either side.
fn in_frustum(camera: Point, heading: Heading, point: Point) -> bool {
    let (x, y) = vector(heading);
    let (dx, dy) = (point.0 - camera.0, point.1 - camera.1);
    let (ahead, aside) = (dx * x + dy * y, dx * y - dy * x);
    ahead > 0 && aside.abs() <= ahead
}

/// Whether the line from the centre of `from` to `point`, on the border of `last`, crosses free cells only.
/// Passing exactly through a corner counts as clear when the cell beyond is free.
fn is_clear(layout: &Layout, from: Cell, point: Point, last: Cell) -> bool {
    let camera = centre(from);
    let (dx, dy) = (point.0 - camera.0, point.1 - camera.1);
    let (towards_x, towards_y) = (
        if dx > 0 { Heading::E } else { Heading::W },
        if dy > 0 { Heading::N } else { Heading::S },
    );
    // How far along the line, times |dx * dy|, the next border across x and across y is.
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
