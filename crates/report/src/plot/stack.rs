//! Stacked bars: a row for each bar, parts in the same order everywhere, with their numbers on them.

use super::{BOTTOM, LEFT, Paint, ReportFigure, Svg, TextAnchor, TextStyle, ValueAxis};

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
    let bottom = top + plot.rows.len() as i32 * ROW + 6;
    let mut svg = Svg::new(bottom + BOTTOM);
    for (place, &part) in present.iter().enumerate() {
        let x = 12 + 270 * (place % LEGEND_COLUMNS) as i32;
        let y = LEGEND_ROW / 2 + LEGEND_ROW * (place / LEGEND_COLUMNS) as i32;
        draw_part(&mut svg, place, [(x, y - 8), (x + 22, y + 8)]);
        svg.text(&plot.parts[part], (x + 30, y), TextAnchor::After, TextStyle::Plain);
    }
    axis.draw(&mut svg, plot.axis, top, bottom);
    for (row, y) in plot.rows.iter().zip((top..).step_by(ROW as usize)) {
        draw_row(&mut svg, &axis, row, &present, y);
    }
    let rows = plot.rows.iter().map(|row| in_words(row, &plot.parts));
    svg.finish(&plot.id, &plot.caption, rows)
}

fn draw_row(svg: &mut Svg, axis: &ValueAxis, row: &StackRow, present: &[usize], y: i32) {
    svg.row_label(&row.label, y + ROW / 2);
    let Some(lengths) = &row.lengths else {
        return svg.text("not run", (LEFT + 6, y + ROW / 2), TextAnchor::After, TextStyle::Faint);
    };
    let mut from = 0.0;
    for (place, &part) in present.iter().enumerate() {
        let to = from + lengths.get(part).copied().unwrap_or(0.0);
        let corners = [(axis.x(from), y + 4), (axis.x(to), y + ROW - 4)];
        if corners[0].0 < corners[1].0 {
            draw_part(svg, place, corners);
        }
        from = to;
    }
}

/// Draws a part, with its number where it fits.
fn draw_part(svg: &mut Svg, place: usize, corners: [(i32, i32); 2]) {
    let (paint, style) = match place.is_multiple_of(2) {
        true => (Paint::Dark, TextStyle::OnDark),
        false => (Paint::Light, TextStyle::OnLight),
    };
    svg.rectangle(corners, paint);
    let [(left, top), (right, bottom)] = corners;
    if right - left >= 14 {
        let middle = (i32::midpoint(left, right), i32::midpoint(top, bottom));
        svg.text(&(place + 1).to_string(), middle, TextAnchor::Around, style);
    }
}

fn in_words(row: &StackRow, parts: &[String]) -> String {
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
