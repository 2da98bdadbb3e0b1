//! Percentages over the blocks of a stream with their intervals: a panel for each curve, all to one scale, with the bounds in each.

use super::curves::draw_curve;
use super::drawing::Point;
use super::{Drawing, GRAY, GRID, INK, ReportFigure, Stroke, TextAnchor, TextStyle, WIDTH};

/// A plot of curves over blocks.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    pub(crate) id: String,
    pub(crate) caption: String,
    pub(crate) blocks: u32,
    pub(crate) curves: Vec<CourseCurve>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CourseCurve {
    pub(crate) name: String,
    /// Whether it is a bound that others are compared with: drawn gray, without points, in every panel.
    pub(crate) is_bound: bool,
    pub(crate) points: Vec<CoursePoint>,
}

/// A percentage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CoursePoint {
    /// Its place in blocks, from 0 to their number.
    pub(crate) at: f64,
    pub(crate) percent: f64,
    pub(crate) interval: Option<(f64, f64)>,
}

/// Panels in a row.
const IN_ROW: i32 = 2;
const GAP: i32 = 20;
/// The width and height of a panel's plot, and the room around it.
const PLOT: (i32, i32) = ((WIDTH - (IN_ROW - 1) * GAP) / IN_ROW - LEFT - 4, 150);
const LEFT: i32 = 44;
const TOP: i32 = 34;
const BOTTOM: i32 = 40;

/// Draws the plot.
pub(crate) fn course(plot: &Course) -> ReportFigure {
    let panels = plot.curves.iter().filter(|curve| !curve.is_bound);
    let rows = (panels.clone().count() as i32 + IN_ROW - 1) / IN_ROW;
    let height = TOP + PLOT.1 + BOTTOM;
    let mut drawing = Drawing::new(rows * height);
    for (curve, place) in panels.zip(0..) {
        let corner = (place % IN_ROW * (LEFT + PLOT.0 + 4 + GAP), place / IN_ROW * height);
        draw_panel(&mut drawing, plot, curve, corner);
    }
    let in_words = plot.curves.iter().map(|curve| {
        let values: Vec<String> =
            curve.points.iter().map(|point| format!("{:.0}", point.percent)).collect();
        format!("{}: {}", curve.name, values.join(", "))
    });
    ReportFigure::new(drawing, &plot.id, &plot.caption, in_words)
}

fn draw_panel(drawing: &mut Drawing, plot: &Course, curve: &CourseCurve, (left, top): Point) {
    let (start, bottom) = (left + LEFT, top + TOP + PLOT.1);
    let x = |at: f64| {
        let share = at / f64::from(plot.blocks.max(1));
        start + (share * f64::from(PLOT.0)).round() as i32
    };
    let y = |percent: f64| bottom - (percent / 100.0 * f64::from(PLOT.1)).round() as i32;
    drawing.text(&curve.name, (left, top + 12), TextAnchor::After, TextStyle::BOLD);
    for mark in [0, 50, 100] {
        let at = y(f64::from(mark));
        drawing.line(&[(start, at), (start + PLOT.0, at)], GRID);
        drawing.text(&mark.to_string(), (start - 8, at), TextAnchor::Before, TextStyle::PLAIN);
    }
    for block in 0..plot.blocks {
        let (from, middle) = (x(f64::from(block)), x(f64::from(block) + 0.5));
        if block > 0 {
            drawing.line(&[(from, top + TOP), (from, bottom)], Stroke { dashes: &[6, 4], ..GRAY });
        }
        drawing.text(
            &block.to_string(),
            (middle, bottom + 14),
            TextAnchor::Around,
            TextStyle::PLAIN,
        );
    }
    let legend = (x(f64::from(plot.blocks) / 2.0), bottom + 30);
    drawing.text("block", legend, TextAnchor::Around, TextStyle::FAINT);
    let pixels = |curve: &CourseCurve| -> Vec<Point> {
        curve.points.iter().map(|point| (x(point.at), y(point.percent))).collect()
    };
    for bound in plot.curves.iter().filter(|curve| curve.is_bound) {
        draw_curve(drawing, &pixels(bound), None);
    }
    for point in &curve.points {
        if let Some((low, high)) = point.interval {
            drawing.vertical_interval(x(point.at), (y(low), y(high)), INK);
        }
    }
    draw_curve(drawing, &pixels(curve), Some(0));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_curve_has_a_panel_with_its_intervals_and_the_bounds() {
        let point = |at, percent, interval| CoursePoint { at, percent, interval };
        let curve = |name: &str, is_bound| CourseCurve {
            name: name.to_owned(),
            is_bound,
            points: vec![point(0.5, 100.0, None), point(1.5, 25.0, Some((5.0, 45.0)))],
        };
        let figure = course(&Course {
            id: "course".to_owned(),
            caption: "Success.".to_owned(),
            blocks: 3,
            curves: vec![
                curve("frozen", false),
                curve("learning", false),
                curve("no memory", true),
            ],
        });
        assert_eq!(figure.alt, "Success. frozen: 100, 25; learning: 100, 25; no memory: 100, 25");
        let svg = figure.svg();
        assert_eq!(svg.matches("stroke-dasharray").count(), 2 * 2, "events between three blocks");
        assert_eq!(svg.matches("<circle").count(), 2 * 2, "a bound has no points");
        assert_eq!(svg.matches(r#"stroke-width="3""#).count(), 2, "the bound is in both panels");
    }
}
