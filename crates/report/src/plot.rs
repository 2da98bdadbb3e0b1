//! Figures as SVG: readable in black and white, with labels and error bars.
//!
//! Colors carry no meaning. Dots differ by shape, filled or open; parts of a bar by their order, a light or a dark
//! gray, and a number that the legend explains. Ink and paper are classes that take the colors of the page, with black
//! and white as attributes where there is no style sheet.

mod course;
mod curves;
mod dots;
mod stack;

pub(super) use course::{Course, course};
pub use curves::{Curve, Curves, curves};
pub(super) use dots::{Dot, DotRow, dots};
pub use stack::{Stack, StackRow, stack};

use std::fmt::Write;

/// The width of every figure: that of the text of the page.
const WIDTH: i32 = 820;
/// The horizontal position where row labels end and the plot begins.
const LEFT: i32 = 250;
const RIGHT: i32 = 24;
/// The height of the labels of a horizontal axis.
const BOTTOM: i32 = 44;
/// The height of a line below the plot.
const NOTE: i32 = 24;

/// A figure.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportFigure {
    /// Unique in the document; the name of its SVG file.
    pub id: String,
    /// The caption.
    pub caption: String,
    /// Its content in words, for readers who do not see it.
    pub alt: String,
    image: Svg,
}

impl ReportFigure {
    /// The image, as an `svg` element.
    pub fn svg(&self) -> String {
        self.image.element_text()
    }

    /// Adds a note under the image, to the caption and to the content in words.
    pub(super) fn add_note(&mut self, note: &str) {
        self.image.add_note(note.trim());
        self.caption += note;
        self.alt += note;
    }
}

/// An SVG image. Coordinates are pixels from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Svg {
    height: i32,
    body: String,
}

/// How a shape is painted: a class of the page's style sheet, with the attributes that it stands for.
#[derive(Clone, Copy)]
enum Paint {
    /// Filled with ink.
    Ink,
    /// Outlined with ink, filled with paper.
    Open,
    /// Outlined with gray, filled with paper.
    OpenGray,
    /// Outlined with ink, filled with dark gray.
    Dark,
    /// Outlined with ink, filled with light gray.
    Light,
}

impl Paint {
    const fn attributes(self) -> &'static str {
        match self {
            Self::Ink => r##"class="ink" fill="#000""##,
            Self::Open => r##"class="open" fill="#fff" stroke="#000""##,
            Self::OpenGray => {
                r##"class="open-gray" fill="#fff" stroke="#767676" stroke-width="2""##
            }
            Self::Dark => r##"class="bar" fill="#595959" stroke="#000""##,
            Self::Light => r##"class="bar" fill="#d6d6d6" stroke="#000""##,
        }
    }
}

/// How a line is drawn.
#[derive(Clone, Copy)]
enum Stroke {
    Ink,
    Gray,
    ThickGray,
    /// A grid line.
    Rule,
}

impl Stroke {
    const fn attributes(self) -> &'static str {
        match self {
            Self::Ink => r##"class="line" stroke="#000""##,
            Self::Gray => r##"stroke="#767676""##,
            Self::ThickGray => r##"stroke="#767676" stroke-width="3""##,
            Self::Rule => r##"class="rule" stroke="#b8b8b8""##,
        }
    }
}

/// How text is written.
#[derive(Clone, Copy)]
enum TextStyle {
    Plain,
    Bold,
    Faint,
    /// On a dark bar.
    OnDark,
    /// On a light bar.
    OnLight,
}

/// Where text stands relative to its point.
#[derive(Clone, Copy)]
enum TextAnchor {
    Before,
    After,
    Around,
}

impl Svg {
    fn new(height: i32) -> Self {
        Self { height, body: String::new() }
    }

    /// The figure with this image and its content `in_words`.
    fn finish(
        self,
        id: &str,
        caption: &str,
        in_words: impl Iterator<Item = String>,
    ) -> ReportFigure {
        let alt = format!("{caption} {}", in_words.collect::<Vec<_>>().join("; "));
        ReportFigure { id: id.to_owned(), caption: caption.to_owned(), alt, image: self }
    }

