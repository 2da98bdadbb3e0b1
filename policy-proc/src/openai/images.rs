//! Views as data URLs, each encoded once.
//!
//! URLs are cached by the content of the view, so any lane, step and repetition can use them, in two generations: when
//! the younger one is full it becomes the older one, whose URLs are dropped unless they were used meanwhile. A dropped
//! view is encoded again, to the same bytes.
//!
//! A view of 448 x 448 pixels takes milliseconds, so the new views of a batch are encoded on all cores while the serve
//! loop waits: their pixels are only borrowed.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use domain::ImageFormat;
use peer::FrameView;
use prompt::image::data_url;

/// Maximum number of bytes of URLs in one generation; two hold some thousands of views.
const GENERATION_BYTES: usize = 128 << 20;

/// The hash of a view's pixels.
type PixelHash = [u8; 16];

type Urls = HashMap<PixelHash, Arc<str>>;

/// The encoded views.
#[derive(Debug)]
pub(super) struct EncodedViews {
    format: ImageFormat,
    generation_bytes: usize,
    younger: Urls,
    older: Urls,
    /// Bytes of the URLs in `younger`.
    bytes: usize,
}

impl EncodedViews {
    pub(super) fn new(format: ImageFormat) -> Self {
        let (younger, older) = (Urls::new(), Urls::new());
        Self { format, generation_bytes: GENERATION_BYTES, younger, older, bytes: 0 }
    }

    /// The URLs of `views`, by content. Views that cannot be encoded are left out.
    pub(super) fn urls<'a, 'v: 'a>(
        &mut self,
        views: impl Iterator<Item = &'a FrameView<'v>>,
    ) -> Urls {
        let by_content: HashMap<_, _> = views.map(|view| (view.content_hash, *view)).collect();
        let mut urls = Urls::new();
        let mut new = Vec::new();
        for (hash, view) in by_content {
            match self.younger.get(&hash).or_else(|| self.older.get(&hash)) {
                Some(url) => drop(urls.insert(hash, Arc::clone(url))),
                None => new.push(view),
            }
        }
        urls.extend(self.encode(&new));
        for (hash, url) in &urls {
            self.keep(*hash, url);
        }
        urls
    }

    fn keep(&mut self, hash: PixelHash, url: &Arc<str>) {
        if self.bytes > self.generation_bytes {
            self.older = std::mem::take(&mut self.younger);
            self.bytes = 0;
        }
        if self.younger.insert(hash, Arc::clone(url)).is_none() {
            self.bytes += url.len();
        }
    }

    /// Encodes `views` on as many cores as there are.
    fn encode(&self, views: &[FrameView<'_>]) -> Urls {
        let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let next = AtomicUsize::new(0);
        let work = || {
            let mut done = Urls::new();
            while let Some(view) = views.get(next.fetch_add(1, Ordering::Relaxed)) {
                match data_url(view, self.format) {
                    Ok(url) => drop(done.insert(view.content_hash, url.into())),
                    Err(error) => tracing::warn!("{view:?} cannot be encoded: {error}"),
                }
            }
            done
        };
        thread::scope(|scope| {
            let threads: Vec<_> = (1..cores.min(views.len()))
                .filter_map(|_| thread::Builder::new().spawn_scoped(scope, work).ok())
                .collect();
            let mut done = work();
            // A view whose thread panicked has no URL, and its request reports that.
            done.extend(threads.into_iter().filter_map(|thread| thread.join().ok()).flatten());
            done
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(grey: u8, pixels: &[u8]) -> FrameView<'_> {
        FrameView { id: 1, content_hash: [grey; 16], width: 8, height: 8, pixels }
    }

    #[test]
    fn views_in_use_are_encoded_once_and_others_are_dropped() {
        let pixels: Vec<_> = (0..6_u8).map(|grey| vec![grey; 4 * 8 * 8]).collect();
        let views: Vec<_> = (0..6).map(|grey| view(grey, &pixels[usize::from(grey)])).collect();
        let mut encoded = EncodedViews::new(ImageFormat::Png);
        encoded.generation_bytes = 0;
        let first = encoded.urls([views[0], views[0]].iter()).remove(&[0; 16]).unwrap();
        for view in &views[1..] {
            let urls = encoded.urls([*view, views[0]].iter());
            assert!(Arc::ptr_eq(&first, &urls[&[0; 16]]), "it is in use");
            assert_eq!(urls.len(), 2);
        }
        assert!(encoded.younger.len() + encoded.older.len() <= 3);
    }

    #[test]
    fn a_view_without_pixels_has_no_url() {
        let mut encoded = EncodedViews::new(ImageFormat::Jpeg);
        assert!(encoded.urls([FrameView::NONE].iter()).is_empty());
    }
}
