//! The legend: the task, the routes with their lengths, the targets, the catalogue.

use super::canvas::{CELL, INK, LEGEND, MARGIN, MUTED, PAPER, SvgCanvas};
use super::floor::Map;
use super::glyph;
use super::marks::{Style, badge, barricade, start_disc, style};
use crate::case::{Case, TrajectoryKind};
use crate::world::{Item, Warehouse};

/// Maximum number of characters in a line of the instruction.
const LINE: usize = 36;

/// Writes the legend from top to bottom.
struct LegendColumn<'m> {
    canvas: &'m mut SvgCanvas,
    x: f64,
    y: f64,
}

impl LegendColumn<'_> {
    fn text(&mut self, indent: f64, text: &str, size: f64, colour: &str, weight: u32) {
        let style = format!("font-size='{size}' fill='{colour}' font-weight='{weight}'");
        self.canvas.text((self.x + indent, self.y), text, &style);
    }

    fn title(&mut self, title: &str, subtitle: &str) {
        self.y += 20.0;
        self.text(0.0, title, 30.0, INK, 700);
        self.y += 26.0;
        self.text(0.0, subtitle, 15.0, MUTED, 400);
        self.y += 14.0;
    }

    fn heading(&mut self, text: &str) {
        self.y += 34.0;
        self.text(0.0, text, 13.0, MUTED, 700);
        self.y += 8.0;
        let (x, y) = (self.x, self.y);
        let line = format!("M{x:.1} {y:.1}h{:.1}", LEGEND - MARGIN);
        self.canvas.path(&line, "stroke='#d9dee4'");
        self.y += 8.0;
    }

    fn catalogue(&mut self, warehouse: &Warehouse) {
        let catalogue = &warehouse.catalogue;
        self.heading("ON THE RACKS");
        for (index, category) in catalogue.categories.iter().enumerate() {
            self.y += 25.0;
            for (place, item_type) in catalogue.types_in(index).enumerate() {
                let item_type = &catalogue.types[item_type];
                let at = (self.x + 11.0 + 23.0 * place as f64, self.y - 5.0);
                glyph::draw(self.canvas, at, item_type.shape, item_type.colour);
            }
            let indent = 14.0 + 23.0 * catalogue.types_in(index).count() as f64;
            self.text(indent, &category.name, 14.0, INK, 400);
            self.right(&warehouse.items_in(index).count().to_string());
        }
    }

    /// A number at the right border.
    fn right(&mut self, text: &str) {
        let at = (self.x + LEGEND - MARGIN, self.y);
        self.canvas.text(at, text, &format!("font-size='14' fill='{MUTED}' text-anchor='end'"));
    }

    fn note(&mut self, text: &str) {
        self.y += 20.0;
        self.text(0.0, text, 12.5, MUTED, 400);
    }
}

