//! Reads and writes PNG images with 8 bits per channel. Knows no other format and nothing about colour profiles.

use std::fmt;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

/// Pixels that are not a PNG image, or bytes that cannot be decoded as one.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// The encoder failed.
    #[error("cannot encode a PNG image: {0}")]
    Encode(#[from] png::EncodingError),
    /// The bytes are no valid PNG image.
    #[error("not a readable PNG image: {0}")]
    Decode(#[from] png::DecodingError),
    /// The image has more than [`MAX_PIXELS`].
    #[error("the PNG image is too large to decode")]
    TooLarge,
    /// The number of bytes does not match the size.
    #[error("{bytes} bytes are not {width} x {height} pixels of {channels} channels")]
    Size {
        /// Bytes given.
        bytes: usize,
        /// Width given, in pixels.
        width: u32,
        /// Height given, in pixels.
        height: u32,
        /// Bytes per pixel.
        channels: usize,
    },
}

/// A PNG file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct PngFileError {
    /// The file.
    pub path: PathBuf,
    /// What went wrong.
    pub problem: PngProblem,
}

/// Why a PNG file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum PngProblem {
    /// The file cannot be read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Its content is no usable image.
    #[error(transparent)]
    Png(#[from] PngError),
}

/// Most pixels of an image that is decoded: a header of a few bytes can claim any number.
pub const MAX_PIXELS: u64 = 1 << 26;

/// How the bytes of a pixel are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue, alpha.
    Rgba,
}

impl Channels {
    /// Bytes per pixel.
    pub const fn count(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Rgba => 4,
        }
    }
}

/// Encodes `pixels`, row by row from the top left corner, with fast compression and adaptive filters.
///
/// # Errors
/// When `pixels` does not hold `width` x `height` pixels, or there are none.
pub fn encode(
    width: u32,
    height: u32,
    channels: Channels,
    pixels: &[u8],
) -> Result<Vec<u8>, PngError> {
    if pixels.len() as u64 != u64::from(width) * u64::from(height) * channels.count() as u64 {
        let (bytes, channels) = (pixels.len(), channels.count());
        return Err(PngError::Size { bytes, width, height, channels });
    }
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(match channels {
        Channels::Rgb => png::ColorType::Rgb,
        Channels::Rgba => png::ColorType::Rgba,
    });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(file)
}

/// An image in memory: red, green, blue and alpha, row by row from the top left corner.
#[derive(Clone, PartialEq, Eq)]
pub struct RgbaImage {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl RgbaImage {
    /// An image of one colour.
    pub fn filled(width: u32, height: u32, rgba: [u8; 4]) -> Self {
        Self { width, height, pixels: rgba.repeat(width as usize * height as usize) }
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The bytes of all pixels.
    pub fn as_bytes(&self) -> &[u8] {
        &self.pixels
    }

    /// The bytes of all pixels, to be changed in place.
    pub fn as_bytes_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// The pixels in order.
    pub fn pixels(&self) -> impl ExactSizeIterator<Item = [u8; 4]> + '_ {
        self.pixels.as_chunks().0.iter().copied()
    }

    /// The pixel in column `x` of row `y`.
    ///
    /// # Panics
    /// When the image has no such pixel.
    pub fn pixel_mut(&mut self, x: u32, y: u32) -> &mut [u8; 4] {
        assert!(x < self.width, "column {x} of {}", self.width);
        &mut self.pixels.as_chunks_mut().0[y as usize * self.width as usize + x as usize]
    }

    /// The `width` x `height` pixels from column `x` and row `y` on.
    ///
    /// # Panics
    /// When they are not all inside the image.
    pub fn crop(&self, x: u32, y: u32, width: u32, height: u32) -> Self {
        let mut cut = Self::filled(width, height, [0; 4]);
        for row in 0..height {
            cut.row_mut(0, row, width).copy_from_slice(self.row(x, y + row, width));
        }
        cut
    }

    fn row(&self, x: u32, y: u32, width: u32) -> &[u8] {
        &self.pixels[self.row_range(x, y, width)]
    }

    fn row_mut(&mut self, x: u32, y: u32, width: u32) -> &mut [u8] {
        let range = self.row_range(x, y, width);
        &mut self.pixels[range]
    }

    fn row_range(&self, x: u32, y: u32, width: u32) -> std::ops::Range<usize> {
        assert!(x + width <= self.width, "columns {x} to {} of {}", x + width, self.width);
        let first = 4 * (y as usize * self.width as usize + x as usize);
        first..first + 4 * width as usize
    }

