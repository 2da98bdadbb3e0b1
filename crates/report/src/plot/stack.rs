//! Stacked bars: a row for each bar, parts in the same order everywhere, told apart by tone and hatching.

use super::drawing::Point;
use super::{
    BOTTOM, Drawing, HEADING, INK, LEFT, Paint, ReportFigure, Stroke, TextAnchor, TextStyle, Tone,
    ValueAxis,
};

/// A plot of stacked bars.
#[derive(Debug)]
pub struct Stack {
    /// The figure's id.
    pub id: String,
    /// Its caption.
    pub caption: String,
    /// The name of the axis, with its unit.
    pub axis: &'static str,
    /// The end of the axis; `None`: that of the longest bar.
    pub to: Option<f64>,
    /// The names of the parts, in order.
    pub parts: Vec<String>,
    /// The bars.
    pub rows: Vec<StackRow>,
}

/// A bar.
#[derive(Debug)]
pub struct StackRow {
    /// A heading above this bar.
    pub heading: Option<String>,
    /// Its label.
    pub label: String,
    /// A length for each part; `None` when there is no bar.
    pub lengths: Option<Vec<f64>>,
}

const ROW: i32 = 28;
const LEGEND_ROW: i32 = 22;
const LEGEND_COLUMNS: usize = 3;

/// Draws the plot. Parts that no bar has are left out, from the legend too.
pub fn stack(plot: &Stack) -> ReportFigure {
    let lengths = || plot.rows.iter().filter_map(|row| row.lengths.as_deref());
    let present: Vec<usize> = (0..plot.parts.len())
        .filter(|&part| lengths().any(|lengths| lengths.get(part).is_some_and(|l| *l > 0.0)))
        .collect();
    let longest = lengths().map(|lengths| lengths.iter().sum::<f64>()).fold(0.0, f64::max);
    let to = plot.to.unwrap_or(longest * 1.04);
    let axis = ValueAxis { from: 0.0, to: if to > 0.0 { to } else { 1.0 } };
    let top = 12 + LEGEND_ROW * present.len().div_ceil(LEGEND_COLUMNS) as i32;
    let headings = plot.rows.iter().filter(|row| row.heading.is_some()).count() as i32;
    let bottom = top + headings * HEADING + plot.rows.len() as i32 * ROW + 6;
    let mut drawing = Drawing::new(bottom + BOTTOM);
    for (place, &part) in present.iter().enumerate() {
        let x = 12 + 270 * (place % LEGEND_COLUMNS) as i32;
        let y = LEGEND_ROW / 2 + LEGEND_ROW * (place / LEGEND_COLUMNS) as i32;
        draw_part(&mut drawing, place, [(x, y - 8), (x + 22, y + 8)]);
        drawing.text(&plot.parts[part], (x + 30, y), TextAnchor::After, TextStyle::PLAIN);
    }
    axis.draw(&mut drawing, plot.axis, top, bottom);
    let mut y = top;
    for row in &plot.rows {
        if let Some(heading) = &row.heading {
            drawing.heading(heading, y);
            y += HEADING;
        }
        draw_row(&mut drawing, &axis, row, &present, y);
        y += ROW;
    }
    let rows = plot.rows.iter().map(|row| in_words(row, &plot.parts));
    ReportFigure::new(drawing, &plot.id, &plot.caption, rows)
}

fn draw_row(drawing: &mut Drawing, axis: &ValueAxis, row: &StackRow, present: &[usize], y: i32) {
    drawing.row_label(&row.label, y + ROW / 2);
    let Some(lengths) = &row.lengths else {
        return drawing.text(
            "not run",
            (LEFT + 6, y + ROW / 2),
            TextAnchor::After,
            TextStyle::FAINT,
        );
    };
    let mut from = 0.0;
    for (place, &part) in present.iter().enumerate() {
        let to = from + lengths.get(part).copied().unwrap_or(0.0);
        let corners = [(axis.x(from), y + 4), (axis.x(to), y + ROW - 4)];
        if corners[0].0 < corners[1].0 {
            draw_part(drawing, place, corners);
        }
        from = to;
    }
}

