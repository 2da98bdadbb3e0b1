//! Whether an item is in view, computed on the floor plan in integers.
//!
//! An item is in view from a pose if some point of its outline on the shelf, or of its label, which is wider than its plate,
//! lies within the camera's field of view and nothing solid is in between, at any distance. Racks are open shelves:
//! behind the faces of a row of bays there is one space, in which an item is visible from the side, past what stands in the
//! bays between. Walls, closed faces, and backs and ends of rows hide everything behind them; items, the posts between two
//! bays and barricades hide nothing. This is conservative: such an item may cover three pixels at the far end of an aisle,
//! or be hidden behind another item, but an item that is *not* in view by this rule is in no image.

use std::cmp::Ordering;

use domain::camera::CameraSetup;
use domain::{Cell, Heading, Pose};

use crate::layout::Layout;
use crate::racks::FaceKind;
use crate::world::{Item, Warehouse};

/// Centimetres in a cell.
const CELL_CM: i32 = 100;

/// How far surfaces of a rack may lie behind the sides of its squares, in centimetres.
const RECESS_CM: i32 = 1;

/// Half the width of the label, which is wider than the plate, in centimetres.
const LABEL_HALF_WIDTH_CM: i32 = 46;

/// How far plate and label stand out from the face, in centimetres.
const PLATE_CM: i32 = 2;

/// How far behind the face an item may begin, and where the middle of its shelf is, in centimetres. In a shallow bay an item
/// is smaller and nearer.
const SHELF_CM: [i32; 2] = [1, 29];

/// Whether `item`, its plate or its label may be in view of `camera` from `pose`.
pub fn sees(warehouse: &Warehouse, camera: CameraSetup, pose: Pose, item: &Item) -> bool {
    let Some(front) = Front::new(&warehouse.layout, (camera, pose), item) else { return false };
    let half = LABEL_HALF_WIDTH_CM;
    let face = front.towards([[half, -PLATE_CM], [half, 0]]).and_then(|fan| front.in_frustum(fan));
    if face.is_some_and(|face| front.is_clear(0, face)) {
        return true;
    }
    let shape = warehouse.catalogue.types[item.item_type].shape;
    let [half_width, half_depth, cut] = shape.outline_cm();
    let [begin, shelf] = SHELF_CM;
    let end = shelf + half_depth;
    let outline = [[half_width, begin], [half_width, end - cut], [half_width - cut, end]];
    let volume = front.towards(outline).and_then(|fan| front.in_frustum(fan));
    volume.is_some_and(|volume| {
        front.is_clear(0, volume)
            && volume
                .and(front.opening(warehouse, item))
                .is_some_and(|inside| front.is_clear(0, inside))
    })
}

/// A direction on the floor plan: so far to the right while coming so far nearer to the rack, which is never negative.
#[derive(Debug, Clone, Copy)]
struct Direction {
    right: i32,
    nearer: i32,
}

impl Direction {
    /// From left to right.
    fn compare(self, other: Self) -> Ordering {
        (self.right * other.nearer).cmp(&(other.right * self.nearer))
    }

    fn min(self, other: Self) -> Self {
        if self.compare(other).is_gt() { other } else { self }
    }

    fn max(self, other: Self) -> Self {
        if self.compare(other).is_lt() { other } else { self }
    }
}

/// The directions between two.
#[derive(Debug, Clone, Copy)]
struct Fan {
    from: Direction,
    to: Direction,
}

impl Fan {
    /// The directions in which a rectangle lies: its left and right side, and how far ahead it begins and ends.
    fn of([left, right]: [i32; 2], [near, far]: [i32; 2]) -> Self {
        let from = Direction { right: left, nearer: if left < 0 { near } else { far } };
        let to = Direction { right, nearer: if right > 0 { near } else { far } };
        Self { from, to }
    }

    /// The directions that are in one of both, and those between.
    fn around(self, other: Self) -> Self {
        Self { from: self.from.min(other.from), to: self.to.max(other.to) }
    }

    /// What both have in common, unless that is a single direction or nothing.
    fn and(self, other: Self) -> Option<Self> {
        let fan = Self { from: self.from.max(other.from), to: self.to.min(other.to) };
        fan.from.compare(fan.to).is_lt().then_some(fan)
    }
}