    /// Decodes a PNG image of any colour type and bit depth.
    ///
    /// # Errors
    /// When `bytes` is no valid PNG image.
    pub fn decode(bytes: &[u8]) -> Result<Self, PngError> {
        let mut decoder = png::Decoder::new(Cursor::new(bytes));
        decoder.set_transformations(
            png::Transformations::normalize_to_color8() | png::Transformations::ALPHA,
        );
        let mut reader = decoder.read_info()?;
        let (width, height) = reader.info().size();
        if u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(PngError::TooLarge);
        }
        let mut pixels = vec![0; reader.output_buffer_size().ok_or(PngError::TooLarge)?];
        let frame = reader.next_frame(&mut pixels)?;
        pixels.truncate(frame.buffer_size());
        if frame.color_type == png::ColorType::GrayscaleAlpha {
            let grey_alpha = pixels.as_chunks().0.iter();
            pixels = grey_alpha.flat_map(|&[grey, alpha]| [grey, grey, grey, alpha]).collect();
        }
        Ok(Self { width: frame.width, height: frame.height, pixels })
    }

    /// Reads a PNG file.
    ///
    /// # Errors
    /// When the file cannot be read or is no valid PNG image.
    pub fn read(path: &Path) -> Result<Self, PngFileError> {
        durable::input::read(path)
            .map_err(PngProblem::from)
            .and_then(|bytes| Ok(Self::decode(&bytes)?))
            .map_err(|problem| PngFileError { path: path.to_owned(), problem })
    }

    /// Writes a PNG file.
    ///
    /// # Errors
    /// When the file cannot be written or the image has no pixels.
    pub fn write(&self, path: &Path) -> Result<(), PngFileError> {
        encode(self.width, self.height, Channels::Rgba, &self.pixels)
            .map_err(PngProblem::from)
            .and_then(|bytes| Ok(durable::output::write(path, bytes)?))
            .map_err(|problem| PngFileError { path: path.to_owned(), problem })
    }
}

impl fmt::Debug for RgbaImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RgbaImage({} x {})", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> RgbaImage {
        let mut image = RgbaImage::filled(5, 3, [0, 0, 0, 255]);
        for (i, byte) in (0..).zip(image.as_bytes_mut()) {
            *byte = 4 * i;
        }
        image
    }

    #[test]
    fn a_written_file_reads_back_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.png");
        gradient().write(&path).unwrap();
        assert_eq!(RgbaImage::read(&path).unwrap(), gradient());
    }

    #[test]
    fn rgb_and_grey_images_are_decoded_as_rgba() {
        let rgb = encode(1, 2, Channels::Rgb, &[1, 2, 3, 4, 5, 6]).unwrap();
        let decoded = RgbaImage::decode(&rgb).unwrap();
        assert_eq!(decoded.as_bytes(), [1, 2, 3, 255, 4, 5, 6, 255]);
        let mut grey = Vec::new();
        let mut encoder = png::Encoder::new(&mut grey, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.write_header().unwrap().write_image_data(&[7, 0, 9, 0]).unwrap();
        let decoded = RgbaImage::decode(&grey).unwrap();
        assert_eq!(decoded.as_bytes(), [7, 7, 7, 255, 9, 9, 9, 255]);
    }

    #[test]
    fn pixels_are_cut_out_where_they_are() {
        let image = gradient();
        let mut cut = image.crop(2, 1, 3, 2);
        assert_eq!((cut.width(), cut.height()), (3, 2));
        assert_eq!(*cut.pixel_mut(0, 0), [112, 116, 120, 124]);
        assert_eq!(cut.pixels().nth(5), image.pixels().last());
    }

    #[test]
    fn bytes_that_are_not_an_image_are_refused() {
        let short = encode(2, 2, Channels::Rgba, &[0; 15]).unwrap_err().to_string();
        assert_eq!(short, "15 bytes are not 2 x 2 pixels of 4 channels");
        assert!(encode(0, 0, Channels::Rgb, &[]).is_err());
        assert!(RgbaImage::read(Path::new("/dev/zero")).is_err());
        let error = RgbaImage::decode(b"GIF89a").unwrap_err().to_string();
        assert!(error.starts_with("not a readable PNG image: "), "{error}");
        let mut huge = Vec::new();
        let mut writer = png::Encoder::new(&mut huge, 1 << 24, 1 << 24).write_header().unwrap();
        writer.write_chunk(png::chunk::IDAT, &[]).unwrap();
        drop(writer);
        let error = RgbaImage::decode(&huge).unwrap_err().to_string();
        assert_eq!(error, "the PNG image is too large to decode");
        let missing = RgbaImage::read(Path::new("/nowhere.png")).unwrap_err().to_string();
        assert!(missing.starts_with("/nowhere.png: "), "{missing}");
    }
}
