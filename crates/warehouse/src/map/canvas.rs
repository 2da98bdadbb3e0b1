//! A small SVG writer: just the elements that the maps use.

use std::fmt::Write as _;

use super::Point;

const FONT: &str = "Inter, 'Helvetica Neue', Helvetica, Arial, 'DejaVu Sans', sans-serif";

/// An SVG document in progress. `style` arguments are attributes, written as they are.
pub(super) struct Canvas(String);

impl Canvas {
    pub(super) fn new(width: f64, height: f64, paper: &str) -> Self {
        let mut canvas = Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             width=\"{width:.0}\" height=\"{height:.0}\" font-family=\"{FONT}\">\n"
        ));
        canvas.rect((0.0, 0.0), (width, height), &format!("fill='{paper}'"));
        canvas
    }

    pub(super) fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    fn line(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = self.0.write_fmt(element);
        self.0.push('\n');
    }

    pub(super) fn rect(&mut self, (x, y): Point, (width, height): Point, style: &str) {
        self.line(format_args!(
            "<rect x='{x:.1}' y='{y:.1}' width='{width:.1}' height='{height:.1}' {style}/>"
        ));
    }

    pub(super) fn circle(&mut self, (x, y): Point, radius: f64, style: &str) {
        self.line(format_args!("<circle cx='{x:.1}' cy='{y:.1}' r='{radius:.1}' {style}/>"));
    }

    /// An unfilled path, unless `style` fills it.
    pub(super) fn path(&mut self, d: &str, style: &str) {
        let fill = if style.contains("fill=") { "" } else { "fill='none' " };
        self.line(format_args!("<path d='{d}' {fill}{style}/>"));
    }

    pub(super) fn text(&mut self, (x, y): Point, text: &str, style: &str) {
        let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        self.line(format_args!("<text x='{x:.1}' y='{y:.1}' {style}>{text}</text>"));
    }

    pub(super) fn open(&mut self, style: &str) {
        self.line(format_args!("<g {style}>"));
    }

    pub(super) fn close(&mut self) {
        self.line(format_args!("</g>"));
    }
}