/// The floor between a camera and the front of a rack. Rows of cells are numbered from the camera's towards the rack, columns
/// from the camera's to the right as seen by one who faces the rack.
struct Front<'w> {
    layout: &'w Layout,
    camera: Pose,
    /// The tangent of half the camera's field of view, in percent.
    half_width_percent: i32,
    /// The direction in which one faces the rack.
    ahead: Heading,
    /// Row and column of the item's standpoint.
    rows: i32,
    columns: i32,
    /// From the camera to the plane of the face, in centimetres.
    distance: i32,
}

impl<'w> Front<'w> {
    /// `None` if the camera is behind the plane of the item's face or looks away from it.
    fn new(layout: &'w Layout, (setup, camera): (CameraSetup, Pose), item: &Item) -> Option<Self> {
        let ahead = item.viewing_heading();
        let along = |heading: Heading| {
            let (x, y) = heading.vector();
            let (from, to) = (camera.cell, item.standpoint);
            i32::from(x) * (i32::from(to.x) - i32::from(from.x))
                + i32::from(y) * (i32::from(to.y) - i32::from(from.y))
        };
        let (rows, columns) = (along(ahead), along(ahead.right()));
        let distance = rows * CELL_CM + CELL_CM / 2;
        (rows >= 0 && camera.heading != item.face).then_some(Self {
            layout,
            camera,
            half_width_percent: setup.half_width_percent.into(),
            ahead,
            rows,
            columns,
            distance,
        })
    }

    /// The directions of points in the item's column: so far to both sides of its middle, and so far behind the face.
    fn towards<const N: usize>(&self, points: [[i32; 2]; N]) -> Option<Fan> {
        let middle = self.columns * CELL_CM;
        let fan = |[half, behind]: [i32; 2]| {
            let depth = self.distance + behind;
            Fan::of([middle - half, middle + half], [depth, depth])
        };
        points.into_iter().map(fan).reduce(Fan::around)
    }

    /// The part of `fan` within the camera's field of view.
    fn in_frustum(&self, fan: Fan) -> Option<Fan> {
        let aside = self.half_width_percent;
        let towards = |right, nearer| Direction { right, nearer };
        fan.and(if self.camera.heading == self.ahead {
            Fan { from: towards(-aside, 100), to: towards(aside, 100) }
        } else if self.camera.heading == self.ahead.right() {
            Fan { from: towards(100, aside), to: towards(1, 0) }
        } else {
            Fan { from: towards(-1, 0), to: towards(-100, aside) }
        })
    }

    /// The directions that enter the bay of `item`, or one of those beside it from which nothing separates it, towards the
    /// camera.
    fn opening(&self, warehouse: &Warehouse, item: &Item) -> Fan {
        let towards = if self.columns > 0 { self.ahead.left() } else { self.ahead.right() };
        let mut bays = 0;
        let mut rack = item.rack;
        while bays < self.columns.abs() {
            let next = rack.step(towards);
            let bay = next.filter(|&next| warehouse.face(next, item.face) == FaceKind::Bay);
            let Some(bay) = bay else { break };
            rack = bay;
            bays += 1;
        }
        let (middle, more) = (self.columns * CELL_CM, bays * CELL_CM);
        let [left, right] = [middle - CELL_CM / 2, middle + CELL_CM / 2];
        let sides = if self.columns > 0 { [left - more, right] } else { [left, right + more] };
        let depth = self.distance + RECESS_CM;
        Fan::of(sides, [depth, depth])
    }

    /// Whether a direction of `fan` is clear of everything solid, from row `row` to the face.
    fn is_clear(&self, row: i32, fan: Fan) -> bool {
        let Some((row, hidden)) = self.first_hidden(row, fan) else { return true };
        let left = Fan { from: fan.from, to: fan.to.min(hidden.from) };
        let right = Fan { from: fan.from.max(hidden.to), to: fan.to };
        [left, right]
            .into_iter()
            .any(|rest| rest.from.compare(rest.to).is_lt() && self.is_clear(row, rest))
    }

