//! Figures, readable in black and white and in print: with labels, intervals and legends.
//!
//! Colours carry no meaning. Dots differ by shape, filled or open; curves also by their dashes; parts of a bar by tone and
//! hatching. A figure is a [`Drawing`], which is written as SVG and as PDF.

mod course;
mod curves;
mod dots;
mod drawing;
mod heat;
mod pdf;
mod stack;
mod svg;

pub(super) use course::{Course, CourseCurve, CoursePoint, course};
pub use curves::{Curve, Curves, curves};
pub(super) use dots::{Dot, DotRow, dots};
pub(super) use heat::{HeatMap, HeatPanel, heat_map};
pub use stack::{Stack, StackRow, stack};

use drawing::{Drawing, GRAY, GRID, INK, Paint, Stroke, THICK_GRAY, TextAnchor, TextStyle, Tone};

/// The width of every figure: that of the text of the page.
const WIDTH: i32 = 820;
/// The horizontal position where row labels end and the plot begins.
const LEFT: i32 = 290;
/// The height of a heading between rows.
const HEADING: i32 = 26;
const RIGHT: i32 = 24;
/// The height of the labels of a horizontal axis.
const BOTTOM: i32 = 44;

/// A figure.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportFigure {
    /// Unique in the document; the name of its files.
    pub id: String,
    /// The caption.
    pub caption: String,
    /// Its content in words, for readers who do not see it.
    pub alt: String,
    drawing: Drawing,
}

impl ReportFigure {
    /// Makes a figure with its content `in_words`.
    fn new(
        drawing: Drawing,
        id: &str,
        caption: &str,
        in_words: impl Iterator<Item = String>,
    ) -> Self {
        let alt = format!("{caption} {}", in_words.collect::<Vec<_>>().join("; "));
        Self { id: id.to_owned(), caption: caption.to_owned(), alt, drawing }
    }

    /// The image, as an `svg` element.
    pub fn svg(&self) -> String {
        svg::element(&self.drawing)
    }

    /// The image, as a PDF file of one page of its size. Its letters are outlines, so it needs no font.
    pub fn pdf(&self) -> Vec<u8> {
        pdf::file(&self.drawing, &self.caption)
    }

    /// Adds a note under the image, to the caption and to the content in words.
    pub(super) fn add_note(&mut self, note: &str) {
        self.drawing.add_note(note.trim());
        self.caption += note;
        self.alt += note;
    }
}

/// A horizontal axis.
struct ValueAxis {
    from: f64,
    to: f64,
}

impl ValueAxis {
    /// The position of `value`.
    fn x(&self, value: f64) -> i32 {
        let share = ((value - self.from) / (self.to - self.from)).clamp(0.0, 1.0);
        LEFT + (share * f64::from(WIDTH - LEFT - RIGHT)).round() as i32
    }

    /// The marks with their labels: at most seven multiples of a step of one digit, so that as many decimals as the step has
    /// give every mark exactly.
    fn marks(&self) -> Vec<(f64, String)> {
        /// What a multiple may be off by, in steps, from rounding.
        const ROUNDING: f64 = 1e-9;
        let rough = (self.to - self.from) / 6.0;
        let exponent = rough.log10().floor() as i32;
        let steps = [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(exponent));
        let (step, exponent) = match steps.into_iter().find(|step| *step >= rough) {
            Some(step) => (step, exponent),
            None => (10_f64.powi(exponent + 1), exponent + 1),
        };
        let digits = usize::try_from(-exponent).unwrap_or(0);
        let first = (self.from / step - ROUNDING).ceil() as i64;
        let last = (self.to / step + ROUNDING).floor() as i64;
        let values = (first..=last).map(|multiple| multiple as f64 * step);
        values.map(|value| (value, format!("{value:.digits$}"))).collect()
    }

    /// Draws grid lines, marks and the name of the axis.
    fn draw(&self, drawing: &mut Drawing, name: &str, top: i32, bottom: i32) {
        for (value, label) in self.marks() {
            let x = self.x(value);
            drawing.line(&[(x, top), (x, bottom)], GRID);
            drawing.text(&label, (x, bottom + 12), TextAnchor::Around, TextStyle::PLAIN);
        }
        let middle = i32::midpoint(self.x(self.from), self.x(self.to));
        drawing.text(name, (middle, bottom + 32), TextAnchor::Around, TextStyle::PLAIN);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fourteen_milliseconds_have_no_rounded_marks() {
        let labels = |from, to| {
            let marks = ValueAxis { from, to }.marks().into_iter();
            marks.map(|(_, label)| label).collect::<Vec<_>>().join(" ")
        };
        for (from, to, expected) in [
            (0.0, 14.0, "0 5 10"),
            (0.0, 100.0, "0 20 40 60 80 100"),
            (0.0, 1.3, "0.0 0.5 1.0"),
            (0.0, 0.0042, "0.000 0.001 0.002 0.003 0.004"),
            (-3.0, 9.0, "-2 0 2 4 6 8"),
            (7.0, 30_000.0, "5000 10000 15000 20000 25000 30000"),
        ] {
            assert_eq!(labels(from, to), expected, "{from} to {to}");
        }
    }

    proptest! {
        #[test]
        fn a_label_is_the_value_at_its_place_and_places_are_equally_far_apart(
            from in prop_oneof![Just(0.0), -1e3..1e3_f64],
            digits in 1.0..10.0,
            exponent in -5..8,
        ) {
            let length = digits * 10_f64.powi(exponent);
            prop_assume!(length > from.abs() * 1e-6);
            let axis = ValueAxis { from, to: from + length };
            let marks = axis.marks();
            prop_assert!((2..=7).contains(&marks.len()), "{marks:?}");
            let read: Vec<f64> = marks.iter().map(|(_, label)| label.parse().unwrap()).collect();
            for (read, (value, _)) in read.iter().zip(&marks) {
                prop_assert!((read - value).abs() <= length * 1e-6, "{marks:?}");
                prop_assert!(axis.from - length * 1e-6 <= *read && *read <= axis.to + length * 1e-6);
            }
            let steps: Vec<f64> = read.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let places: Vec<i32> = read.iter().map(|value| axis.x(*value)).collect();
            let apart: Vec<i32> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
            for (step, apart_px) in steps.iter().zip(&apart) {
                prop_assert!((step - steps[0]).abs() <= length * 1e-6, "{marks:?}");
                prop_assert!((apart_px - apart[0]).abs() <= 1, "rounded to pixels: {places:?}");
            }
        }
    }
}
