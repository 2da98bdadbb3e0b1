//! The pictures that a server is shown.

use std::io::Cursor;

use image::{ImageFormat, Rgb, RgbImage};

use super::super::message::ImageUrl;

/// Edge in pixels. Some models refuse images that are smaller than a patch of theirs, of up to 32 pixels.
const EDGE: u32 = 56;

/// What fills a square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Colour {
    Red,
    Blue,
}

impl Colour {
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Red => "red",
            Self::Blue => "blue",
        }
    }

    /// A square of it; the error says why it could not be written.
    pub(super) fn picture(self) -> Result<ImageUrl, String> {
        let colour = match self {
            Self::Red => Rgb([230, 20, 20]),
            Self::Blue => Rgb([20, 20, 230]),
        };
        let mut png = Cursor::new(Vec::new());
        let square = RgbImage::from_pixel(EDGE, EDGE, colour);
        square.write_to(&mut png, ImageFormat::Png).map_err(|error| error.to_string())?;
        Ok(ImageUrl::of_bytes("image/png", png.get_ref()))
    }
}