impl Map<'_> {
    fn column(&mut self) -> LegendColumn<'_> {
        let x = self.legend_x();
        LegendColumn { canvas: &mut self.canvas, x, y: MARGIN }
    }

    /// A north arrow and the scale, at the foot of the legend.
    fn compass(&mut self) {
        let (x, y) = (self.legend_x(), MARGIN + f64::from(self.layout.height()) * CELL);
        self.canvas.path(
            &format!("M{:.1} {:.1}l9 26l-9 -6l-9 6Z", x + 10.0, y - 34.0),
            &format!("fill='{INK}' stroke-linejoin='round'"),
        );
        let style = format!("font-size='13' font-weight='700' fill='{INK}' text-anchor='middle'");
        self.canvas.text((x + 10.0, y - 40.0), "N", &style);
        let scale = format!("M{:.1} {:.1}v8h{CELL:.1}v-8", x + 46.0, y - 17.0);
        self.canvas.path(&scale, &format!("stroke='{INK}' stroke-width='1.5'"));
        let style = format!("font-size='13' fill='{INK}' text-anchor='middle'");
        self.canvas.text((x + 46.0 + CELL / 2.0, y - 22.0), "1 m", &style);
    }

    pub(super) fn floor_legend(&mut self, warehouse: &Warehouse) {
        let layout = self.layout;
        let mut column = self.column();
        let size = format!("{} m x {} m, one cell is 1 m wide", layout.width(), layout.height());
        column.title("The warehouse", &size);
        column.catalogue(warehouse);
        column.heading("READING THE MAP");
        column.note(&format!(
            "{} items of {} types; each is drawn in its",
            warehouse.items.len(),
            warehouse.catalogue.types.len()
        ));
        column.note("rack, at the face it is reached from. Standing");
        column.note("on the cell before the face reaches the item.");
        self.compass();
    }

    pub(super) fn case_legend(&mut self, warehouse: &Warehouse, case: &Case) {
        let mut column = self.column();
        let task_type = case.task.task_type();
        let kind = format!("type {}, {}", task_type.number(), task_type.name());
        column.title(&format!("Case {}", case.id), &kind);
        column.y += 12.0;
        for line in wrapped(&case.task.instruction(&warehouse.catalogue), LINE) {
            column.y += 23.0;
            column.text(0.0, &line, 18.0, INK, 500);
        }
        column.heading("TARGETS");
        targets(&mut column, warehouse, case);
        column.heading("DEMONSTRATIONS");
        for start in TrajectoryKind::DEMONSTRATIONS {
            route(&mut column, warehouse, case, start);
        }
        column.heading("TEST REFERENCES");
        for start in [TrajectoryKind::Test, TrajectoryKind::Blocked] {
            route(&mut column, warehouse, case, start);
        }
        column.y += 32.0;
        let at = (column.x + 12.0, column.y - 18.0);
        barricade(column.canvas, at, 26.0);
        column.text(66.0, "closed in the blocked variant", 14.0, INK, 400);
        column.y += 28.0;
        let at = (column.x + 25.0, column.y - 5.0);
        column.canvas.circle(at, 4.2, &format!("fill='{PAPER}' stroke='{INK}' stroke-width='2.2'"));
        column.text(66.0, "a sub-goal is completed", 14.0, INK, 400);
        column.catalogue(warehouse);
        self.compass();
    }
}

/// The letters of targets, what they stand for, and how many there are.
fn targets(column: &mut LegendColumn<'_>, warehouse: &Warehouse, case: &Case) {
    let targets = case.task.targets(warehouse);
    for wanted in ['A', 'B', 'C'] {
        let has_letter = |item: &&&Item| case.task.letter(warehouse, item) == Some(wanted);
        let found: Vec<&Item> = targets.iter().filter(has_letter).copied().collect();
        let Some(first) = found.first() else { continue };
        let item_type = &warehouse.catalogue.types[first.item_type];
        let name = match wanted {
            'C' => &warehouse.catalogue.categories[item_type.category].name,
            _ => &item_type.name,
        };
        column.y += 26.0;
        let (x, y) = (column.x, column.y - 5.0);
        badge(column.canvas, (x + 11.0, y), wanted);
        glyph::draw(column.canvas, (x + 38.0, y), item_type.shape, item_type.colour);
        column.text(66.0, name, 15.0, INK, 400);
        column.right(&format!("{} of them", found.len()));
    }
}

/// A route's line style, start and length.
fn route(column: &mut LegendColumn<'_>, warehouse: &Warehouse, case: &Case, start: TrajectoryKind) {
    column.y += 29.0;
    let (x, y) = (column.x, column.y - 5.0);
    let Style { colour, dashes, width, .. } = style(start);
    column.canvas.path(
        &format!("M{x:.1} {y:.1}h50"),
        &format!("stroke='{colour}' stroke-width='{width}' stroke-dasharray='{dashes}' stroke-linecap='round'"),
    );
    let pose = case.trajectory(start).start;
    start_disc(column.canvas, (x + 25.0, y), start, pose.heading);
    column.text(66.0, start.name(), 15.0, INK, 500);
    column.text(150.0, &format!("from {pose}"), 13.0, MUTED, 400);
    let length = case.replay(warehouse, start).length;
    let steps = length.map_or_else(|| "fails".into(), |length| format!("{length} steps"));
    column.right(&steps);
}

/// Wraps `text` into lines of at most `width` characters.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
