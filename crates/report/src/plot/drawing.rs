//! What a figure consists of: lines, shapes and text, each with its place in pixels from the top left.

use super::{HEADING, LEFT, WIDTH};

/// A place: pixels from the left and from the top.
pub(super) type Point = (i32, i32);

/// A drawing, [`WIDTH`] wide.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drawing {
    pub(super) height: i32,
    /// In the order in which they are painted.
    pub(super) shapes: Vec<Shape>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    Line { points: Vec<Point>, stroke: Stroke },
    Polygon { points: Vec<Point>, paint: Paint },
    Circle { centre: Point, paint: Paint },
    Text { text: String, at: Point, anchor: TextAnchor, size: f64, style: TextStyle },
}

/// A tone. The first three follow the page, which can be dark; grays have enough contrast on any page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tone {
    /// Black on paper.
    Ink,
    /// White on paper.
    Paper,
    /// A light line.
    Grid,
    /// A gray, from 0, black, to 255, white: the same on every page.
    Gray(u8),
}

impl Tone {
    /// Its gray on white paper, from 0, black, to 255, white.
    pub(super) const fn gray(self) -> u8 {
        match self {
            Self::Ink => 0,
            Self::Paper => 255,
            Self::Grid => 0xb8,
            Self::Gray(gray) => gray,
        }
    }
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stroke {
    pub(super) tone: Tone,
    /// In pixels.
    pub(super) width: f64,
    /// The lengths of dashes and gaps in turn, in pixels; empty for a solid line.
    pub(super) dashes: &'static [u8],
}

/// The gray of what stands in the background.
const FAINT: Tone = Tone::Gray(0x76);

pub(super) const INK: Stroke = Stroke { tone: Tone::Ink, width: 1.0, dashes: &[] };
pub(super) const GRAY: Stroke = Stroke { tone: FAINT, ..INK };
pub(super) const THICK_GRAY: Stroke = Stroke { width: 3.0, ..GRAY };
pub(super) const GRID: Stroke = Stroke { tone: Tone::Grid, ..INK };

/// How a shape is painted: filled, and outlined where it has a stroke.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Paint {
    pub(super) fill: Tone,
    pub(super) outline: Option<Stroke>,
}

impl Paint {
    pub(super) const INK: Self = Self { fill: Tone::Ink, outline: None };
    pub(super) const OPEN: Self = Self { fill: Tone::Paper, outline: Some(INK) };
    pub(super) const OPEN_GRAY: Self =
        Self { fill: Tone::Paper, outline: Some(Stroke { width: 2.0, ..GRAY }) };

    /// Filled with `tone` and outlined with ink.
    pub(super) const fn outlined(fill: Tone) -> Self {
        Self { fill, outline: Some(INK) }
    }
}

/// How text is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TextStyle {
    pub(super) tone: Tone,
    pub(super) is_bold: bool,
}

impl TextStyle {
    pub(super) const PLAIN: Self = Self { tone: Tone::Ink, is_bold: false };
    pub(super) const BOLD: Self = Self { is_bold: true, ..Self::PLAIN };
    pub(super) const FAINT: Self = Self { tone: FAINT, is_bold: false };
}

/// Where text stands relative to its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TextAnchor {
    Before,
    After,
    Around,
}

/// The height of text, in pixels.
const TEXT: f64 = 16.0;
/// The height of text in the background and in cells.
const SMALL_TEXT: f64 = 14.0;
/// The mean width of a character, in heights: of a wide sans-serif font.
const CHARACTER: f64 = 0.58;

impl Drawing {
    pub(super) const fn new(height: i32) -> Self {
        Self { height, shapes: Vec::new() }
    }

    /// Adds lines of text below the image.
    pub(super) fn add_note(&mut self, text: &str) {
        /// The height of a line.
        const LINE: i32 = 20;
        let room = (f64::from(WIDTH - 16) / (CHARACTER * SMALL_TEXT)) as usize;
        for line in wrapped(text, room) {
            self.text(&line, (8, self.height + LINE / 2), TextAnchor::After, TextStyle::FAINT);
            self.height += LINE;
        }
        self.height += 4;
    }

    pub(super) fn text(&mut self, text: &str, at: Point, anchor: TextAnchor, style: TextStyle) {
        let size = if style == TextStyle::PLAIN || style.is_bold { TEXT } else { SMALL_TEXT };
        self.sized_text(text, at, anchor, style, size);
    }

    fn sized_text(
        &mut self,
        text: &str,
        at: Point,
        anchor: TextAnchor,
        style: TextStyle,
        size: f64,
    ) {
        self.shapes.push(Shape::Text { text: text.to_owned(), at, anchor, size, style });
    }

    /// The heading of the rows below, with its top at `y`: [`HEADING`] high.
    pub(super) fn heading(&mut self, text: &str, y: i32) {
        self.text(text, (8, y + HEADING / 2 + 2), TextAnchor::After, TextStyle::BOLD);
    }

    /// The label of a row, left of [`LEFT`]: smaller where it would not fit.
    pub(super) fn row_label(&mut self, text: &str, y: i32) {
        let room = f64::from(LEFT - 16) / (CHARACTER * text.chars().count() as f64);
        let at = (LEFT - 12, y);
        self.sized_text(text, at, TextAnchor::Before, TextStyle::PLAIN, room.min(TEXT));
    }

    pub(super) fn line(&mut self, points: &[Point], stroke: Stroke) {
        self.shapes.push(Shape::Line { points: points.to_vec(), stroke });
    }

    pub(super) fn circle(&mut self, centre: Point, paint: Paint) {
        self.shapes.push(Shape::Circle { centre, paint });
    }

    pub(super) fn polygon(&mut self, points: &[Point], paint: Paint) {
        self.shapes.push(Shape::Polygon { points: points.to_vec(), paint });
    }

    pub(super) fn rectangle(&mut self, [(left, top), (right, bottom)]: [Point; 2], paint: Paint) {
        self.polygon(&[(left, top), (right, top), (right, bottom), (left, bottom)], paint);
    }

    /// Draws a horizontal bar between two values at `y`, with its ends.
    pub(super) fn horizontal_interval(&mut self, (low, high): (i32, i32), y: i32, stroke: Stroke) {
        self.line(&[(low, y), (high, y)], stroke);
        for x in [low, high] {
            self.line(&[(x, y - 3), (x, y + 3)], stroke);
        }
    }

    /// Draws a vertical bar between two values at `x`, with its ends.
    pub(super) fn vertical_interval(&mut self, x: i32, (low, high): (i32, i32), stroke: Stroke) {
        self.line(&[(x, low), (x, high)], stroke);
        for y in [low, high] {
            self.line(&[(x - 3, y), (x + 3, y)], stroke);
        }
    }
}

/// The text in lines of at most `room` characters, broken between words; a longer word has a line of its own.
fn wrapped(text: &str, room: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_note_has_several_lines() {
        assert_eq!(wrapped("one two three four", 9), ["one two", "three", "four"]);
        let mut drawing = Drawing::new(100);
        drawing.add_note(&"a policy with a long description ".repeat(6));
        assert_eq!((drawing.shapes.len(), drawing.height), (2, 144));
    }
}
