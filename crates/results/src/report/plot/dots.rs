//! Dots with error bars: a row for each condition, a shape for each source.

use plotters::prelude::{Circle, PathElement, Polygon};
use plotters::style::{BLACK, Color, RGBColor};

use super::{
    Area, Axis, BOLD, BOTTOM, Drawn, FAINT, GREY, LEFT, PLAIN, PlotError, Side, draw, line, write,
};
use crate::report::document::Figure;

/// What is to be drawn.
#[derive(Debug)]
pub(in crate::report) struct Dots {
    pub(in crate::report) id: String,
    pub(in crate::report) caption: String,
    /// What the axis is called, with its unit.
    pub(in crate::report) axis: &'static str,
    pub(in crate::report) range: (f64, f64),
    /// The sources, by number.
    pub(in crate::report) series: Vec<String>,
    pub(in crate::report) rows: Vec<DotRow>,
}

/// A row.
#[derive(Debug)]
pub(in crate::report) struct DotRow {
    /// What this row and those after it have in common; begins a block.
    pub(in crate::report) heading: Option<String>,
    pub(in crate::report) label: String,
    pub(in crate::report) dots: Vec<Dot>,
}

/// A figure.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Dot {
    /// Whose.
    pub(in crate::report) series: usize,
    pub(in crate::report) value: f64,
    /// Its error bar.
    pub(in crate::report) range: Option<(f64, f64)>,
}

const ROW: i32 = 24;
const HEADING: i32 = 26;
const LEGEND: i32 = 34;

/// The picture.
///
/// # Errors
/// When the library refuses, which for SVG in memory it does not.
pub(in crate::report) fn dots(plot: &Dots) -> Result<Figure, PlotError> {
    let headings = plot.rows.iter().filter(|row| row.heading.is_some()).count() as i32;
    let bottom = LEGEND + headings * HEADING + plot.rows.len() as i32 * ROW + 4;
    let axis = Axis { from: plot.range.0, to: plot.range.1 };
    let svg = draw(&plot.id, (bottom + BOTTOM) as u32, |area| {
        legend(area, &plot.series)?;
        axis.paint(area, plot.axis, LEGEND, bottom)?;
        let mut y = LEGEND;
        for row in &plot.rows {
            if let Some(heading) = &row.heading {
                write(area, heading, (8, y + HEADING / 2 + 2), Side::After, BOLD)?;
                y += HEADING;
            }
            paint_row(area, &axis, row, y + ROW / 2)?;
            y += ROW;
        }
        Ok(())
    })?;
    let told = plot.rows.iter().map(|row| told(row, &plot.series));
    let alt = format!("{} {}", plot.caption, told.collect::<Vec<_>>().join("; "));
    Ok(Figure { id: plot.id.clone(), caption: plot.caption.clone(), alt, svg })
}

fn legend(area: &Area<'_>, series: &[String]) -> Drawn {
    let mut x = LEFT + 6;
    for (index, name) in series.iter().enumerate() {
        mark(area, index, (x, LEGEND / 2 - 2))?;
        write(area, name, (x + 12, LEGEND / 2 - 2), Side::After, PLAIN)?;
        x += 40 + 8 * name.chars().count() as i32;
    }
    Ok(())
}

fn paint_row(area: &Area<'_>, axis: &Axis, row: &DotRow, y: i32) -> Drawn {
    write(area, &row.label, (LEFT - 12, y), Side::Before, PLAIN)?;
    if row.dots.is_empty() {
        return write(area, "no figure", (LEFT + 6, y), Side::After, FAINT);
    }
    for dot in &row.dots {
        // Sources above one another, so that bars do not hide each other.
        let y = if row.dots.len() > 1 { y - 5 + 10 * (dot.series.min(1) as i32) } else { y };
        if let Some((low, high)) = dot.range {
            let (low, high) = (axis.x(low), axis.x(high));
            let colour = shade(dot.series);
            line(area, [(low, y), (high, y)], colour, 1)?;
            line(area, [(low, y - 3), (low, y + 3)], colour, 1)?;
            line(area, [(high, y - 3), (high, y + 3)], colour, 1)?;
        }
        mark(area, dot.series, (axis.x(dot.value), y))?;
    }
    Ok(())
}

const fn shade(series: usize) -> RGBColor {
    if series == 0 { BLACK } else { GREY }
}

/// The shape of a source: filled circle, open diamond.
fn mark(area: &Area<'_>, series: usize, (x, y): (i32, i32)) -> Drawn {
    if series == 0 {
        area.draw(&Circle::new((x, y), 4, BLACK.filled()))?;
        return Ok(());
    }
    let corners = [(x, y - 5), (x + 5, y), (x, y + 5), (x - 5, y)];
    // Filled with the page, so that the error bar does not run through it.
    area.draw(&Polygon::new(corners.to_vec(), RGBColor(0xff, 0xff, 0xff).filled()))?;
    let outline = corners.into_iter().chain([corners[0]]).collect::<Vec<_>>();
    area.draw(&PathElement::new(outline, GREY.stroke_width(2)))?;
    Ok(())
}

/// A row in words.
fn told(row: &DotRow, series: &[String]) -> String {
    let heading = row.heading.as_ref().map_or(String::new(), |heading| format!("{heading}: "));
    let figures: Vec<String> = row
        .dots
        .iter()
        .filter_map(|dot| Some(format!("{} {:.1}", series.get(dot.series)?, dot.value)))
        .collect();
    let figures = if figures.is_empty() { "no figure".to_owned() } else { figures.join(", ") };
    format!("{heading}{} {figures}", row.label)
}
