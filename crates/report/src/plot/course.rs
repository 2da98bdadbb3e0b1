//! Percentages over the blocks of a stream, with the events between blocks marked.

use super::curves::{draw_curve, legend};
use super::{BOTTOM, Curve, RIGHT, ReportFigure, Stroke, Svg, TextAnchor, TextStyle, WIDTH};

/// A plot of curves over blocks.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    pub(crate) id: String,
    pub(crate) caption: String,
    pub(crate) blocks: u32,
    /// A point is a place in blocks, from 0 to their number, and a percentage.
    pub(crate) curves: Vec<Curve>,
}

const HEIGHT: i32 = 260;
const AXIS: i32 = 60;

/// Draws the plot.
pub(crate) fn course(plot: &Course) -> ReportFigure {
    let names: Vec<(&str, bool)> =
        plot.curves.iter().map(|curve| (curve.name.as_str(), curve.is_bound)).collect();
    let mut body = Svg::new(0);
    let (shapes, legend_bottom) = legend(&mut body, &names);
    let top = legend_bottom + 28;
    let bottom = top + HEIGHT;
    let mut svg = Svg { height: bottom + BOTTOM, ..body };
    let x = |at: f64| {
        let share = at / f64::from(plot.blocks.max(1));
        AXIS + (share * f64::from(WIDTH - RIGHT - AXIS)).round() as i32
    };
    let y = |percent: f64| bottom - (percent / 100.0 * f64::from(HEIGHT)).round() as i32;
    for mark in [0, 25, 50, 75, 100] {
        let at = y(f64::from(mark));
        svg.line(&[(AXIS, at), (WIDTH - RIGHT, at)], Stroke::Rule);
        svg.text(&mark.to_string(), (AXIS - 8, at), TextAnchor::Before, TextStyle::Plain);
    }
    for block in 0..plot.blocks {
        let (from, middle) = (x(f64::from(block)), x(f64::from(block) + 0.5));
        if block > 0 {
            svg.dashed([(from, top - 8), (from, bottom)]);
            svg.text("events", (from + 4, top - 12), TextAnchor::Around, TextStyle::Faint);
        }
        let name = format!("block {block}");
        svg.text(&name, (middle, bottom + 14), TextAnchor::Around, TextStyle::Plain);
    }
    svg.text("Success, %", (8, top - 14), TextAnchor::After, TextStyle::Faint);
    for (curve, shape) in plot.curves.iter().zip(shapes) {
        let pixels: Vec<(i32, i32)> =
            curve.points.iter().map(|(at, percent)| (x(*at), y(*percent))).collect();
        draw_curve(&mut svg, &pixels, shape);
    }
    let in_words = plot.curves.iter().map(|curve| {
        let values: Vec<String> =
            curve.points.iter().map(|(_, percent)| format!("{percent:.0}")).collect();
        format!("{}: {}", curve.name, values.join(", "))
    });
    svg.finish(&plot.id, &plot.caption, in_words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_stand_between_blocks_and_the_text_has_the_values() {
        let curve = |name: &str, is_bound| Curve {
            name: name.to_owned(),
            is_bound,
            points: vec![(0.5, 100.0), (1.5, 25.0)],
        };
        let figure = course(&Course {
            id: "course".to_owned(),
            caption: "Success.".to_owned(),
            blocks: 3,
            curves: vec![curve("frozen", false), curve("no memory", true)],
        });
        assert_eq!(figure.alt, "Success. frozen: 100, 25; no memory: 100, 25");
        assert_eq!(figure.svg().matches(">events<").count(), 2);
        assert_eq!(figure.svg().matches("<circle").count(), 4, "two points, and two in the legend");
        assert!(figure.svg().contains("block 2") && !figure.svg().contains("block 3"));
    }
}
