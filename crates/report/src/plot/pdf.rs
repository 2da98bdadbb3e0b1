//! Drawings as PDF: vector graphics, black on white. Text is written as outlines of the font that the renderer of the warehouse has
//! (Ubuntu Light, thickened), so a file needs no font and looks alike everywhere.

use std::io::Write;

use ab_glyph::{Font, FontRef, OutlineCurve};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use pdf_writer::{Content, Filter, Finish, Pdf, Rect, Ref, TextStr};

use super::WIDTH;
use super::drawing::{Drawing, Paint, Point, Shape, Stroke, TextAnchor, Tone};

/// Points of the page for each pixel: a figure is 164 mm wide, as is the text of an A4 page.
const POINTS: f32 = 0.567;
/// How much a letter grows on all sides together, in heights: Ubuntu Light is too thin for print.
const THICKER: f32 = 0.022;
const BOLDER: f32 = 0.06;

/// The drawing as a file of one page, titled `title`.
pub(super) fn file(drawing: &Drawing, title: &str) -> Vec<u8> {
    let (width, height) = (WIDTH as f32, drawing.height as f32);
    let mut content = Content::new();
    content.transform([POINTS, 0.0, 0.0, POINTS, 0.0, 0.0]);
    let mut canvas = Canvas { content, height };
    for shape in &drawing.shapes {
        canvas.draw(shape);
    }
    let [catalogue, pages, page, contents, info] = [1, 2, 3, 4, 5].map(Ref::new);
    let mut pdf = Pdf::new();
    pdf.catalog(catalogue).pages(pages);
    pdf.pages(pages).kids([page]).count(1);
    let mut of_page = pdf.page(page);
    of_page.parent(pages).contents(contents);
    of_page.media_box(Rect::new(0.0, 0.0, width * POINTS, height * POINTS));
    of_page.resources();
    of_page.finish();
    pdf.stream(contents, &compressed(&canvas.content.finish())).filter(Filter::FlateDecode);
    pdf.document_info(info).title(TextStr(title)).creator(TextStr("MemTransfer"));
    pdf.finish()
}

fn compressed(content: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    match encoder.write_all(content).and_then(|()| encoder.finish()) {
        Ok(compressed) => compressed,
        Err(_) => unreachable!("writing to memory does not fail"),
    }
}

struct Canvas {
    content: Content,
    /// Of the drawing, in pixels: the page counts from the bottom.
    height: f32,
}

impl Canvas {
    fn at(&self, (x, y): Point) -> (f32, f32) {
        (x as f32, self.height - y as f32)
    }

    fn draw(&mut self, shape: &Shape) {
        match shape {
            Shape::Line { points, stroke } => {
                self.outline(*stroke);
                self.path(points);
                self.content.stroke();
            }
            Shape::Polygon { points, paint } => {
                self.prepare(*paint);
                self.path(points);
                self.content.close_path();
                self.paint(*paint);
            }
            Shape::Circle { centre, paint } => {
                self.prepare(*paint);
                self.circle(*centre, 4.0);
                self.paint(*paint);
            }
            Shape::Text { text, at, anchor, size, style } => {
                let thicker = if style.is_bold { BOLDER } else { THICKER };
                self.text(text, *at, *anchor, (*size as f32, thicker), style.tone);
            }
        }
    }

    fn path(&mut self, points: &[Point]) {
        let mut places = points.iter().map(|point| self.at(*point)).collect::<Vec<_>>().into_iter();
        if let Some((x, y)) = places.next() {
            self.content.move_to(x, y);
        }
        for (x, y) in places {
            self.content.line_to(x, y);
        }
    }

    fn circle(&mut self, centre: Point, radius: f32) {
        /// The length of the handles of four curves that make a circle, in radii.
        const HANDLE: f32 = 0.552_284_8;
        let ((x, y), r, h) = (self.at(centre), radius, radius * HANDLE);
        self.content
            .move_to(x + r, y)
            .cubic_to(x + r, y + h, x + h, y + r, x, y + r)
            .cubic_to(x - h, y + r, x - r, y + h, x - r, y)
            .cubic_to(x - r, y - h, x - h, y - r, x, y - r)
            .cubic_to(x + h, y - r, x + r, y - h, x + r, y)
            .close_path();
    }

    fn outline(&mut self, Stroke { tone, width, dashes }: Stroke) {
        self.content.set_stroke_gray(gray(tone)).set_line_width(width as f32);
        self.content.set_dash_pattern(dashes.iter().copied().map(f32::from), 0.0);
    }

