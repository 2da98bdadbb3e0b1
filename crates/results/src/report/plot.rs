//! Pictures of figures, as SVG: readable in black and white, with labels in the picture and error bars.
//!
//! Nothing here is told apart by colour. Dots differ by shape, filled or open; parts of a bar by their order, a
//! light or a dark grey, and a number that the legend explains. What is drawn in black takes the colour of the
//! text around it in the page, so that it shows on a dark background, too.

mod curves;
mod dots;
mod stack;

pub use curves::{Curve, Curves, curves};
pub(super) use dots::{Dot, DotRow, Dots, dots};
pub use stack::{Stack, StackRow, stack};

use plotters::backend::SVGBackend;
use plotters::coord::Shift;
use plotters::prelude::{DrawingArea, IntoDrawingArea, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, FontStyle, IntoFont, RGBColor, TextStyle};

/// A picture that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw figure {id}: {problem}; this is a mistake in the program, please report it")]
pub struct PlotError {
    id: String,
    problem: String,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// All pictures are as wide as the text of the page.
const WIDTH: u32 = 820;
/// Where the labels of rows end and the figures begin.
const LEFT: i32 = 250;
const RIGHT: i32 = 24;
/// What the words of an axis need.
const BOTTOM: i32 = 44;
const GREY: RGBColor = RGBColor(0x76, 0x76, 0x76);
const RULE: RGBColor = RGBColor(0xb8, 0xb8, 0xb8);

/// Draws a picture of `height`.
fn draw(
    id: &str,
    height: u32,
    paint: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let drawn = {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        paint(&area).and_then(|()| Ok(area.present()?))
    };
    drawn.map_err(|error| PlotError { id: id.to_owned(), problem: error.to_string() })?;
    Ok(svg)
}

/// Where text stands relative to its point.
#[derive(Clone, Copy)]
enum Side {
    Before,
    After,
    Around,
}

/// Writes a line of text at `point`, in the middle of its height.
fn write(
    area: &Area<'_>,
    text: &str,
    point: (i32, i32),
    side: Side,
    style: (f64, FontStyle, RGBColor),
) -> Drawn {
    let (size, weight, colour) = style;
    let across = match side {
        Side::Before => HPos::Right,
        Side::After => HPos::Left,
        Side::Around => HPos::Center,
    };
    let font = ("sans-serif", size).into_font().style(weight);
    let style = TextStyle::from(font).color(&colour).pos(Pos::new(across, VPos::Center));
    area.draw(&Text::new(text.to_owned(), point, style))?;
    Ok(())
}

/// Labels of rows, axes, legends.
const PLAIN: (f64, FontStyle, RGBColor) = (16.0, FontStyle::Normal, BLACK);
/// Headings of rows.
const BOLD: (f64, FontStyle, RGBColor) = (16.0, FontStyle::Bold, BLACK);
/// What is said of missing figures.
const FAINT: (f64, FontStyle, RGBColor) = (14.0, FontStyle::Normal, GREY);

/// A horizontal axis.
struct Axis {
    from: f64,
    to: f64,
}

impl Axis {
    /// The place of `value`.
    fn x(&self, value: f64) -> i32 {
        let width = f64::from(WIDTH as i32 - LEFT - RIGHT);
        let share = ((value - self.from) / (self.to - self.from)).clamp(0.0, 1.0);
        LEFT + (share * width).round() as i32
    }

    /// A round step that gives at most seven marks.
    fn step(&self) -> f64 {
        let rough = (self.to - self.from) / 6.0;
        let magnitude = 10_f64.powf(rough.log10().floor());
        let steps = [1.0, 2.0, 2.5, 5.0, 10.0].map(|step| step * magnitude);
        steps.into_iter().find(|step| *step >= rough).unwrap_or(rough)
    }

    /// Lines, marks and the name of the axis below them.
    fn paint(&self, area: &Area<'_>, name: &str, top: i32, bottom: i32) -> Drawn {
        let step = self.step();
        let marks = ((self.to - self.from) / step + 1e-9).floor() as u32;
        for mark in 0..=marks {
            let value = self.from + f64::from(mark) * step;
            let x = self.x(value);
            line(area, [(x, top), (x, bottom)], RULE, 1)?;
            let digits = usize::from(step < 1.0) + usize::from(step < 0.1);
            write(area, &format!("{value:.digits$}"), (x, bottom + 12), Side::Around, PLAIN)?;
        }
        let middle = (self.x(self.from) + self.x(self.to)) / 2;
        write(area, name, (middle, bottom + 32), Side::Around, PLAIN)
    }
}

fn line(area: &Area<'_>, points: [(i32, i32); 2], colour: RGBColor, width: u32) -> Drawn {
    use plotters::prelude::PathElement;
    use plotters::style::Color;
    area.draw(&PathElement::new(points.to_vec(), colour.stroke_width(width)))?;
    Ok(())
}
