//! A glyph for every shape, seen from the side.

use super::canvas::{DrawingPoint, SvgCanvas};
use crate::catalogue::Shape;

/// Outline of every glyph.
const EDGE: &str = "#323f4b";

/// Draws `shape` around `middle`, about 16 units wide and high.
pub(super) fn draw(canvas: &mut SvgCanvas, (x, y): DrawingPoint, shape: Shape, [r, g, b]: [u8; 3]) {
    let fill =
        format!("fill='rgb({r},{g},{b})' stroke='{EDGE}' stroke-width='1' stroke-linejoin='round'");
    let thin = format!("stroke='{EDGE}' stroke-width='1' stroke-linecap='round'");
    let bold = format!("stroke='{EDGE}' stroke-width='1.6' stroke-linecap='round'");
    canvas.open(&format!("transform='translate({x:.1} {y:.1})'"));
    match shape {
        Shape::Barrel => {
            canvas.path("M-5 -7H5Q6.5 0 5 7H-5Q-6.5 0 -5 -7Z", &fill);
            canvas.path("M-5.7 -3H5.7M-5.7 3H5.7", &thin);
        }
        Shape::Carton => {
            canvas.rect((-7.0, -6.0), (14.0, 12.0), &fill);
            canvas.path("M0 -6V6M-2.5 -6V-1H2.5V-6", &thin);
        }
        Shape::Toolbox => {
            canvas.path("M-4 -3V-6H4V-3", &bold);
            canvas.rect((-7.5, -3.0), (15.0, 9.0), &format!("rx='1' {fill}"));
            canvas.path("M-7.5 1H7.5", &thin);
        }
        Shape::FireExtinguisher => {
            canvas.path("M0 -5L5 -7M0 -5Q-5 -5 -5 0", &bold);
            canvas.path("M-3 7V-2Q-3 -5 0 -5Q3 -5 3 -2V7Z", &fill);
        }
        Shape::Cone => {
            canvas.path("M-1.3 -7H1.3L4.8 5H-4.8Z", &fill);
            canvas.path("M-2.4 -3H2.4L3.6 1H-3.6Z", "fill='#ffffff'");
            canvas.rect((-7.0, 5.0), (14.0, 2.2), &fill);
        }
        Shape::Tyre => {
            canvas.circle((0.0, 0.0), 7.0, &fill);
            canvas.circle(
                (0.0, 0.0),
                3.0,
                &format!("fill='#d3d9e0' stroke='{EDGE}' stroke-width='1'"),
            );
        }
        Shape::Bucket => {
            canvas.path("M-6 -3Q0 -11 6 -3", &thin);
            canvas.path("M-6.5 -3H6.5L4.5 7H-4.5Z", &fill);
        }
        Shape::Helmet => {
            canvas.path("M-6 3Q-6 -6 0 -6Q6 -6 6 3Z", &fill);
            canvas.path("M-8 3H8V5H-8Z", &fill);
            canvas.path("M0 -6V3", &thin);
        }
        Shape::Crate => {
            canvas.rect((-7.5, -6.0), (15.0, 12.0), &fill);
            canvas.path("M-7.5 -2H7.5M-7.5 2H7.5M-3.5 -6V6M3.5 -6V6", &thin);
        }
        Shape::Jerrycan => {
            canvas.path("M-6 7V-3L-2 -6H6V7Z", &fill);
            canvas.path("M-5.5 -5.5L-3.5 -7.5", &bold);
            canvas.path("M-3 -1L3 5M3 -1L-3 5", &thin);
        }
        Shape::GasCylinder => {
            canvas.path("M-1.5 -8H1.5M0 -8V-6", &bold);
            canvas.path("M-3.5 7.5V-2.5Q-3.5 -6 0 -6Q3.5 -6 3.5 -2.5V7.5Z", &fill);
        }
        Shape::CableReel => {
            canvas.rect((-4.0, -5.0), (8.0, 10.0), &fill);
            canvas.path("M-4 -2H4M-4 1H4M-4 4H4", &thin);
            let wood = format!("fill='#b98b57' stroke='{EDGE}' stroke-width='1'");
            canvas.rect((-7.0, -7.0), (3.0, 14.0), &wood);
            canvas.rect((4.0, -7.0), (3.0, 14.0), &wood);
        }
    }
    canvas.close();
}