    /// Sets the colours of the path that follows.
    fn prepare(&mut self, Paint { fill, outline }: Paint) {
        self.content.set_fill_gray(gray(fill));
        if let Some(stroke) = outline {
            self.outline(stroke);
        }
    }

    fn paint(&mut self, Paint { outline, .. }: Paint) {
        match outline {
            Some(_) => self.content.fill_nonzero_and_stroke(),
            None => self.content.fill_nonzero(),
        };
    }

    /// Writes `text` in letters of a height and thickness.
    fn text(
        &mut self,
        text: &str,
        at: Point,
        anchor: TextAnchor,
        (size, thicker): (f32, f32),
        tone: Tone,
    ) {
        let Ok(font) = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT) else {
            unreachable!("the font is compiled in and valid");
        };
        let em = font.units_per_em().unwrap_or(1000.0);
        let scale = size / em;
        let glyphs: Vec<_> = text.chars().map(|character| font.glyph_id(character)).collect();
        let width: f32 = glyphs.iter().map(|glyph| font.h_advance_unscaled(*glyph) * scale).sum();
        let (x, y) = self.at(at);
        let mut left = match anchor {
            TextAnchor::After => x,
            TextAnchor::Around => x - width / 2.0,
            TextAnchor::Before => x - width,
        };
        // As in SVG, the middle of the letters is 0.35 heights above the baseline.
        let baseline = y - 0.35 * size;
        let tone = gray(tone);
        self.content.set_fill_gray(tone).set_stroke_gray(tone).set_line_width(thicker * size);
        self.content.set_dash_pattern([], 0.0);
        for glyph in glyphs {
            if let Some(outline) = font.outline(glyph) {
                self.letter(&outline.curves, (left, baseline), scale);
                self.content.fill_nonzero_and_stroke();
            }
            left += font.h_advance_unscaled(glyph) * scale;
        }
    }

    /// Adds the outline of a letter to the path.
    fn letter(&mut self, curves: &[OutlineCurve], (left, baseline): (f32, f32), scale: f32) {
        // Hundredths of a pixel are exact enough, and shorter.
        let short = |value: f32| (value * 100.0).round() / 100.0;
        let place = |point: &ab_glyph::Point| {
            (short(left + point.x * scale), short(baseline + point.y * scale))
        };
        let mut end = None;
        for curve in curves {
            let (from, handles, to) = match curve {
                OutlineCurve::Line(a, b) => (a, None, b),
                OutlineCurve::Quad(a, b, c) => (a, Some((thirds(a, b), thirds(c, b))), c),
                OutlineCurve::Cubic(a, b, c, d) => (a, Some((*b, *c)), d),
            };
            if end != Some(*from) {
                let (x, y) = place(from);
                self.content.move_to(x, y);
            }
            let (x, y) = place(to);
            match handles.map(|(first, second)| (place(&first), place(&second))) {
                None => self.content.line_to(x, y),
                Some(((x1, y1), (x2, y2))) => self.content.cubic_to(x1, y1, x2, y2, x, y),
            };
            end = Some(*to);
        }
        self.content.close_path();
    }
}

/// The handle of a cubic curve at `end` that a quadratic curve with the one `handle` is.
fn thirds(end: &ab_glyph::Point, handle: &ab_glyph::Point) -> ab_glyph::Point {
    let between = |end: f32, handle: f32| end + (handle - end) * 2.0 / 3.0;
    ab_glyph::point(between(end.x, handle.x), between(end.y, handle.y))
}

fn gray(tone: Tone) -> f32 {
    f32::from(tone.gray()) / 255.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Stack, StackRow, stack};

    #[test]
    fn a_file_has_one_page_of_the_figure_s_size_and_its_title() {
        let row = StackRow {
            heading: Some("Episodic".to_owned()),
            label: "new, 4".to_owned(),
            lengths: Some(vec![40.0, 20.0]),
        };
        let figure = stack(&Stack {
            id: "failures".to_owned(),
            caption: "Failures (−3 ± 1).".to_owned(),
            axis: "%",
            to: Some(100.0),
            parts: vec!["looped".to_owned(), "blocked".to_owned()],
            rows: vec![row],
        });
        let file = figure.pdf();
        assert_eq!(file, figure.pdf(), "the same each time");
        let text = String::from_utf8_lossy(&file);
        assert!(text.starts_with("%PDF-1.7") && text.trim_end().ends_with("%%EOF"));
        let (width, height) = (WIDTH as f32 * POINTS, figure.drawing.height as f32 * POINTS);
        assert!(text.contains(&format!("/MediaBox [0 0 {width} {height}]")));
        assert!(text.contains("/Count 1") && text.contains("/Title"));
    }
}
