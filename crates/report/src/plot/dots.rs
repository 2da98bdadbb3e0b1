//! Dots with error bars: a row for each condition, a shape for each source.

use super::{BOTTOM, LEFT, Paint, Stroke, Svg, TextAnchor, TextStyle, ValueAxis};
use crate::document::ReportFigure;

/// A plot of dots.
#[derive(Debug)]
pub(crate) struct Dots {
    pub(crate) id: String,
    pub(crate) caption: String,
    /// The name of the axis, with its unit.
    pub(crate) axis: &'static str,
    pub(crate) range: (f64, f64),
    /// The names of the sources.
    pub(crate) series: Vec<String>,
    pub(crate) rows: Vec<DotRow>,
}

/// A row.
#[derive(Debug)]
pub(crate) struct DotRow {
    /// A heading above this row.
    pub(crate) heading: Option<String>,
    pub(crate) label: String,
    pub(crate) dots: Vec<Dot>,
}

/// A figure.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Dot {
    /// The index of its source.
    pub(crate) series: usize,
    pub(crate) value: f64,
    /// Its error bar.
    pub(crate) range: Option<(f64, f64)>,
}

const ROW: i32 = 24;
const HEADING: i32 = 26;
const LEGEND: i32 = 34;

/// Draws the plot.
pub(crate) fn dots(plot: &Dots) -> ReportFigure {
    let headings = plot.rows.iter().filter(|row| row.heading.is_some()).count() as i32;
    let bottom = LEGEND + headings * HEADING + plot.rows.len() as i32 * ROW + 4;
    let axis = ValueAxis { from: plot.range.0, to: plot.range.1 };
    let mut svg = Svg::new(bottom + BOTTOM);
    draw_legend(&mut svg, plot);
    axis.draw(&mut svg, plot.axis, LEGEND, bottom);
    let mut y = LEGEND;
    for row in &plot.rows {
        if let Some(heading) = &row.heading {
            svg.text(heading, (8, y + HEADING / 2 + 2), TextAnchor::After, TextStyle::Bold);
            y += HEADING;
        }
        draw_row(&mut svg, &axis, row, y + ROW / 2);
        y += ROW;
    }
    let rows = plot.rows.iter().map(|row| in_words(row, &plot.series));
    let alt = format!("{} {}", plot.caption, rows.collect::<Vec<_>>().join("; "));
    ReportFigure { id: plot.id.clone(), caption: plot.caption.clone(), alt, svg: svg.finish() }
}

/// Lists the sources that have a dot.
fn draw_legend(svg: &mut Svg, plot: &Dots) {
    let mut x = LEFT + 6;
    for (index, name) in plot.series.iter().enumerate() {
        if plot.rows.iter().flat_map(|row| &row.dots).all(|dot| dot.series != index) {
            continue;
        }
        draw_mark(svg, index, (x, LEGEND / 2 - 2));
        svg.text(name, (x + 12, LEGEND / 2 - 2), TextAnchor::After, TextStyle::Plain);
        x += 40 + 8 * name.chars().count() as i32;
    }
}

fn draw_row(svg: &mut Svg, axis: &ValueAxis, row: &DotRow, y: i32) {
    svg.row_label(&row.label, y);
    if row.dots.is_empty() {
        svg.text("no figure", (LEFT + 6, y), TextAnchor::After, TextStyle::Faint);
    }
    for dot in &row.dots {
        // Sources above one another, so that bars do not hide each other.
        let y = if row.dots.len() > 1 { y - 5 + 10 * (dot.series.min(1) as i32) } else { y };
        if let Some((low, high)) = dot.range {
            let (low, high) = (axis.x(low), axis.x(high));
            let stroke = if dot.series == 0 { Stroke::Ink } else { Stroke::Gray };
            for ends in [
                [(low, y), (high, y)],
                [(low, y - 3), (low, y + 3)],
                [(high, y - 3), (high, y + 3)],
            ] {
                svg.line(&ends, stroke);
            }
        }
        draw_mark(svg, dot.series, (axis.x(dot.value), y));
    }
}

/// The shape of a source: filled circle, open diamond.
fn draw_mark(svg: &mut Svg, series: usize, (x, y): (i32, i32)) {
    if series == 0 {
        svg.circle((x, y), Paint::Ink);
    } else {
        svg.polygon(&[(x, y - 5), (x + 5, y), (x, y + 5), (x - 5, y)], Paint::OpenGray);
    }
}

fn in_words(row: &DotRow, series: &[String]) -> String {
    let heading = row.heading.as_ref().map_or(String::new(), |heading| format!("{heading}: "));
    let figures: Vec<String> = row
        .dots
        .iter()
        .filter_map(|dot| Some(format!("{} {:.1}", series.get(dot.series)?, dot.value)))
        .collect();
    let figures = if figures.is_empty() { "no figure".to_owned() } else { figures.join(", ") };
    format!("{heading}{} {figures}", row.label)
}
