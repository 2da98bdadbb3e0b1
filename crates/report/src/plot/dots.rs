//! Success rates as dots with error bars: a row for each condition, a shape for each source.

use super::{BOTTOM, LEFT, Paint, ReportFigure, Stroke, Svg, TextAnchor, TextStyle, ValueAxis};
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
const HEADING: i32 = 26;
const LEGEND: i32 = 34;

/// Draws the plot.
pub(crate) fn dots(id: &str, caption: &str, rows: &[DotRow]) -> ReportFigure {
    let headings = rows.iter().filter(|row| row.heading.is_some()).count() as i32;
    let bottom = LEGEND + headings * HEADING + rows.len() as i32 * ROW + 4;
    let axis = ValueAxis { from: 0.0, to: 100.0 };
    let mut svg = Svg::new(bottom + BOTTOM);
    draw_legend(&mut svg, rows);
    axis.draw(&mut svg, "Success rate, %", LEGEND, bottom);
    let mut y = LEGEND;
    for row in rows {
        if let Some(heading) = &row.heading {
            svg.text(heading, (8, y + HEADING / 2 + 2), TextAnchor::After, TextStyle::Bold);
            y += HEADING;
        }
        draw_row(&mut svg, &axis, row, y + ROW / 2);
        y += ROW;
    }
    svg.finish(id, caption, rows.iter().map(in_words))
}

/// Lists the sources that have a dot.
fn draw_legend(svg: &mut Svg, rows: &[DotRow]) {
    let mut x = LEFT + 6;
    let has_published = rows.iter().any(|row| row.published.is_some());
    for (name, is_published) in [(OURS, false), (THEIRS, true)] {
        if is_published && !has_published {
            continue;
        }
        draw_mark(svg, is_published, (x, LEGEND / 2 - 2));
        svg.text(name, (x + 12, LEGEND / 2 - 2), TextAnchor::After, TextStyle::Plain);
        x += 40 + 8 * name.chars().count() as i32;
    }
}

fn draw_row(svg: &mut Svg, axis: &ValueAxis, row: &DotRow, y: i32) {
    svg.row_label(&row.label, y);
    // One above the other, so that bars do not hide each other.
    let apart = if row.published.is_some() { 5 } else { 0 };
    draw_dot(svg, axis, &row.ours, false, y - apart);
    if let Some(published) = &row.published {
        draw_dot(svg, axis, published, true, y + apart);
    }
}

fn draw_dot(svg: &mut Svg, axis: &ValueAxis, dot: &Dot, is_published: bool, y: i32) {
    if let Some((low, high)) = dot.range {
        let (low, high) = (axis.x(low), axis.x(high));
        let stroke = if is_published { Stroke::Gray } else { Stroke::Ink };
        for ends in
            [[(low, y), (high, y)], [(low, y - 3), (low, y + 3)], [(high, y - 3), (high, y + 3)]]
        {
            svg.line(&ends, stroke);
        }
    }
    draw_mark(svg, is_published, (axis.x(dot.value), y));
}

/// The shape of a source: filled circle, open diamond.
fn draw_mark(svg: &mut Svg, is_published: bool, (x, y): (i32, i32)) {
    if is_published {
        svg.polygon(&[(x, y - 5), (x + 5, y), (x, y + 5), (x - 5, y)], Paint::OpenGray);
    } else {
        svg.circle((x, y), Paint::Ink);
    }
}

fn in_words(row: &DotRow) -> String {
    let heading = row.heading.as_ref().map_or(String::new(), |heading| format!("{heading}: "));
    let published = row.published.map(|dot| format!(", {THEIRS} {:.1}", dot.value));
    let published = published.unwrap_or_default();
    format!("{heading}{} {OURS} {:.1}{published}", row.label, row.ours.value)
}
