//! Bars made of parts: a row for each bar, parts in the same order everywhere, with their numbers on them.

use plotters::prelude::Rectangle;
use plotters::style::{BLACK, Color, FontStyle, RGBColor};

use super::{Area, Axis, BOTTOM, Drawn, FAINT, LEFT, PLAIN, PlotError, Side, draw, write};
use crate::report::document::Figure;

/// What is to be drawn.
#[derive(Debug)]
pub struct Stack {
    /// The figure's id.
    pub id: String,
    /// Its caption.
    pub caption: String,
    /// What the axis is called, with its unit.
    pub axis: &'static str,
    /// The end of the axis; what the longest bar needs when `None`.
    pub to: Option<f64>,
    /// The parts' names, in order.
    pub parts: Vec<String>,
    /// The bars.
    pub rows: Vec<StackRow>,
}

/// A bar.
#[derive(Debug)]
pub struct StackRow {
    /// Its label.
    pub label: String,
    /// A length for each part; `None` when there is no bar.
    pub lengths: Option<Vec<f64>>,
}

const ROW: i32 = 28;
const LEGEND_ROW: i32 = 22;
const LEGEND_COLUMNS: usize = 3;
const LIGHT: RGBColor = RGBColor(0xd6, 0xd6, 0xd6);
const DARK: RGBColor = RGBColor(0x59, 0x59, 0x59);

/// The picture. Parts that no bar has are left out, also of the legend.
///
/// # Errors
/// When the library refuses, which for SVG in memory it does not.
pub fn stack(plot: &Stack) -> Result<Figure, PlotError> {
    let lengths = || plot.rows.iter().filter_map(|row| row.lengths.as_deref());
    let present: Vec<usize> = (0..plot.parts.len())
        .filter(|&part| lengths().any(|lengths| lengths.get(part).is_some_and(|l| *l > 0.0)))
        .collect();
    let longest = lengths().map(|lengths| lengths.iter().sum::<f64>()).fold(0.0, f64::max);
    let to = plot.to.unwrap_or(longest * 1.04);
    let axis = Axis { from: 0.0, to: if to > 0.0 { to } else { 1.0 } };
    let top = 12 + LEGEND_ROW * present.len().div_ceil(LEGEND_COLUMNS) as i32;
    let bottom = top + plot.rows.len() as i32 * ROW + 6;
    let svg = draw(&plot.id, (bottom + BOTTOM) as u32, |area| {
        for (place, &part) in present.iter().enumerate() {
            let x = 12 + 270 * (place % LEGEND_COLUMNS) as i32;
            let y = LEGEND_ROW / 2 + LEGEND_ROW * (place / LEGEND_COLUMNS) as i32;
            paint_part(area, place, [(x, y - 8), (x + 22, y + 8)])?;
            write(area, &plot.parts[part], (x + 30, y), Side::After, PLAIN)?;
        }
        axis.paint(area, plot.axis, top, bottom)?;
        for (row, y) in plot.rows.iter().zip((top..).step_by(ROW as usize)) {
            paint_row(area, &axis, row, &present, y)?;
        }
        Ok(())
    })?;
    let told: Vec<String> = plot.rows.iter().map(|row| told(row, &plot.parts)).collect();
    let alt = format!("{} {}", plot.caption, told.join("; "));
    Ok(Figure { id: plot.id.clone(), caption: plot.caption.clone(), alt, svg })
}

fn paint_row(area: &Area<'_>, axis: &Axis, row: &StackRow, present: &[usize], y: i32) -> Drawn {
    write(area, &row.label, (LEFT - 12, y + ROW / 2), Side::Before, PLAIN)?;
    let Some(lengths) = &row.lengths else {
        return write(area, "not run", (LEFT + 6, y + ROW / 2), Side::After, FAINT);
    };
    let mut from = 0.0;
    for (place, &part) in present.iter().enumerate() {
        let to = from + lengths.get(part).copied().unwrap_or(0.0);
        let corners = [(axis.x(from), y + 4), (axis.x(to), y + ROW - 4)];
        if corners[0].0 < corners[1].0 {
            paint_part(area, place, corners)?;
        }
        from = to;
    }
    Ok(())
}

/// A part with its number, where the number fits.
fn paint_part(area: &Area<'_>, place: usize, corners: [(i32, i32); 2]) -> Drawn {
    let (fill, ink) = if place.is_multiple_of(2) {
        (DARK, RGBColor(0xff, 0xff, 0xfe))
    } else {
        (LIGHT, RGBColor(0, 0, 1))
    };
    area.draw(&Rectangle::new(corners, fill.filled()))?;
    area.draw(&Rectangle::new(corners, BLACK.stroke_width(1)))?;
    let [(left, top), (right, bottom)] = corners;
    if right - left < 14 {
        return Ok(());
    }
    let middle = ((left + right) / 2, (top + bottom) / 2);
    write(area, &(place + 1).to_string(), middle, Side::Around, (14.0, FontStyle::Normal, ink))
}

/// A bar in words.
fn told(row: &StackRow, parts: &[String]) -> String {
    let Some(lengths) = &row.lengths else { return format!("{}: not run", row.label) };
    let parts: Vec<String> = parts
        .iter()
        .zip(lengths)
        .filter(|(_, length)| **length > 0.0)
        .map(|(part, length)| format!("{part} {length:.1}"))
        .collect();
    let parts = if parts.is_empty() { "nothing".to_owned() } else { parts.join(", ") };
    format!("{}: {parts}", row.label)
}