    /// The first row from `row` on with a solid square in one of the directions of `fan`, and the directions that one hides.
    /// Columns beyond the camera's and the item's are in no line of sight.
    fn first_hidden(&self, row: i32, fan: Fan) -> Option<(i32, Fan)> {
        (row..=self.rows).find_map(|row| {
            let [near, far] = [(row * CELL_CM - CELL_CM / 2).max(0), row * CELL_CM + CELL_CM / 2];
            let column = |direction: Direction, ahead: i32| {
                (direction.right * ahead + direction.nearer * CELL_CM / 2)
                    .div_euclid(direction.nearer * CELL_CM)
            };
            let first = column(fan.from, near).min(column(fan.from, far));
            let last = column(fan.to, near).max(column(fan.to, far));
            (first.max(self.columns.min(0))..=last.min(self.columns.max(0))).find_map(|column| {
                let hidden = self.hidden_by(row, column)?;
                fan.and(hidden).map(|_| (row, hidden))
            })
        })
    }

    /// The directions that the square at this place hides; `None` if it is free.
    fn hidden_by(&self, row: i32, column: i32) -> Option<Fan> {
        if self.is_free(row, column) {
            return None;
        }
        let recess = |row, column| if self.is_free(row, column) { RECESS_CM } else { 0 };
        let (x, y) = (column * CELL_CM, row * CELL_CM);
        let half = CELL_CM / 2;
        let sides = [x - half + recess(row, column - 1), x + half - recess(row, column + 1)];
        let near = (y - half + recess(row - 1, column)).max(0);
        Some(Fan::of(sides, [near, y + half - recess(row + 1, column)]))
    }

    fn is_free(&self, row: i32, column: i32) -> bool {
        let ((ax, ay), (rx, ry)) = (self.ahead.vector(), self.ahead.right().vector());
        let at = |from: u8, ahead: i8, right: i8| {
            u8::try_from(i32::from(from) + row * i32::from(ahead) + column * i32::from(right))
        };
        let Cell { x, y } = self.camera.cell;
        match (at(x, ax, rx), at(y, ay, ry)) {
            (Ok(x), Ok(y)) => self.layout.is_free(Cell::new(x, y)),
            _ => false,
        }
    }
}

/// Length units in a cell for single lines of sight: faces are sampled every 10 cm, at odd offsets, so never at a corner.
const CELL: i32 = 20;

/// Offsets of the sampled points from the middle of a rack face, along it.
const SAMPLES: [i32; 10] = [-9, -7, -5, -3, -1, 1, 3, 5, 7, 9];

type FacePoint = (i32, i32);

/// Whether a sampled point of the face of `item` is in view from `pose`, on a line of sight over floor. What shows its face
/// [shows](sees) the item.
pub fn shows_face(layout: &Layout, pose: Pose, item: &Item) -> bool {
    let camera = centre(pose.cell);
    let (face_x, face_y) = vector(item.face);
    let (rack_x, rack_y) = centre(item.rack);
    let middle = (rack_x + face_x * CELL / 2, rack_y + face_y * CELL / 2);
    let in_front = (camera.0 - middle.0) * face_x + (camera.1 - middle.1) * face_y > 0;
    in_front
        && SAMPLES.iter().any(|offset| {
            let point = (middle.0 + face_y * offset, middle.1 + face_x * offset);
            in_frustum(CameraSetup::STANDARD, camera, pose.heading, point)
                && is_clear(layout, pose.cell, point, item.standpoint)
        })
}

