//! Views as encoded images.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use domain::ImageFormat;
use jpeg_encoder::{ColorType, Encoder};
use peer::FrameView;
use png_file::Channels;

/// Quality of JPEG images, out of 100: labels stay readable.
pub const JPEG_QUALITY: u8 = 90;

/// Pixels that cannot be encoded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EncodeError(String);

/// A format, with its quality where it has one: for the manifest.
pub fn described(format: ImageFormat) -> String {
    match format {
        ImageFormat::Png => format.to_string(),
        ImageFormat::Jpeg => format!("{format} {JPEG_QUALITY}"),
    }
}

/// Encodes the colours of a view; its alpha channel is left out.
///
/// # Errors
/// When the view has no pixels, or not as many as its size says.
pub fn encode(view: &FrameView<'_>, format: ImageFormat) -> Result<Vec<u8>, EncodeError> {
    let &FrameView { width, height, pixels, .. } = view;
    let rgb: Vec<u8> = pixels.chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect();
    match format {
        ImageFormat::Png => png_file::encode(width, height, Channels::Rgb, &rgb)
            .map_err(|error| EncodeError(error.to_string())),
        ImageFormat::Jpeg => jpeg(width, height, &rgb).map_err(EncodeError),
    }
}

fn jpeg(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, String> {
    let size = |edge: u32| {
        u16::try_from(edge).map_err(|_| format!("an edge of {edge} pixels is too long for JPEG"))
    };
    let mut bytes = Vec::new();
    let encoder = Encoder::new(&mut bytes, JPEG_QUALITY);
    let encoded = encoder.encode(rgb, size(width)?, size(height)?, ColorType::Rgb);
    encoded.map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// The encoded view as a data URL, `data:image/...;base64,...`.
///
/// # Errors
/// As [`encode`].
pub fn data_url(view: &FrameView<'_>, format: ImageFormat) -> Result<String, EncodeError> {
    let mut url = format!("data:image/{format};base64,");
    STANDARD.encode_string(encode(view, format)?, &mut url);
    Ok(url)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(pixels: &[u8], height: u32) -> FrameView<'_> {
        FrameView { id: 1, content_hash: [7; 16], width: 8, height, pixels }
    }

    #[test]
    fn png_has_the_views_colours() {
        let pixels: Vec<u8> = (0..64_u8).flat_map(|i| [4 * i, 255 - i, i, 255]).collect();
        let png = encode(&view(&pixels, 8), ImageFormat::Png).unwrap();
        let image = png_file::RgbaImage::decode(&png).unwrap();
        assert_eq!((image.width(), image.height()), (8, 8));
        assert_eq!(image.as_bytes(), pixels);
        assert!(
            data_url(&view(&pixels, 8), ImageFormat::Png)
                .unwrap()
                .starts_with("data:image/png;base64,iVBOR")
        );
    }

    #[test]
    fn jpeg_has_the_views_size() {
        let jpeg = encode(&view(&[90; 4 * 64], 8), ImageFormat::Jpeg).unwrap();
        assert_eq!(jpeg[..3], [0xff, 0xd8, 0xff]);
        // Height and width follow the frame marker, its length and the precision.
        let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
        assert_eq!(jpeg[frame + 5..frame + 9], [0, 8, 0, 8]);
    }

    #[test]
    fn pixels_of_another_size_are_refused() {
        for format in [ImageFormat::Png, ImageFormat::Jpeg] {
            assert!(encode(&view(&[0; 4 * 64], 9), format).is_err());
            assert!(encode(&FrameView::NONE, format).is_err());
        }
    }
}
