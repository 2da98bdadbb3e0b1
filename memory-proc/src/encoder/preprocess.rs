//! Converts an image's bytes to an encoder's input tensor.
//!
//! Images are resized bilinearly with antialiasing: a triangle filter as wide as the reduction, as image libraries do
//! when they shrink. Values stay floats between the two passes. The whole image is used; one that is not square is
//! squeezed. Sums have a fixed order, so equal bytes give equal tensors on every machine.

use anyhow::{Result, ensure};

/// Changes whenever the same bytes would give another tensor. Part of the encoder's fingerprint.
pub(super) const VERSION: u32 = 2;

/// RGBA bytes, rows from top to bottom without gaps. Alpha is ignored.
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `4 * width * height` bytes.
    pub rgba: &'a [u8],
}

impl Image<'_> {
    /// Whether the number of bytes fits the size, and is not zero.
    fn is_sound(&self) -> bool {
        let bytes = 4 * u64::from(self.width) * u64::from(self.height);
        bytes > 0 && bytes == self.rgba.len() as u64
    }
}

/// Shrinks or grows images to a square and normalises them.
#[derive(Debug)]
pub(super) struct Preprocessor {
    size: usize,
    /// Normalised value = byte * scale + offset, per channel.
    scale: [f32; 3],
    offset: [f32; 3],
    /// Filters for the last image's size: all frames of a run have the same.
    filters: Option<Filters>,
    /// A row of the result before it is resized to its width.
    row: Vec<f32>,
}

impl Preprocessor {
    /// A preprocessor for a square input of `size` pixels, with channels normalised as `(value / 255 - mean) / std`.
    pub(super) fn new(size: u32, mean: [f32; 3], std: [f32; 3]) -> Self {
        let scale = std.map(|std| 1.0 / (255.0 * std));
        let offset = [0, 1, 2].map(|c| -mean[c] / std[c]);
        Self { size: size as usize, scale, offset, filters: None, row: Vec::new() }
    }

    /// The input tensor of an image: three planes of `size x size`, red, green, blue.
    ///
    /// # Errors
    /// When the image's size and bytes do not match.
    pub(super) fn tensor(&mut self, image: Image<'_>) -> Result<Vec<f32>> {
        let Image { width, height, rgba } = image;
        ensure!(image.is_sound(), "an image of {width} x {height} pixels has {} bytes", rgba.len());
        let size = (image.width, image.height);
        self.filters.take_if(|filters| filters.size != size);
        let filters = self.filters.get_or_insert_with(|| Filters::new(size, self.size));
        let source = image.rgba.chunks_exact(4 * image.width as usize);

        let plane = self.size * self.size;
        let mut tensor = vec![0.0; 3 * plane];
        for y in 0..self.size {
            // Rows first: that reads memory in order, and leaves fewer rows to resize.
            self.row.clear();
            self.row.resize(4 * image.width as usize, 0.0);
            let (first, weights) = filters.rows.taps(y);
            for (source, &weight) in source.clone().skip(first).zip(weights) {
                for (sum, &value) in self.row.iter_mut().zip(source) {
                    *sum += weight * f32::from(value);
                }
            }
            let pixels = self.row.as_chunks::<4>().0;
            for x in 0..self.size {
                let (first, weights) = filters.columns.taps(x);
                let mut rgba = [0.0_f32; 4];
                for (pixel, &weight) in pixels[first..].iter().zip(weights) {
                    for channel in 0..4 {
                        rgba[channel] += weight * pixel[channel];
                    }
                }
                for channel in 0..3 {
                    tensor[channel * plane + y * self.size + x] =
                        rgba[channel] * self.scale[channel] + self.offset[channel];
                }
            }
        }
        Ok(tensor)
    }
}

/// Filters for images of one size.
#[derive(Debug)]
struct Filters {
    size: (u32, u32),
    columns: Filter,
    rows: Filter,
}

impl Filters {
    fn new(size: (u32, u32), side: usize) -> Self {
        let columns = Filter::new(size.0 as usize, side);
        Self { size, columns, rows: Filter::new(size.1 as usize, side) }
    }
}

/// The source positions and weights of every position along an axis of the result.
#[derive(Debug)]
struct Filter {
    /// First source position and range in `weights`, per position.
    taps: Vec<(usize, std::ops::Range<usize>)>,
    weights: Vec<f32>,
}