/// The free cells whose middle is in view of a camera from `pose`, its own first.
pub fn cells(layout: &Layout, setup: CameraSetup, pose: Pose) -> impl Iterator<Item = Cell> + '_ {
    let camera = centre(pose.cell);
    let in_view = move |cell: &Cell| {
        let point = centre(*cell);
        in_frustum(setup, camera, pose.heading, point) && is_clear(layout, pose.cell, point, *cell)
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

/// Whether a point is in the field of view of a camera, as far as nothing hides it.
fn in_frustum(setup: CameraSetup, camera: FacePoint, heading: Heading, point: FacePoint) -> bool {
    let (x, y) = vector(heading);
    let (dx, dy) = (point.0 - camera.0, point.1 - camera.1);
    let (ahead, aside) = (dx * x + dy * y, dx * y - dy * x);
    ahead > 0 && aside.abs() * 100 <= ahead * i32::from(setup.half_width_percent)
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
            assert_eq!(shows_face(&warehouse.layout, pose, item), expected, "{pose}: {why}");
        }
    }

    #[test]
    fn cells_in_view_are_ahead_and_not_behind_racks() {
        let warehouse = tiny();
        let seen: Vec<Cell> =
            cells(&warehouse.layout, CameraSetup::STANDARD, Pose::new(3, 1, N)).collect();
        assert_eq!(seen[0], Cell::new(3, 1));
        assert!(seen.contains(&Cell::new(3, 3)), "{seen:?}");
        assert!(!seen.contains(&Cell::new(0, 3)) && !seen.contains(&Cell::new(2, 1)), "{seen:?}");
    }

    #[test]
    fn an_item_is_seen_through_the_open_bays_beside_it() {
        let warehouse = Warehouse::shipped();
        for (pose, standpoint, expected, why) in [
            (Pose::new(12, 26, W), (12, 25), true, "past the post of the bay before it"),
            (Pose::new(1, 26, E), (4, 28), true, "past a corner that lies behind its square's"),
            (Pose::new(15, 13, N), (12, 20), false, "its far corner is just hidden"),
            (Pose::new(12, 26, E), (12, 25), false, "behind one's back"),
            (Pose::new(13, 26, W), (12, 25), true, "its face, ahead and beside"),
        ] {
            let item = warehouse.item_at(Cell::new(standpoint.0, standpoint.1)).unwrap();
            let standard = CameraSetup::STANDARD;
            assert_eq!(sees(&warehouse, standard, pose, item), expected, "{pose}: {why}");
        }
        let item = warehouse.item_at(Cell::new(12, 25)).unwrap();
        assert!(!shows_face(&warehouse.layout, Pose::new(12, 26, W), item));
    }

    #[test]
    fn a_narrower_camera_sees_less_and_nothing_else() {
        let warehouse = Warehouse::shipped();
        let narrow = CameraSetup { half_width_percent: 70, ..CameraSetup::STANDARD };
        let (mut wide, mut seen) = (0, 0);
        for cell in warehouse.layout.free_cells() {
            for pose in Heading::ALL.map(|heading| Pose { cell, heading }) {
                for item in &warehouse.items {
                    let [of_standard, of_narrow] = [CameraSetup::STANDARD, narrow]
                        .map(|camera| sees(&warehouse, camera, pose, item));
                    assert!(of_standard || !of_narrow, "{pose}: item {}", item.id);
                    (wide, seen) = (wide + u32::from(of_standard), seen + u32::from(of_narrow));
                }
            }
        }
        assert!(seen < wide, "{seen} of {wide}");
        // Two metres ahead and two to the side is 45 degrees.
        let (layout, pose) = (&warehouse.layout, Pose::new(12, 26, W));
        let cells_of = |camera| cells(layout, camera, pose).collect::<Vec<_>>();
        assert!(cells_of(narrow).len() < cells_of(CameraSetup::STANDARD).len());
    }

    #[test]
    fn what_shows_a_face_shows_the_item() {
        for warehouse in [tiny(), Warehouse::shipped()] {
            let (mut faces, mut seen) = (0, 0);
            for cell in warehouse.layout.free_cells() {
                for pose in Heading::ALL.map(|heading| Pose { cell, heading }) {
                    for item in &warehouse.items {
                        let shows_face = shows_face(&warehouse.layout, pose, item);
                        let sees = sees(&warehouse, CameraSetup::STANDARD, pose, item);
                        assert!(sees || !shows_face, "{pose}: item {}", item.id);
                        (faces, seen) = (faces + u32::from(shows_face), seen + u32::from(sees));
                    }
                }
            }
            // Hardly an item is seen otherwise.
            assert!(4 * seen <= 5 * faces, "{seen} items in view, {faces} faces");
        }
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
