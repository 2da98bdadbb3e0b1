//! The six routes of a case, side by side where they overlap, and the barricade.

use domain::{Cell, Pose};

use super::canvas::{CELL, DrawingPoint, PAPER};
use super::floor::Map;
use super::marks::{Style, barricade, chevron, direction, start_disc, style};
use crate::case::{Case, Start};
use crate::world::Warehouse;

/// Distance between neighbouring routes in one cell.
const LANE: f64 = 5.2;

/// Every this many moves, a chevron shows the direction of a route.
const CHEVRON_EVERY: usize = 3;

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

    /// The middle of `cell` in the lane of `start`. A whole route is shifted along both axes, so routes neither cover each
    /// other nor break at corners.
    fn in_lane(&self, start: Start, cell: Cell) -> DrawingPoint {
        let (x, y) = self.centre(cell);
        let shift = style(start).lane * LANE;
        (x + shift, y + shift)
    }

    fn route(&mut self, start: Start, poses: &[Pose]) {
        let mut cells: Vec<Cell> = poses.iter().map(|pose| pose.cell).collect();
        cells.dedup();
        let points: Vec<DrawingPoint> =
            cells.iter().map(|&cell| self.in_lane(start, cell)).collect();
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

    /// A dot where a sub-goal is completed.
    fn goal(&mut self, start: Start, cell: Cell) {
        let colour = style(start).colour;
        let at = self.in_lane(start, cell);
        self.canvas.circle(
            at,
            3.6,
            &format!("fill='{PAPER}' stroke='{colour}' stroke-width='2.2'"),
        );
    }

    /// A disc with an arrow in the direction of the start's heading. Original and opposite share a cell and are moved apart;
    /// test and blocked share a pose, and the blocked one is a ring around the other.
    fn start_mark(&mut self, start: Start, pose: Pose) {
        let (x, y) = self.centre(pose.cell);
        let (dx, dy) = direction(pose.heading);
        let pushed = match start {
            Start::Original | Start::Opposite | Start::After | Start::Elsewhere => 10.0,
            Start::Nearby | Start::Distant | Start::Test | Start::Blocked => 0.0,
        };
        start_disc(&mut self.canvas, (x + dx * pushed, y + dy * pushed), start, pose.heading);
    }
}