impl Filter {
    fn new(from: usize, to: usize) -> Self {
        let ratio = from as f64 / to as f64;
        let reach = ratio.max(1.0);
        let (mut taps, mut weights) = (Vec::with_capacity(to), Vec::new());
        for position in 0..to {
            let centre = (position as f64 + 0.5) * ratio;
            let first = (centre - reach).floor().max(0.0) as usize;
            let last = ((centre + reach).ceil() as usize).min(from);
            let triangle =
                |source: usize| (1.0 - (source as f64 + 0.5 - centre).abs() / reach).max(0.0);
            let total: f64 = (first..last).map(triangle).sum();
            let begin = weights.len();
            weights.extend((first..last).map(|source| (triangle(source) / total) as f32));
            taps.push((first, begin..weights.len()));
        }
        Self { taps, weights }
    }

    fn taps(&self, position: usize) -> (usize, &[f32]) {
        let (first, range) = &self.taps[position];
        (*first, &self.weights[range.clone()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(size: u32) -> Preprocessor {
        Preprocessor::new(size, [0.0; 3], [1.0 / 255.0; 3])
    }

    fn image(width: u32, height: u32, pixel: impl Fn(u32, u32) -> [u8; 3]) -> Vec<u8> {
        let at = |i: u32| pixel(i % width, i / width);
        (0..width * height).flat_map(|i| [at(i)[0], at(i)[1], at(i)[2], 255]).collect()
    }

    #[test]
    fn a_plain_colour_stays_what_it_is_at_any_size() {
        for (width, height) in [(1, 1), (7, 3), (224, 224), (448, 448), (640, 64)] {
            let rgba = image(width, height, |_, _| [10, 20, 255]);
            let tensor = plain(16).tensor(Image { width, height, rgba: &rgba }).unwrap();
            for (channel, expected) in [10.0, 20.0, 255.0].into_iter().enumerate() {
                for value in &tensor[channel * 256..][..256] {
                    assert!((value - expected).abs() < 1e-3, "{width}x{height}: {value}");
                }
            }
        }
    }

    #[test]
    fn equal_size_copies_and_halving_weighs_one_three_three_one() {
        let rgba = image(16, 16, |x, y| [x as u8, y as u8, 0]);
        let tensor = plain(16).tensor(Image { width: 16, height: 16, rgba: &rgba }).unwrap();
        assert!((tensor[5] - 5.0).abs() < 1e-5 && (tensor[256 + 3 * 16] - 3.0).abs() < 1e-5);

        let filter = Filter::new(32, 16);
        let (first, weights) = filter.taps(4);
        let expected: &[f32] = &[0.125, 0.375, 0.375, 0.125];
        let offset = weights.iter().position(|&w| w > 0.0).unwrap();
        assert_eq!((first + offset, &weights[offset..offset + 4]), (7, expected));
    }

    #[test]
    fn normalisation_is_per_channel() {
        let rgba = image(8, 8, |_, _| [255, 0, 51]);
        let mut preprocessor = Preprocessor::new(16, [0.5, 0.25, 0.2], [0.5, 0.125, 1.0]);
        let tensor = preprocessor.tensor(Image { width: 8, height: 8, rgba: &rgba }).unwrap();
        for (index, expected) in [(0, 1.0), (256, -2.0), (512, 0.0)] {
            assert!((tensor[index] - expected).abs() < 1e-5, "{}", tensor[index]);
        }
    }

    #[test]
    fn a_tensor_does_not_depend_on_the_previous_image() {
        let (small, large) =
            (image(20, 10, |x, y| [(x * y) as u8; 3]), image(90, 64, |x, y| [(x ^ y) as u8; 3]));
        let large = Image { width: 90, height: 64, rgba: &large };
        let small = Image { width: 20, height: 10, rgba: &small };
        let mut used = plain(16);
        used.tensor(small).unwrap();
        assert_eq!(used.tensor(large).unwrap(), plain(16).tensor(large).unwrap());
        for unsound in [Image { width: 3, ..small }, Image { width: 0, height: 0, rgba: &[] }] {
            assert!(used.tensor(unsound).is_err());
        }
    }
}
