//! Marks: letters of targets, starts, arrows and barricades, used on the floor plan and in the legend.

use domain::Heading;

use super::canvas::{DrawingPoint, INK, PAPER, SvgCanvas};
use crate::case::Start;

/// The unit vector of `heading` on the drawing, where y grows downwards.
pub(super) fn direction(heading: Heading) -> DrawingPoint {
    let (x, y) = heading.vector();
    (f64::from(x), -f64::from(y))
}

/// The round badge with a target's letter.
pub(super) fn badge(canvas: &mut SvgCanvas, (x, y): DrawingPoint, letter: char) {
    let fill = if letter == 'B' { "#0f766e" } else { INK };
    canvas.circle((x, y), 8.0, &format!("fill='{fill}'"));
    canvas.text(
        (x, y + 4.0),
        &letter.to_string(),
        &format!("font-size='11' font-weight='700' fill='{PAPER}' text-anchor='middle'"),
    );
}

/// How a route is drawn.
pub(super) struct Style {
    pub(super) colour: &'static str,
    pub(super) dashes: &'static str,
    pub(super) width: f64,
    /// Position among the six, from -2.5 to 2.5.
    pub(super) lane: f64,
}

pub(super) const fn style(start: Start) -> Style {
    let (colour, dashes, width, lane) = match start {
        Start::Original => ("#0b5fa5", "", 2.6, -2.5),
        Start::Opposite => ("#3fa9dc", "", 2.6, -1.5),
        Start::Nearby => ("#2a9d5c", "", 2.6, -0.5),
        Start::Distant => ("#8250c4", "", 2.6, 0.5),
        Start::Test => ("#e8780c", "", 3.2, 1.5),
        Start::Blocked => ("#c81e3a", "7 3.5", 3.2, 2.5),
        Start::After | Start::Elsewhere => ("#0b5fa5", "7 3.5", 2.6, -2.5),
    };
    Style { colour, dashes, width, lane }
}

/// The mark of a start at `at`.
pub(super) fn start_disc(canvas: &mut SvgCanvas, at: DrawingPoint, start: Start, heading: Heading) {
    let Style { colour, dashes, .. } = style(start);
    if start == Start::Blocked {
        let rim =
            format!("fill='none' stroke='{colour}' stroke-width='2.6' stroke-dasharray='5 2.5'");
        canvas.circle(at, 13.5, &rim);
        return;
    }
    let disc =
        format!("fill='{PAPER}' stroke='{colour}' stroke-width='2.2' stroke-dasharray='{dashes}'");
    canvas.circle(at, 10.0, &disc);
    let (dx, dy) = direction(heading);
    pointer(canvas, at, dy.atan2(dx).to_degrees(), 0.85, &format!("fill='{colour}'"));
}

/// An arrow head of about 15 units that points `angle` degrees clockwise from east.
pub(super) fn pointer(
    canvas: &mut SvgCanvas,
    (x, y): DrawingPoint,
    angle: f64,
    size: f64,
    look: &str,
) {
    canvas.open(&format!("transform='translate({x:.1} {y:.1}) rotate({angle:.0}) scale({size})'"));
    canvas.path("M8.5 0L-6 7L-2.5 0L-6 -7Z", &format!("{look} stroke-linejoin='round'"));
    canvas.close();
}

pub(super) fn chevron(canvas: &mut SvgCanvas, (x, y): DrawingPoint, angle: f64, colour: &str) {
    canvas.open(&format!("transform='translate({x:.1} {y:.1}) rotate({angle:.0})'"));
    canvas.path("M5 0L-3.2 4.4L-1.2 0L-3.2 -4.4Z", &format!("fill='{colour}'"));
    canvas.close();
}

/// A square of red and white stripes, `size` wide.
pub(super) fn barricade(canvas: &mut SvgCanvas, (x, y): DrawingPoint, size: f64) {
    let (x, y, size) = (x + 1.5, y + 1.5, size - 3.0);
    canvas.rect((x, y), (size, size), "fill='#ffffff'");
    // Slanted stripes at 45 degrees, clipped to the square.
    let stripe = size / 4.0;
    let mut path = String::new();
    for k in [-3.0, -1.0, 1.0, 3.0] {
        let (from, to) = (k * stripe, (k + 1.0) * stripe);
        // Corners of the band from <= u + v <= to of the unit square's diagonal coordinates.
        let at = |sum: f64| {
            let sum = sum + size;
            if sum <= size {
                ((sum, 0.0), (0.0, sum))
            } else {
                ((size, sum - size), (sum - size, size))
            }
        };
        let ((ax, ay), (bx, by)) = at(from);
        let ((cx, cy), (dx, dy)) = at(to);
        path += &format!(
            "M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z",
            x + ax,
            y + ay,
            x + bx,
            y + by,
            x + dx,
            y + dy,
            x + cx,
            y + cy
        );
    }
    canvas.path(&path, "fill='#d7263d'");
    canvas.rect(
        (x, y),
        (size, size),
        &format!("fill='none' stroke='{INK}' stroke-width='1.5' rx='2'"),
    );
}