    /// The image as an `svg` element.
    fn element_text(&self) -> String {
        format!(
            "<svg width=\"{WIDTH}\" height=\"{0}\" viewBox=\"0 0 {WIDTH} {0}\" \
             xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\">\n{1}</svg>\n",
            self.height, self.body
        )
    }

    /// Adds a line of text below the image.
    fn add_note(&mut self, text: &str) {
        self.text(text, (8, self.height + NOTE / 2), TextAnchor::After, TextStyle::Faint);
        self.height += NOTE;
    }

    fn element(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.body, "{element}");
    }

    fn text(&mut self, text: &str, (x, y): (i32, i32), side: TextAnchor, style: TextStyle) {
        let anchor = match side {
            TextAnchor::Before => "end",
            TextAnchor::After => "start",
            TextAnchor::Around => "middle",
        };
        let style = match style {
            TextStyle::Plain => r##"font-size="16" class="ink" fill="#000""##,
            TextStyle::Bold => r##"font-size="16" font-weight="bold" class="ink" fill="#000""##,
            TextStyle::Faint => r##"font-size="14" fill="#767676""##,
            TextStyle::OnDark => r##"font-size="14" fill="#ffffff""##,
            TextStyle::OnLight => r##"font-size="14" fill="#000000""##,
        };
        let text = escaped(text);
        self.element(format_args!(
            r#"<text x="{x}" y="{y}" dy="0.35em" text-anchor="{anchor}" {style}>{text}</text>"#
        ));
    }

    /// The label of a row, left of [`LEFT`]: smaller where it would not fit.
    fn row_label(&mut self, text: &str, y: i32) {
        /// The mean width of a character, in font sizes: of a wide sans-serif font.
        const WIDTH: f64 = 0.58;
        let room = f64::from(LEFT - 16) / (WIDTH * text.chars().count() as f64);
        let (x, size, text) = (LEFT - 12, room.min(16.0), escaped(text));
        self.element(format_args!(
            r##"<text x="{x}" y="{y}" dy="0.35em" text-anchor="end" font-size="{size:.1}" class="ink" fill="#000">{text}</text>"##
        ));
    }

    fn line(&mut self, points: &[(i32, i32)], stroke: Stroke) {
        let (points, stroke) = (coordinates(points), stroke.attributes());
        self.element(format_args!(r#"<polyline points="{points}" fill="none" {stroke}/>"#));
    }

    /// A dashed gray line.
    fn dashed(&mut self, points: [(i32, i32); 2]) {
        let (points, stroke) = (coordinates(&points), Stroke::Gray.attributes());
        self.element(format_args!(
            r#"<polyline points="{points}" fill="none" {stroke} stroke-dasharray="6 4"/>"#
        ));
    }

    fn circle(&mut self, (x, y): (i32, i32), paint: Paint) {
        let paint = paint.attributes();
        self.element(format_args!(r#"<circle cx="{x}" cy="{y}" r="4" {paint}/>"#));
    }

    fn polygon(&mut self, points: &[(i32, i32)], paint: Paint) {
        let (points, paint) = (coordinates(points), paint.attributes());
        self.element(format_args!(r#"<polygon points="{points}" {paint}/>"#));
    }

    fn rectangle(&mut self, [(left, top), (right, bottom)]: [(i32, i32); 2], paint: Paint) {
        self.polygon(&[(left, top), (right, top), (right, bottom), (left, bottom)], paint);
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn coordinates(points: &[(i32, i32)]) -> String {
    points.iter().map(|(x, y)| format!("{x},{y}")).collect::<Vec<_>>().join(" ")
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
    fn draw(&self, svg: &mut Svg, name: &str, top: i32, bottom: i32) {
        for (value, label) in self.marks() {
            let x = self.x(value);
            svg.line(&[(x, top), (x, bottom)], Stroke::Rule);
            svg.text(&label, (x, bottom + 12), TextAnchor::Around, TextStyle::Plain);
        }
        let middle = i32::midpoint(self.x(self.from), self.x(self.to));
        svg.text(name, (middle, bottom + 32), TextAnchor::Around, TextStyle::Plain);
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