/// How a part is filled. Neighbours in this order differ in print, in gray, and for all kinds of colour vision.
enum Fill {
    Tone(Tone),
    /// Lines on paper, in these directions.
    Hatched(&'static [Direction]),
}

#[derive(Clone, Copy)]
enum Direction {
    Up,
    Down,
    Across,
    Upright,
}

const FILLS: [Fill; 10] = [
    Fill::Tone(Tone::Gray(0x50)),
    Fill::Hatched(&[Direction::Up]),
    Fill::Tone(Tone::Gray(0xc4)),
    Fill::Hatched(&[Direction::Down]),
    Fill::Tone(Tone::Ink),
    Fill::Tone(Tone::Paper),
    Fill::Hatched(&[Direction::Up, Direction::Down]),
    Fill::Tone(Tone::Gray(0x8c)),
    Fill::Hatched(&[Direction::Upright]),
    Fill::Hatched(&[Direction::Across]),
];

/// Draws the part with this place among those present.
fn draw_part(drawing: &mut Drawing, place: usize, corners: [Point; 2]) {
    match FILLS[place % FILLS.len()] {
        Fill::Tone(tone) => drawing.rectangle(corners, Paint::outlined(tone)),
        Fill::Hatched(directions) => {
            drawing.rectangle(corners, Paint::outlined(Tone::Paper));
            for direction in directions {
                hatch(drawing, *direction, corners);
            }
        }
    }
}

/// Draws lines of one direction in a rectangle. Where they cross a place does not depend on the rectangle, so that the parts of all
/// bars look alike.
fn hatch(drawing: &mut Drawing, direction: Direction, [(left, top), (right, bottom)]: [Point; 2]) {
    /// The distance of neighbouring lines across, in pixels.
    const APART: i32 = 7;
    const THIN: Stroke = Stroke { width: 0.8, ..INK };
    let height = bottom - top;
    let multiples = |from: i32, to: i32| {
        let first = from.div_euclid(APART) + 1;
        (first..).map(|multiple| multiple * APART).take_while(move |at| *at < to)
    };
    match direction {
        Direction::Upright => {
            for x in multiples(left, right) {
                drawing.line(&[(x, top), (x, bottom)], THIN);
            }
        }
        Direction::Across => {
            for y in multiples(top, bottom) {
                drawing.line(&[(left, y), (right, y)], THIN);
            }
        }
        // From the bottom at `x` to the right and up, or from the top and down, as far as the rectangle goes.
        Direction::Up | Direction::Down => {
            for x in multiples(left - height, right) {
                let (from, to) = (x.max(left), (x + height).min(right));
                let at = |place: i32| match direction {
                    Direction::Down => (place, top + place - x),
                    _ => (place, bottom - (place - x)),
                };
                drawing.line(&[at(from), at(to)], THIN);
            }
        }
    }
}

fn in_words(row: &StackRow, parts: &[String]) -> String {
    let heading = row.heading.as_ref().map_or(String::new(), |heading| format!("{heading}: "));
    let label = format!("{heading}{}", row.label);
    let Some(lengths) = &row.lengths else { return format!("{label}: not run") };
    let parts: Vec<String> = parts
        .iter()
        .zip(lengths)
        .filter(|(_, length)| **length > 0.0)
        .map(|(part, length)| format!("{part} {length:.1}"))
        .collect();
    let parts = if parts.is_empty() { "nothing".to_owned() } else { parts.join(", ") };
    format!("{label}: {parts}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::drawing::Shape;

    #[test]
    fn hatching_stays_within_its_part() {
        let corners = [(103, 20), (131, 40)];
        for direction in [Direction::Up, Direction::Down, Direction::Across, Direction::Upright] {
            let mut drawing = Drawing::new(100);
            hatch(&mut drawing, direction, corners);
            assert!(drawing.shapes.len() >= 2);
            for shape in &drawing.shapes {
                let Shape::Line { points, .. } = shape else { panic!("{shape:?}") };
                for (x, y) in points {
                    assert!((103..=131).contains(x) && (20..=40).contains(y), "{points:?}");
                }
            }
        }
        let mut drawing = Drawing::new(100);
        hatch(&mut drawing, Direction::Up, [(8, 0), (8, 20)]);
        assert!(
            drawing
                .shapes
                .iter()
                .all(|shape| matches!(shape, Shape::Line { points, .. } if points[0].0 == 8))
        );
    }

    #[test]
    fn no_digits_stand_on_bars_that_are_no_counts() {
        let figure = stack(&Stack {
            id: "failures".to_owned(),
            caption: "Failures.".to_owned(),
            axis: "%",
            to: Some(100.0),
            parts: vec!["loop".to_owned(), "never-saw".to_owned(), "other".to_owned()],
            rows: vec![StackRow {
                heading: None,
                label: "episodic".to_owned(),
                lengths: Some(vec![25.0, 50.0, 0.0]),
            }],
        });
        assert_eq!(figure.alt, "Failures. episodic: loop 25.0, never-saw 50.0");
        let svg = figure.svg();
        assert_eq!(svg.matches("<polygon").count(), 4, "two parts, and two in the legend");
        assert!(!svg.contains("other") && !svg.contains(">1<") && !svg.contains(">2<"));
    }
}
