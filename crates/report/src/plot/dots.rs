//! Success rates as dots with error bars: a row for each condition, a shape for each source.

use super::drawing::Point;
use super::{
    BOTTOM, Drawing, GRAY, HEADING, INK, LEFT, Paint, ReportFigure, TextAnchor, TextStyle,
    ValueAxis,
};
use crate::view::{OURS, THEIRS};

/// A row.
#[derive(Debug)]
pub(crate) struct DotRow {
    /// A heading above this row.
    pub(crate) heading: Option<String>,
    pub(crate) label: String,
    pub(crate) ours: Dot,
    pub(crate) published: Option<Dot>,
}

/// A success rate, in percent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Dot {
    pub(crate) value: f64,
    /// Its error bar.
    pub(crate) range: Option<(f64, f64)>,
}

const ROW: i32 = 24;
const LEGEND: i32 = 34;

/// Draws the plot.
pub(crate) fn dots(id: &str, caption: &str, rows: &[DotRow]) -> ReportFigure {
    let headings = rows.iter().filter(|row| row.heading.is_some()).count() as i32;
    let bottom = LEGEND + headings * HEADING + rows.len() as i32 * ROW + 4;
    let axis = ValueAxis { from: 0.0, to: 100.0 };
    let mut drawing = Drawing::new(bottom + BOTTOM);
    draw_legend(&mut drawing, rows);
    axis.draw(&mut drawing, "Success rate, %", LEGEND, bottom);
    let mut y = LEGEND;
    for row in rows {
        if let Some(heading) = &row.heading {
            drawing.heading(heading, y);
            y += HEADING;
        }
        draw_row(&mut drawing, &axis, row, y + ROW / 2);
        y += ROW;
    }
    ReportFigure::new(drawing, id, caption, rows.iter().map(in_words))
}

/// Lists the sources that have a dot.
fn draw_legend(drawing: &mut Drawing, rows: &[DotRow]) {
    let mut x = LEFT + 6;
    let has_published = rows.iter().any(|row| row.published.is_some());
    for (name, is_published) in [(OURS, false), (THEIRS, true)] {
        if is_published && !has_published {
            continue;
        }
        draw_mark(drawing, is_published, (x, LEGEND / 2 - 2));
        drawing.text(name, (x + 12, LEGEND / 2 - 2), TextAnchor::After, TextStyle::PLAIN);
        x += 40 + 8 * name.chars().count() as i32;
    }
}

fn draw_row(drawing: &mut Drawing, axis: &ValueAxis, row: &DotRow, y: i32) {
    drawing.row_label(&row.label, y);
    // One above the other, so that bars do not hide each other.
    let apart = if row.published.is_some() { 5 } else { 0 };
    draw_dot(drawing, axis, &row.ours, false, y - apart);
    if let Some(published) = &row.published {
        draw_dot(drawing, axis, published, true, y + apart);
    }
}

fn draw_dot(drawing: &mut Drawing, axis: &ValueAxis, dot: &Dot, is_published: bool, y: i32) {
    if let Some((low, high)) = dot.range {
        let stroke = if is_published { GRAY } else { INK };
        drawing.horizontal_interval((axis.x(low), axis.x(high)), y, stroke);
    }
    draw_mark(drawing, is_published, (axis.x(dot.value), y));
}

/// The shape of a source: filled circle, open diamond.
fn draw_mark(drawing: &mut Drawing, is_published: bool, (x, y): Point) {
    if is_published {
        drawing.polygon(&[(x, y - 5), (x + 5, y), (x, y + 5), (x - 5, y)], Paint::OPEN_GRAY);
    } else {
        drawing.circle((x, y), Paint::INK);
    }
}

fn in_words(row: &DotRow) -> String {
    let heading = row.heading.as_ref().map_or(String::new(), |heading| format!("{heading}: "));
    let published = row.published.map(|dot| format!(", {THEIRS} {:.1}", dot.value));
    let published = published.unwrap_or_default();
    format!("{heading}{} {OURS} {:.1}{published}", row.label, row.ours.value)
}
