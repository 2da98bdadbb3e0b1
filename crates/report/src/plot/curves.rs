//! Curves on two logarithmic axes, told apart by the shapes of their points and by their dashes.

use super::drawing::Point;
use super::{
    BOTTOM, Drawing, GRID, INK, Paint, RIGHT, ReportFigure, Stroke, THICK_GRAY, TextAnchor,
    TextStyle, WIDTH,
};

/// A plot of curves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curves {
    /// The figure's id.
    pub id: String,
    /// Its caption.
    pub caption: String,
    /// The name of the horizontal axis, with its unit.
    pub across: String,
    /// The name of the vertical axis, with its unit.
    pub up: String,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// Whether it is a bound that others are compared with: drawn gray, without points.
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
    /// Makes an axis over all of `values`, with a little room at both ends.
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

    /// The marks: powers of ten, with others between them where those are few.
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

/// Draws the plot.
pub fn curves(plot: &Curves) -> ReportFigure {
    let above = |point: &(f64, f64)| point.0 > 0.0 && point.1 > 0.0;
    let points = |curve: &Curve| curve.points.iter().copied().filter(above).collect::<Vec<_>>();
    let shown: Vec<(&Curve, Vec<(f64, f64)>)> =
        plot.curves.iter().map(|curve| (curve, points(curve))).collect();
    let all = || shown.iter().flat_map(|(_, points)| points.iter().copied());
    let top = TOP + LEGEND_ROW * shown.len().div_ceil(LEGEND_COLUMNS) as i32 + 14;
    let bottom = top + HEIGHT;
    let across = Scale::over(all().map(|(x, _)| x), AXIS, WIDTH - RIGHT);
    let up = Scale::over(all().map(|(_, y)| y), bottom, top);
    let mut drawing = Drawing::new(bottom + BOTTOM);
    draw_axes(&mut drawing, plot, &across, &up);
    let names: Vec<(&str, bool)> =
        shown.iter().map(|(curve, _)| (curve.name.as_str(), curve.is_bound)).collect();
    let shapes = legend(&mut drawing, &names);
    for ((_, points), shape) in shown.iter().zip(shapes) {
        let pixels: Vec<Point> = points.iter().map(|(x, y)| (across.at(*x), up.at(*y))).collect();
        draw_curve(&mut drawing, &pixels, shape);
    }
    let in_words = shown.iter().map(|(curve, points)| {
        let points: Vec<String> =
            points.iter().map(|(x, y)| format!("{} at {}", label(*y), label(*x))).collect();
        format!("{}: {}", curve.name, points.join(", "))
    });
    ReportFigure::new(drawing, &plot.id, &plot.caption, in_words)
}

fn draw_axes(drawing: &mut Drawing, plot: &Curves, across: &Scale, up: &Scale) {
    let (top, bottom) = (up.end, up.start);
    for mark in across.marks() {
        let x = across.at(mark);
        drawing.line(&[(x, top), (x, bottom)], GRID);
        drawing.text(&label(mark), (x, bottom + 12), TextAnchor::Around, TextStyle::PLAIN);
    }
    for mark in up.marks() {
        let y = up.at(mark);
        drawing.line(&[(across.start, y), (across.end, y)], GRID);
        drawing.text(&label(mark), (across.start - 8, y), TextAnchor::Before, TextStyle::PLAIN);
    }
    let middle = i32::midpoint(across.start, across.end);
    drawing.text(&plot.across, (middle, bottom + 32), TextAnchor::Around, TextStyle::PLAIN);
    drawing.text(&plot.up, (8, top - 12), TextAnchor::After, TextStyle::FAINT);
}

/// Draws the names of curves, each with whether it is a bound. Returns their shapes, none for a bound.
fn legend(drawing: &mut Drawing, names: &[(&str, bool)]) -> Vec<Option<usize>> {
    let mut next = 0..;
    let mut shapes = Vec::new();
    for (place, (name, is_bound)) in names.iter().enumerate() {
        let shape = if *is_bound { None } else { next.next() };
        let (x, y) = (
            AXIS + 360 * (place % LEGEND_COLUMNS) as i32,
            TOP + LEGEND_ROW * (place / LEGEND_COLUMNS) as i32,
        );
        draw_curve(drawing, &[(x, y), (x + 28, y)], shape);
        drawing.text(name, (x + 40, y), TextAnchor::After, TextStyle::PLAIN);
        shapes.push(shape);
    }
    shapes
}

/// The lines of curves, in order.
const DASHES: [&[u8]; 5] = [&[], &[9, 4], &[2, 4], &[12, 4, 2, 4], &[5, 3]];

/// Draws a curve with its points; a bound, which has no shape, without.
pub(super) fn draw_curve(drawing: &mut Drawing, pixels: &[Point], shape: Option<usize>) {
    let stroke = match shape {
        Some(shape) => Stroke { width: 1.5, dashes: DASHES[shape % DASHES.len()], ..INK },
        None => THICK_GRAY,
    };
    drawing.line(pixels, stroke);
    if let Some(shape) = shape {
        pixels.iter().for_each(|&point| draw_mark(drawing, shape, point));
    }
}

/// Draws the point of a curve: circle, diamond, square, triangle; filled and open in turn.
fn draw_mark(drawing: &mut Drawing, shape: usize, (x, y): Point) {
    let paint = if shape.is_multiple_of(2) { Paint::INK } else { Paint::OPEN };
    match shape % 4 {
        0 => drawing.circle((x, y), paint),
        1 => drawing.polygon(&[(x, y - 6), (x + 6, y), (x, y + 6), (x - 6, y)], paint),
        2 => drawing.rectangle([(x - 4, y - 4), (x + 4, y + 4)], paint),
        _ => drawing.polygon(&[(x, y - 5), (x + 5, y + 4), (x - 5, y + 4)], paint),
    }
}

/// A short form of a number: `1k`, `2.5M`, `0.02`.
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
        // At least two significant digits.
        size => usize::try_from(1 - size.log10().floor() as i32).unwrap_or(0).max(4),
    };
    let text = format!("{scaled:.digits$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

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

    /// The number that a label stands for.
    fn read(label: &str) -> f64 {
        let (digits, unit) = match label.strip_suffix(['k', 'M', 'G']) {
            Some(digits) => (digits, &label[digits.len()..]),
            None => (label, ""),
        };
        let power = ["", "k", "M", "G"].iter().position(|one| *one == unit).unwrap();
        digits.parse::<f64>().unwrap() * 1000_f64.powi(power as i32)
    }

    proptest! {
        #[test]
        fn a_label_is_the_value_at_its_place(low in -9.0..11.0, decades in 0.0..8.0) {
            let ends = [low, low + decades].map(|power: f64| 10_f64.powf(power));
            let scale = Scale::over(ends.into_iter(), 0, 100_000);
            for mark in scale.marks() {
                let shown = read(&label(mark));
                prop_assert!((shown / mark - 1.0).abs() < 1e-9, "{mark}: {}", label(mark));
            }
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
    fn points_without_a_place_on_the_axes_are_left_out() {
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
        let figure = curves(&plot);
        assert_eq!(
            figure.alt,
            "Time. exact: 10 at 1k, 9k at 1M; bandwidth: 5 at 1k, 5k at 1M; nothing: "
        );
        assert!(figure.svg().starts_with("<svg") && figure.svg().contains("entries"));
    }
}
