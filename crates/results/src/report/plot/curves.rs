//! Curves on two logarithmic axes, told apart by the shapes of their points, with their names at their ends.

use plotters::prelude::{Circle, PathElement, Polygon, Rectangle};
use plotters::style::{BLACK, Color, RGBColor};

use super::{
    Area, BOTTOM, Drawn, FAINT, GREY, PLAIN, PlotError, RIGHT, RULE, Side, WIDTH, draw, line, write,
};
use crate::report::document::Figure;

/// What is to be drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curves {
    /// The figure's id.
    pub id: String,
    /// What it shows.
    pub caption: String,
    /// What the horizontal axis is, with its unit.
    pub across: String,
    /// What the vertical axis is, with its unit.
    pub up: String,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// Whether it is a bound that others are seen against: without points, in grey.
    pub is_bound: bool,
    /// Its points, left to right; those that are not above zero are left out.
    pub points: Vec<(f64, f64)>,
}

const TOP: i32 = 14;
const HEIGHT: i32 = 320;
const AXIS: i32 = 86;
const LEGEND_ROW: i32 = 22;
const LEGEND_COLUMNS: usize = 2;

/// A logarithmic axis from `from` to `to`, both above zero, over the pixels from `start` to `end`.
struct Scale {
    from: f64,
    to: f64,
    start: i32,
    end: i32,
}

impl Scale {
    /// Over all of `values`, with a little room at both ends.
    fn over(values: impl Iterator<Item = f64>, start: i32, end: i32) -> Self {
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if high > 0.0 { (low, high) } else { (1.0, 10.0) };
        // At least a factor of four, so that a flat curve looks flat.
        let room = (high / low).powf(0.04).max((4.0 / (high / low)).sqrt().max(1.05));
        Self { from: low / room, to: high * room, start, end }
    }

    fn at(&self, value: f64) -> i32 {
        let share = (value / self.from).ln() / (self.to / self.from).ln();
        self.start + (share * f64::from(self.end - self.start)).round() as i32
    }

    /// Where lines are drawn: powers of ten, with 2 and 5 between them where those are few.
    fn marks(&self) -> Vec<f64> {
        let (first, last) = (self.from.log10().floor() as i32, self.to.log10().ceil() as i32);
        let steps: &[f64] = match (self.to / self.from).log10() {
            decades if decades > 4.0 => &[1.0],
            decades if decades > 2.0 => &[1.0, 3.0],
            _ => &[1.0, 2.0, 5.0],
        };
        let all = (first..=last)
            .flat_map(|power| steps.iter().map(move |step| step * 10_f64.powi(power)));
        all.filter(|mark| (self.from..=self.to).contains(mark)).collect()
    }
}

/// The picture.
///
/// # Errors
/// When the library refuses, which for SVG in memory it does not.
pub fn curves(plot: &Curves) -> Result<Figure, PlotError> {
    let shown: Vec<(&Curve, Vec<(f64, f64)>)> = plot
        .curves
        .iter()
        .map(|curve| {
            let above = |point: &(f64, f64)| point.0 > 0.0 && point.1 > 0.0;
            (curve, curve.points.iter().copied().filter(above).collect())
        })
        .collect();
    let points = || shown.iter().flat_map(|(_, points)| points.iter().copied());
    let top = TOP + LEGEND_ROW * shown.len().div_ceil(LEGEND_COLUMNS) as i32 + 14;
    let bottom = top + HEIGHT;
    let across = Scale::over(points().map(|(x, _)| x), AXIS, WIDTH as i32 - RIGHT);
    let up = Scale::over(points().map(|(_, y)| y), bottom, top);
    let svg = draw(&plot.id, (bottom + BOTTOM) as u32, |area| {
        paint_axes(area, plot, &across, &up)?;
        let mut shapes = 0..;
        for (place, (curve, points)) in shown.iter().enumerate() {
            let shape = if curve.is_bound { None } else { shapes.next() };
            let legend = (
                AXIS + 360 * (place % LEGEND_COLUMNS) as i32,
                TOP + LEGEND_ROW * (place / LEGEND_COLUMNS) as i32,
            );
            paint_curve(area, &[legend, (legend.0 + 28, legend.1)], shape)?;
            write(area, &curve.name, (legend.0 + 40, legend.1), Side::After, PLAIN)?;
            let pixels: Vec<(i32, i32)> =
                points.iter().map(|(x, y)| (across.at(*x), up.at(*y))).collect();
            paint_curve(area, &pixels, shape)?;
        }
        Ok(())
    })?;
    let told = shown.iter().map(|(curve, points)| {
        let points: Vec<String> =
            points.iter().map(|(x, y)| format!("{} at {}", label(*y), label(*x))).collect();
        format!("{}: {}", curve.name, points.join(", "))
    });
    let alt = format!("{} {}", plot.caption, told.collect::<Vec<_>>().join("; "));
    Ok(Figure { id: plot.id.clone(), caption: plot.caption.clone(), alt, svg })
}

