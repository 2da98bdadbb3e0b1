//! The six routes of a case, side by side where they run together, and the barricade.

use domain::{Cell, Heading, Pose};

use super::canvas::Canvas;
use super::{CELL, INK, Map, PAPER, Point, direction};
use crate::case::{Case, Start};
use crate::world::Warehouse;

/// Distance between neighbouring routes in one cell.
const LANE: f64 = 5.2;

/// A chevron on every so many moves says which way a route runs.
const CHEVRON_EVERY: usize = 3;

/// How a route is drawn.
pub(super) struct Style {
    pub(super) colour: &'static str,
    pub(super) dashes: &'static str,
    pub(super) width: f64,
    /// Place among the six, from -2.5 to 2.5.
    lane: f64,
}

pub(super) const fn style(start: Start) -> Style {
    let (colour, dashes, width, lane) = match start {
        Start::Original => ("#0b5fa5", "", 2.6, -2.5),
        Start::Opposite => ("#3fa9dc", "", 2.6, -1.5),
        Start::Nearby => ("#2a9d5c", "", 2.6, -0.5),
        Start::Distant => ("#8250c4", "", 2.6, 0.5),
        Start::Test => ("#e8780c", "", 3.2, 1.5),
        Start::Blocked => ("#c81e3a", "7 3.5", 3.2, 2.5),
    };
    Style { colour, dashes, width, lane }
}

impl Map<'_> {
    pub(super) fn routes(&mut self, warehouse: &Warehouse, case: &Case) {
        for &cell in &case.barricade {
            let (x, y) = self.corner(cell);
            barricade(&mut self.canvas, (x, y), CELL);
        }
        for start in Start::ALL {
            let replay = case.replay(warehouse, start);
            self.route(start, &replay.poses);
            let goals = replay.goal_steps.iter().map(|&at| replay.poses[at as usize].cell);
            for cell in goals.collect::<Vec<_>>() {
                self.goal(start, cell);
            }
        }
        for start in Start::ALL {
            self.start_mark(start, case.trajectory(start).start);
        }
    }

    /// The middle of `cell` in the lane of `start`. All of a route is shifted alike, along both axes,
    /// so no two routes cover each other and none is torn at its corners.
    fn in_lane(&self, start: Start, cell: Cell) -> Point {
        let (x, y) = self.centre(cell);
        let shift = style(start).lane * LANE;
        (x + shift, y + shift)
    }

    fn route(&mut self, start: Start, poses: &[Pose]) {
        let mut cells: Vec<Cell> = poses.iter().map(|pose| pose.cell).collect();
        cells.dedup();
        let points: Vec<Point> = cells.iter().map(|&cell| self.in_lane(start, cell)).collect();
        let mut line = String::new();
        for (index, (x, y)) in points.iter().enumerate() {
            line += &format!("{}{x:.1} {y:.1}", if index == 0 { "M" } else { "L" });
        }
        let Style { colour, dashes, width, .. } = style(start);
        let joined = "stroke-linejoin='round' stroke-linecap='round'";
        self.canvas
            .path(&line, &format!("stroke='{PAPER}' stroke-width='{:.1}' {joined}", width + 1.6));
        self.canvas.path(
            &line,
            &format!(
                "stroke='{colour}' stroke-width='{width}' stroke-dasharray='{dashes}' {joined}"
            ),
        );
        for pair in points.windows(2).skip(1).step_by(CHEVRON_EVERY) {
            let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
            let middle = ((ax + bx) / 2.0, (ay + by) / 2.0);
            let angle = (by - ay).atan2(bx - ax).to_degrees();
            chevron(&mut self.canvas, middle, angle, colour);
        }
    }

    /// A dot where a sub-goal is met.
    fn goal(&mut self, start: Start, cell: Cell) {
        let colour = style(start).colour;
        let at = self.in_lane(start, cell);
        self.canvas.circle(
            at,
            3.6,
            &format!("fill='{PAPER}' stroke='{colour}' stroke-width='2.2'"),
        );
    }

    /// A disc that points towards the start's heading. Original and opposite share a cell and point apart;
    /// test and blocked share a pose, and the blocked one is a rim around the other.
    fn start_mark(&mut self, start: Start, pose: Pose) {
        let (x, y) = self.centre(pose.cell);
        let (dx, dy) = direction(pose.heading);
        let pushed = match start {
            Start::Original | Start::Opposite => 10.0,
            Start::Nearby | Start::Distant | Start::Test | Start::Blocked => 0.0,
        };
        start_disc(&mut self.canvas, (x + dx * pushed, y + dy * pushed), start, pose.heading);
    }
}

/// The mark of a start at `at`.
pub(super) fn start_disc(canvas: &mut Canvas, at: Point, start: Start, heading: Heading) {
    let Style { colour, dashes, .. } = style(start);
    if start == Start::Blocked {
        let rim =
            format!("fill='none' stroke='{colour}' stroke-width='2.6' stroke-dasharray='5 2.5'");
        canvas.circle(at, 13.5, &rim);
        return;
    }
    let disc =
        format!("fill='{PAPER}' stroke='{colour}' stroke-width='2.2' stroke-dasharray='{dashes}'");
    canvas.circle(at, 10.0, &disc);
    let (dx, dy) = direction(heading);
    pointer(canvas, at, dy.atan2(dx).to_degrees(), 0.85, &format!("fill='{colour}'"));
}

/// An arrow head of about 15 units, drawn towards `angle` degrees clockwise from east.
pub(super) fn pointer(canvas: &mut Canvas, (x, y): Point, angle: f64, size: f64, look: &str) {
    canvas.open(&format!("transform='translate({x:.1} {y:.1}) rotate({angle:.0}) scale({size})'"));
    canvas.path("M8.5 0L-6 7L-2.5 0L-6 -7Z", &format!("{look} stroke-linejoin='round'"));
    canvas.close();
}

fn chevron(canvas: &mut Canvas, (x, y): Point, angle: f64, colour: &str) {
    canvas.open(&format!("transform='translate({x:.1} {y:.1}) rotate({angle:.0})'"));
    canvas.path("M5 0L-3.2 4.4L-1.2 0L-3.2 -4.4Z", &format!("fill='{colour}'"));
    canvas.close();
}

/// A square of red and white stripes, `size` wide.
pub(super) fn barricade(canvas: &mut Canvas, (x, y): Point, size: f64) {
    let (x, y, size) = (x + 1.5, y + 1.5, size - 3.0);
    canvas.rect((x, y), (size, size), "fill='#ffffff'");
    // Slanted stripes, cut to the square: each rises as far as it runs.
    let stripe = size / 4.0;
    let mut path = String::new();
    for k in [-3.0, -1.0, 1.0, 3.0] {
        let (from, to) = (k * stripe, (k + 1.0) * stripe);
        // Corners of the band from <= u + v <= to of the unit square's diagonal coordinates.
        let at = |sum: f64| {
            let sum = sum + size;
            if sum <= size {
                ((sum, 0.0), (0.0, sum))
            } else {
                ((size, sum - size), (sum - size, size))
            }
        };
        let ((ax, ay), (bx, by)) = at(from);
        let ((cx, cy), (dx, dy)) = at(to);
        path += &format!(
            "M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z",
            x + ax,
            y + ay,
            x + bx,
            y + by,
            x + dx,
            y + dy,
            x + cx,
            y + cy
        );
    }
    canvas.path(&path, "fill='#d7263d'");
    canvas.rect(
        (x, y),
        (size, size),
        &format!("fill='none' stroke='{INK}' stroke-width='1.5' rx='2'"),
    );
}
