//! Views as data URLs, each encoded once.
//!
//! A view is named by its content, so what is kept may be used by any lane, step and repetition. The kept URLs
//! are bounded by their bytes; the one that was not asked for the longest goes first. A view that comes back
//! after that is encoded anew, to the same bytes.
//!
//! Encoding a view of 448 x 448 takes some milliseconds, so the views of a batch that are new are encoded side by
//! side on all cores while the serve loop waits: their pixels are only lent.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::FrameView;

/// Quality of JPEG images, out of 100: labels stay readable.
pub const JPEG_QUALITY: u8 = 90;

/// Most bytes of URLs that are kept: some thousands of views.
const MOST_BYTES: usize = 256 << 20;

/// How images are encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// Without loss.
    Png,
    /// With loss, at [`JPEG_QUALITY`]; smaller.
    Jpeg,
}

/// A word that names no image format.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0} is no image format: say png or jpeg")]
pub struct UnknownFormat(String);

impl FromStr for ImageFormat {
    type Err = UnknownFormat;

    fn from_str(word: &str) -> Result<Self, UnknownFormat> {
        match word {
            "png" => Ok(Self::Png),
            "jpeg" => Ok(Self::Jpeg),
            other => Err(UnknownFormat(other.to_owned())),
        }
    }
}

impl fmt::Display for ImageFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Png => "png",
            Self::Jpeg => "jpeg",
        })
    }
}

impl ImageFormat {
    /// The format, with its quality where that is a choice: for the manifest.
    pub(super) fn described(self) -> String {
        match self {
            Self::Png => self.to_string(),
            Self::Jpeg => format!("{self} {JPEG_QUALITY}"),
        }
    }
}

/// A view's content.
type Hash = [u8; 16];

#[derive(Debug)]
struct Kept {
    url: Arc<str>,
    /// When it was asked for last, as [`Images::clock`] tells.
    used: u64,
}

/// The encoded views.
#[derive(Debug)]
pub(super) struct Images {
    format: ImageFormat,
    most_bytes: usize,
    kept: HashMap<Hash, Kept>,
    /// Content by when it was asked for.
    by_use: BTreeMap<u64, Hash>,
    clock: u64,
    bytes: usize,
}

impl Images {
    pub(super) fn new(format: ImageFormat) -> Self {
        Self::with_room(format, MOST_BYTES)
    }

    fn with_room(format: ImageFormat, most_bytes: usize) -> Self {
        let (kept, by_use) = (HashMap::new(), BTreeMap::new());
        Self { format, most_bytes, kept, by_use, clock: 0, bytes: 0 }
    }

    /// The URLs of `views`, by content. One whose pixels are no picture has none.
    pub(super) fn urls<'a, 'v: 'a>(
        &mut self,
        views: impl Iterator<Item = &'a FrameView<'v>>,
    ) -> HashMap<Hash, Arc<str>> {
        let mut urls = HashMap::new();
        let (mut new, mut seen) = (Vec::new(), HashSet::new());
        for view in views {
            if !seen.insert(view.content_hash) {
                continue;
            }
            match self.known(view.content_hash) {
                Some(url) => {
                    urls.insert(view.content_hash, url);
                }
                None => new.push(*view),
            }
        }
        for (hash, url) in self.encode_all(&new) {
            self.keep(hash, Arc::clone(&url));
            urls.insert(hash, url);
        }
        urls
    }

    fn known(&mut self, hash: Hash) -> Option<Arc<str>> {
        let kept = self.kept.get_mut(&hash)?;
        self.clock += 1;
        self.by_use.remove(&kept.used);
        self.by_use.insert(self.clock, hash);
        kept.used = self.clock;
        Some(Arc::clone(&kept.url))
    }

    fn keep(&mut self, hash: Hash, url: Arc<str>) {
        self.clock += 1;
        self.bytes += url.len();
        self.by_use.insert(self.clock, hash);
        self.kept.insert(hash, Kept { url, used: self.clock });
        while self.bytes > self.most_bytes
            && let Some((_, oldest)) = self.by_use.pop_first()
            && let Some(gone) = self.kept.remove(&oldest)
        {
            self.bytes -= gone.url.len();
        }
    }

    /// Encodes `views`, on as many cores as there are.
    fn encode_all(&self, views: &[FrameView<'_>]) -> Vec<(Hash, Arc<str>)> {
        let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let next = AtomicUsize::new(0);
        let work = || {
            let mut done = Vec::new();
            while let Some(view) = views.get(next.fetch_add(1, Ordering::Relaxed)) {
                match data_url(view, self.format) {
                    Ok(url) => done.push((view.content_hash, url.into())),
                    Err(error) => tracing::warn!("{view:?} is no picture: {error}"),
                }
            }
            done
        };
        thread::scope(|scope| {
            let helpers: Vec<_> = (1..cores.min(views.len()))
                .filter_map(|_| thread::Builder::new().spawn_scoped(scope, work).ok())
                .collect();
            let mut done = work();
            // A view whose helper died has no URL, and its request says so.
            done.extend(helpers.into_iter().filter_map(|helper| helper.join().ok()).flatten());
            done
        })
    }
}

