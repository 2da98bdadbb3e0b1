//! Writes SVG: only the elements that the maps use, and the measures and colours that all of them share.

use std::fmt::Write as _;

/// A point of the drawing: right and down.
pub(super) type DrawingPoint = (f64, f64);

/// Side of a cell, in units of the drawing.
pub(super) const CELL: f64 = 40.0;
/// Space around the floor plan, for coordinates.
pub(super) const MARGIN: f64 = 44.0;
/// Width of the legend.
pub(super) const LEGEND: f64 = 372.0;

pub(super) const INK: &str = "#1f2933";
pub(super) const MUTED: &str = "#7b8794";
pub(super) const PAPER: &str = "#ffffff";

const FONT: &str = "Inter, 'Helvetica Neue', Helvetica, Arial, 'DejaVu Sans', sans-serif";

/// An SVG document in progress. `style` arguments are attributes, written without change.
pub(super) struct SvgCanvas(String);

impl SvgCanvas {
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

    pub(super) fn rect(
        &mut self,
        (x, y): DrawingPoint,
        (width, height): DrawingPoint,
        style: &str,
    ) {
        self.line(format_args!(
            "<rect x='{x:.1}' y='{y:.1}' width='{width:.1}' height='{height:.1}' {style}/>"
        ));
    }

    pub(super) fn circle(&mut self, (x, y): DrawingPoint, radius: f64, style: &str) {
        self.line(format_args!("<circle cx='{x:.1}' cy='{y:.1}' r='{radius:.1}' {style}/>"));
    }

    /// A path, filled only if `style` says so.
    pub(super) fn path(&mut self, d: &str, style: &str) {
        let fill = if style.contains("fill=") { "" } else { "fill='none' " };
        self.line(format_args!("<path d='{d}' {fill}{style}/>"));
    }

    pub(super) fn text(&mut self, (x, y): DrawingPoint, text: &str, style: &str) {
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
