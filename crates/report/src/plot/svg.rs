//! Drawings as SVG. Ink, paper and grid are classes that take the colours of the page, with black and white as attributes where
//! there is no style sheet.

use std::fmt::Write;

use super::WIDTH;
use super::drawing::{Drawing, Paint, Point, Shape, Stroke, TextAnchor, Tone};

/// The drawing as an `svg` element.
pub(super) fn element(drawing: &Drawing) -> String {
    let mut body = String::new();
    for shape in &drawing.shapes {
        // Writing to a string cannot fail.
        let _ = writeln!(body, "{}", element_of(shape));
    }
    format!(
        "<svg width=\"{WIDTH}\" height=\"{0}\" viewBox=\"0 0 {WIDTH} {0}\" \
         xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\">\n{body}</svg>\n",
        drawing.height
    )
}

fn element_of(shape: &Shape) -> String {
    match shape {
        Shape::Line { points, stroke } => {
            let attributes = attributes(None, Some(*stroke));
            format!(r#"<polyline points="{}" {attributes}/>"#, coordinates(points))
        }
        Shape::Polygon { points, paint } => {
            format!(r#"<polygon points="{}" {}/>"#, coordinates(points), painted(*paint))
        }
        Shape::Circle { centre: (x, y), paint } => {
            format!(r#"<circle cx="{x}" cy="{y}" r="4" {}/>"#, painted(*paint))
        }
        Shape::Text { text, at: (x, y), anchor, size, style } => {
            let anchor = match anchor {
                TextAnchor::Before => "end",
                TextAnchor::After => "start",
                TextAnchor::Around => "middle",
            };
            let weight = if style.is_bold { r#" font-weight="bold""# } else { "" };
            let (attributes, text) = (attributes(Some(style.tone), None), escaped(text));
            format!(
                r#"<text x="{x}" y="{y}" dy="0.35em" text-anchor="{anchor}" font-size="{size:.1}"{weight} {attributes}>{text}</text>"#
            )
        }
    }
}

fn painted(paint: Paint) -> String {
    attributes(Some(paint.fill), paint.outline)
}

/// The attributes of a shape with this filling and outline.
fn attributes(fill: Option<Tone>, stroke: Option<Stroke>) -> String {
    let class = |tone: Option<Tone>, of: &'static [&'static str; 3]| match tone {
        Some(Tone::Ink) => Some(of[0]),
        Some(Tone::Paper) => Some(of[1]),
        Some(Tone::Grid) => Some(of[2]),
        Some(Tone::Gray(_)) | None => None,
    };
    let classes: Vec<&str> = class(fill, &["ink", "paper", "grid"])
        .into_iter()
        .chain(class(stroke.map(|stroke| stroke.tone), &["ink-line", "paper-line", "grid-line"]))
        .collect();
    let mut text = match classes.is_empty() {
        true => String::new(),
        false => format!(r#"class="{}" "#, classes.join(" ")),
    };
    text += &format!(r#"fill="{}""#, fill.map_or_else(|| "none".to_owned(), colour));
    if let Some(Stroke { tone, width, dashes }) = stroke {
        text += &format!(r#" stroke="{}""#, colour(tone));
        if width != 1.0 {
            text += &format!(r#" stroke-width="{width}""#);
        }
        if !dashes.is_empty() {
            let lengths: Vec<String> = dashes.iter().map(u8::to_string).collect();
            text += &format!(r#" stroke-dasharray="{}""#, lengths.join(" "));
        }
    }
    text
}

fn colour(tone: Tone) -> String {
    let gray = tone.gray();
    format!("#{gray:02x}{gray:02x}{gray:02x}")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn coordinates(points: &[Point]) -> String {
    points.iter().map(|(x, y)| format!("{x},{y}")).collect::<Vec<_>>().join(" ")
}
