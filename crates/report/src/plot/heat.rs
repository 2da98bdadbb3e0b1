//! Heat maps of percentages: a panel for each condition, all to one scale, with the numbers in the cells.

use super::drawing::Point;
use super::{Drawing, INK, Paint, ReportFigure, Stroke, TextAnchor, TextStyle, Tone, WIDTH};

/// Panels side by side.
#[derive(Debug)]
pub(crate) struct HeatMap {
    pub(crate) id: String,
    pub(crate) caption: String,
    /// What the columns and the rows of a panel count.
    pub(crate) columns: &'static str,
    pub(crate) rows: &'static str,
    pub(crate) panels: Vec<HeatPanel>,
}

/// A matrix of percentages.
#[derive(Debug)]
pub(crate) struct HeatPanel {
    pub(crate) name: String,
    /// Row by row, each as long; `None` where there is no figure.
    pub(crate) cells: Vec<Vec<Option<f64>>>,
}

/// The room of row numbers left of the cells, and above them the panel's name and the column numbers.
const LEFT: i32 = 40;
const TOP: i32 = 46;
/// The room of the columns' name below the cells.
const BOTTOM: i32 = 30;
const GAP: i32 = 16;
/// The height of a cell, and the least and greatest width.
const CELL: i32 = 26;
const WIDTHS: (i32, i32) = (30, 44);

/// Draws the panels, as many in a row as fit.
pub(crate) fn heat_map(plot: &HeatMap) -> ReportFigure {
    let columns = plot.panels.iter().flat_map(|panel| panel.cells.iter().map(Vec::len)).max();
    let rows = plot.panels.iter().map(|panel| panel.cells.len()).max();
    let (columns, rows) = (columns.unwrap_or(0).max(1) as i32, rows.unwrap_or(0) as i32);
    let of_width = |cell: i32| LEFT + columns * cell + GAP;
    let in_row = ((WIDTH + GAP) / of_width(WIDTHS.0)).clamp(1, plot.panels.len().max(1) as i32);
    let cell = (((WIDTH + GAP) / in_row - LEFT - GAP) / columns).min(WIDTHS.1);
    let height = TOP + rows * CELL + BOTTOM;
    let panel_rows = (plot.panels.len() as i32 + in_row - 1) / in_row;
    let mut drawing = Drawing::new(panel_rows * height);
    for (panel, place) in plot.panels.iter().zip(0..) {
        let corner = (place % in_row * of_width(cell), place / in_row * height);
        draw_panel(&mut drawing, plot, panel, corner, cell);
    }
    ReportFigure::new(drawing, &plot.id, &plot.caption, plot.panels.iter().map(in_words))
}

fn draw_panel(
    drawing: &mut Drawing,
    plot: &HeatMap,
    panel: &HeatPanel,
    (left, top): Point,
    width: i32,
) {
    let (x0, y0) = (left + LEFT, top + TOP);
    drawing.text(&panel.name, (left, top + 12), TextAnchor::After, TextStyle::BOLD);
    let columns = panel.cells.iter().map(Vec::len).max().unwrap_or(0) as i32;
    for column in 0..columns {
        let at = (x0 + column * width + width / 2, y0 - 11);
        drawing.text(&(column + 1).to_string(), at, TextAnchor::Around, TextStyle::PLAIN);
    }
    for (row, y) in panel.cells.iter().zip((y0..).step_by(CELL as usize)) {
        let number = (y - y0) / CELL;
        let at = (x0 - 8, y + CELL / 2);
        drawing.text(&number.to_string(), at, TextAnchor::Before, TextStyle::PLAIN);
        for (value, x) in row.iter().zip((x0..).step_by(width.unsigned_abs() as usize)) {
            draw_cell(drawing, *value, [(x, y), (x + width, y + CELL)]);
        }
    }
    let bottom = y0 + panel.cells.len() as i32 * CELL;
    let legend = format!("right: {}, down: {}", plot.columns, plot.rows);
    drawing.text(&legend, (x0, bottom + 13), TextAnchor::After, TextStyle::FAINT);
}

/// Draws a cell: white at 0 %, dark at 100 %.
fn draw_cell(drawing: &mut Drawing, value: Option<f64>, corners: [Point; 2]) {
    /// The gray of 100 %: dark, with white digits readable on it.
    const DARKEST: f64 = 60.0;
    /// Below this gray white digits have more contrast than black ones.
    const LIGHT: u8 = 118;
    let [(left, top), (right, bottom)] = corners;
    let middle = (i32::midpoint(left, right), i32::midpoint(top, bottom));
    let outline = Some(Stroke { tone: Tone::Gray(0x76), ..INK });
    let Some(value) = value else {
        drawing.rectangle(corners, Paint { fill: Tone::Paper, outline });
        return drawing.text("–", middle, TextAnchor::Around, TextStyle::FAINT);
    };
    let gray = (255.0 - (255.0 - DARKEST) * (value / 100.0).clamp(0.0, 1.0)).round() as u8;
    let tone = Tone::Gray(if gray < LIGHT { 255 } else { 0 });
    drawing.rectangle(corners, Paint { fill: Tone::Gray(gray), outline });
    let style = TextStyle { tone, is_bold: false };
    drawing.text(&format!("{value:.0}"), middle, TextAnchor::Around, style);
}

fn in_words(panel: &HeatPanel) -> String {
    let row = |row: &Vec<Option<f64>>| {
        let values = row.iter().map(|value| value.map_or("none".to_owned(), |v| format!("{v:.0}")));
        values.collect::<Vec<_>>().join(", ")
    };
    let rows: Vec<String> =
        panel.cells.iter().zip(0..).map(|(cells, at)| format!("{at}: {}", row(cells))).collect();
    format!("{}: {}", panel.name, rows.join(" | "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_has_its_number_on_a_readable_ground() {
        let panel = |name: &str| HeatPanel {
            name: name.to_owned(),
            cells: vec![vec![Some(0.0), Some(49.6)], vec![Some(100.0), None]],
        };
        let plot = HeatMap {
            id: "r".to_owned(),
            caption: "R.".to_owned(),
            columns: "block",
            rows: "blocks learned",
            panels: vec![panel("episodic, frozen"), panel("adaptive, learning")],
        };
        let figure = heat_map(&plot);
        assert_eq!(
            figure.alt,
            "R. episodic, frozen: 0: 0, 50 | 1: 100, none; adaptive, learning: 0: 0, 50 | 1: 100, none"
        );
        let svg = figure.svg();
        for ground in ["#ffffff", "#9e9e9e", "#3c3c3c"] {
            assert!(svg.contains(&format!(r#"fill="{ground}" stroke"#)), "{ground}: {svg}");
        }
        assert!(svg.contains("fill=\"#ffffff\">100<") && svg.contains("fill=\"#000000\">50<"));
        assert_eq!(svg.matches("<polygon").count(), 8);
    }
}