fn paint_axes(area: &Area<'_>, plot: &Curves, across: &Scale, up: &Scale) -> Drawn {
    let (top, bottom) = (up.end, up.start);
    for mark in across.marks() {
        let x = across.at(mark);
        line(area, [(x, top), (x, bottom)], RULE, 1)?;
        write(area, &label(mark), (x, bottom + 12), Side::Around, PLAIN)?;
    }
    for mark in up.marks() {
        let y = up.at(mark);
        line(area, [(across.start, y), (across.end, y)], RULE, 1)?;
        write(area, &label(mark), (across.start - 8, y), Side::Before, PLAIN)?;
    }
    let middle = i32::midpoint(across.start, across.end);
    write(area, &plot.across, (middle, bottom + 32), Side::Around, PLAIN)?;
    write(area, &plot.up, (8, top - 12), Side::After, FAINT)
}

/// A curve with its points; a bound where it has no shape.
fn paint_curve(area: &Area<'_>, pixels: &[(i32, i32)], shape: Option<usize>) -> Drawn {
    let colour = if shape.is_some() { BLACK } else { GREY };
    let width = if shape.is_some() { 1 } else { 3 };
    area.draw(&PathElement::new(pixels.to_vec(), colour.stroke_width(width)))?;
    let Some(shape) = shape else { return Ok(()) };
    for &point in pixels {
        paint_mark(area, shape, point)?;
    }
    Ok(())
}

/// The point of a curve: circle, diamond, square, triangle; filled, then open.
fn paint_mark(area: &Area<'_>, shape: usize, (x, y): (i32, i32)) -> Drawn {
    let page = RGBColor(0xff, 0xff, 0xff);
    let fill = if (shape / 4).is_multiple_of(2) { BLACK } else { page };
    let outline: &[(i32, i32)] = match shape % 4 {
        0 => {
            area.draw(&Circle::new((x, y), 4, fill.filled()))?;
            area.draw(&Circle::new((x, y), 4, BLACK.stroke_width(1)))?;
            return Ok(());
        }
        2 => {
            let corners = [(x - 4, y - 4), (x + 4, y + 4)];
            area.draw(&Rectangle::new(corners, fill.filled()))?;
            area.draw(&Rectangle::new(corners, BLACK.stroke_width(1)))?;
            return Ok(());
        }
        1 => &[(x, y - 6), (x + 6, y), (x, y + 6), (x - 6, y), (x, y - 6)],
        _ => &[(x, y - 5), (x + 5, y + 4), (x - 5, y + 4), (x, y - 5)],
    };
    area.draw(&Polygon::new(outline.to_vec(), fill.filled()))?;
    area.draw(&PathElement::new(outline.to_vec(), BLACK.stroke_width(1)))?;
    Ok(())
}

/// A number in few letters: `1k`, `2.5M`, `0.02`.
fn label(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        size if size >= 1e9 => (value / 1e9, "G"),
        size if size >= 1e6 => (value / 1e6, "M"),
        size if size >= 1e3 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let digits = match scaled.abs() {
        size if size >= 99.5 || size == 0.0 => 0,
        size if size >= 9.95 => 1,
        size if size >= 0.995 => 2,
        _ => 4,
    };
    let text = format!("{scaled:.digits$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (1000.0, "1k"),
            (2.5e6, "2.5M"),
            (0.02, "0.02"),
            (62.04, "62"),
            (1.0, "1"),
            (250.0, "250"),
        ] {
            assert_eq!(label(value), text);
        }
    }

    #[test]
    fn axes_hold_their_values_and_have_marks() {
        for (low, high) in [(1.0, 1.0), (1.0, 3.0), (0.01, 1e7), (5.0, 40.0)] {
            let scale = Scale::over([low, high].into_iter(), 100, 800);
            for value in [low, high] {
                assert!((100..=800).contains(&scale.at(value)), "{value}");
            }
            assert!(
                (2..=12).contains(&scale.marks().len()),
                "{low} to {high}: {:?}",
                scale.marks()
            );
        }
    }

    #[test]
    fn a_picture_says_what_it_shows_and_leaves_out_what_has_no_place() {
        let curve = |name: &str, is_bound, points: &[(f64, f64)]| Curve {
            name: name.to_owned(),
            is_bound,
            points: points.to_vec(),
        };
        let plot = Curves {
            id: "p".to_owned(),
            caption: "Time.".to_owned(),
            across: "entries".to_owned(),
            up: "us".to_owned(),
            curves: vec![
                curve("exact", false, &[(1000.0, 10.0), (1e6, 9000.0), (0.0, 1.0)]),
                curve("bandwidth", true, &[(1000.0, 5.0), (1e6, 5000.0)]),
                curve("nothing", false, &[]),
            ],
        };
        let figure = curves(&plot).unwrap();
        assert_eq!(
            figure.alt,
            "Time. exact: 10 at 1k, 9k at 1M; bandwidth: 5 at 1k, 5k at 1M; nothing: "
        );
        assert!(figure.svg.starts_with("<svg") && figure.svg.contains("entries"));
    }
}
