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

use crate::document::ReportFigure;

/// The width of every figure: that of the text of the page.
const WIDTH: i32 = 820;
/// The horizontal position where row labels end and the plot begins.
const LEFT: i32 = 250;
const RIGHT: i32 = 24;
/// The height of the labels of a horizontal axis.
const BOTTOM: i32 = 44;

/// An SVG image under construction. Coordinates are pixels from the top left.
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
        let svg = format!(
            "<svg width=\"{WIDTH}\" height=\"{0}\" viewBox=\"0 0 {WIDTH} {0}\" \
             xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\">\n{1}</svg>\n",
            self.height, self.body
        );
        let alt = format!("{caption} {}", in_words.collect::<Vec<_>>().join("; "));
        ReportFigure { id: id.to_owned(), caption: caption.to_owned(), alt, svg }
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

    /// A round step that gives at most seven marks.
    fn step(&self) -> f64 {
        let rough = (self.to - self.from) / 6.0;
        let magnitude = 10_f64.powf(rough.log10().floor());
        let steps = [1.0, 2.0, 2.5, 5.0, 10.0].map(|step| step * magnitude);
        steps.into_iter().find(|step| *step >= rough).unwrap_or(rough)
    }

    /// Draws grid lines, marks and the name of the axis.
    fn draw(&self, svg: &mut Svg, name: &str, top: i32, bottom: i32) {
        let step = self.step();
        let marks = ((self.to - self.from) / step + 1e-9).floor() as u32;
        for mark in 0..=marks {
            let value = self.from + f64::from(mark) * step;
            let x = self.x(value);
            svg.line(&[(x, top), (x, bottom)], Stroke::Rule);
            let digits = usize::from(step < 1.0) + usize::from(step < 0.1);
            svg.text(
                &format!("{value:.digits$}"),
                (x, bottom + 12),
                TextAnchor::Around,
                TextStyle::Plain,
            );
        }
        let middle = i32::midpoint(self.x(self.from), self.x(self.to));
        svg.text(name, (middle, bottom + 32), TextAnchor::Around, TextStyle::Plain);
    }
}