/// A view as `data:image/...;base64,...`, its transparency, of which it has none, left out.
fn data_url(view: &FrameView<'_>, format: ImageFormat) -> Result<String, ImageError> {
    let &FrameView { width, height, pixels, .. } = view;
    let rgb: Vec<u8> = pixels.chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect();
    if rgb.is_empty() || rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
        let problem = format!("{} bytes are not {width} x {height} pixels", pixels.len());
        return Err(ImageError::IoError(std::io::Error::other(problem)));
    }
    let mut bytes = Vec::new();
    match format {
        ImageFormat::Png => {
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
                .write_image(&rgb, width, height, ExtendedColorType::Rgb8)?;
        }
        ImageFormat::Jpeg => JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).write_image(
            &rgb,
            width,
            height,
            ExtendedColorType::Rgb8,
        )?,
    }
    let mut url = format!("data:image/{format};base64,");
    STANDARD.encode_string(&bytes, &mut url);
    Ok(url)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 4 * 8 * 8;

    fn view(grey: u8, pixels: &[u8]) -> FrameView<'_> {
        FrameView { id: 1, content_hash: [grey; 16], width: 8, height: 8, pixels }
    }

    fn decoded(url: &str) -> image::RgbaImage {
        let (head, data) = url.split_once(',').unwrap();
        assert!(head.ends_with(";base64"), "{head}");
        image::load_from_memory(&STANDARD.decode(data).unwrap()).unwrap().to_rgba8()
    }

    #[test]
    fn a_view_is_encoded_once_and_shows_its_pixels() {
        let pixels: Vec<u8> = (0..64u8).flat_map(|i| [4 * i, 255 - i, i, 255]).collect();
        for (format, head, tolerance) in
            [(ImageFormat::Png, "data:image/png;", 0), (ImageFormat::Jpeg, "data:image/jpeg;", 60)]
        {
            let mut images = Images::new(format);
            let shown = view(7, &pixels);
            let first = images.urls([shown, shown].iter()).remove(&[7; 16]).unwrap();
            assert!(first.starts_with(head), "{first}");
            let again = images.urls([shown].iter()).remove(&[7; 16]).unwrap();
            assert!(Arc::ptr_eq(&first, &again));
            let picture = decoded(&first);
            assert_eq!(picture.dimensions(), (8, 8));
            let differences = picture.as_raw().iter().zip(&pixels).map(|(a, b)| a.abs_diff(*b));
            assert!(differences.max() <= Some(tolerance));
        }
    }

    #[test]
    fn what_was_not_asked_for_the_longest_goes_first() {
        let pictures: Vec<_> = (0..4u8).map(|grey| vec![grey; PIXELS]).collect();
        let views: Vec<_> = (0..4).map(|grey| view(grey, &pictures[usize::from(grey)])).collect();
        let mut images = Images::new(ImageFormat::Png);
        let size = images.urls(views[..1].iter())[&[0; 16]].len();
        // Room for three, which are all alike in size to a few bytes.
        let mut images = Images::with_room(ImageFormat::Png, 3 * size + size / 2);
        images.urls(views[..3].iter());
        images.urls(views[..1].iter());
        // All of a batch are there, whatever is kept of them.
        assert_eq!(images.urls(views[2..].iter()).len(), 2);
        let kept = |images: &Images, grey: u8| images.kept.contains_key(&[grey; 16]);
        assert_eq!([0, 1, 2, 3].map(|grey| kept(&images, grey)), [true, false, true, true]);
        assert!(images.bytes <= images.most_bytes);
        assert_eq!(images.by_use.len(), images.kept.len());
    }

    #[test]
    fn what_is_no_picture_has_no_url() {
        let pixels = vec![0; PIXELS];
        let short = FrameView { height: 9, ..view(1, &pixels) };
        let mut images = Images::new(ImageFormat::Jpeg);
        assert!(images.urls([short, FrameView::NONE].iter()).is_empty());
        assert!(images.kept.is_empty());
    }
}
