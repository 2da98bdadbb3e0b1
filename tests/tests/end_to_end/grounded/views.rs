//! Rendered views of the world, with plates.

use std::collections::HashMap;
use std::sync::Arc;

use domain::{Appearance, Cell, Pose};
use peer::FrameView;
use sim_proc::renderer::{RenderSettings, Renderer, ViewSpec};
use warehouse::{Variant, Warehouse};

/// Fields along each side of the coarse grid by which views are compared.
const SIDE: usize = 28;

/// A rendered view.
pub(crate) struct Image {
    id: u64,
    width: u32,
    height: u32,
    content_hash: [u8; 16],
    pixels: Vec<u8>,
    /// The sum of each channel over the fields of the coarse grid.
    fields: Vec<f32>,
}

impl Image {
    pub(crate) fn new(id: u64, width: u32, height: u32, pixels: Vec<u8>) -> Self {
        let [across, down] = [width, height].map(|side| side as usize / SIDE);
        let mut fields = vec![0.0; SIDE * SIDE * 3];
        for (y, row) in pixels.chunks_exact(4 * width as usize).enumerate() {
            for (x, part) in row.chunks_exact(4 * across).enumerate() {
                let field = 3 * (y / down * SIDE + x);
                for (sum, more) in fields[field..].iter_mut().zip(sums(part)) {
                    *sum += more as f32;
                }
            }
        }
        let mut content_hash = [0; 16];
        content_hash.copy_from_slice(&blake3::hash(&pixels).as_bytes()[..16]);
        Self { id, width, height, content_hash, pixels, fields }
    }

    pub(crate) fn frame(&self) -> FrameView<'_> {
        FrameView {
            id: self.id,
            content_hash: self.content_hash,
            width: self.width,
            height: self.height,
            pixels: &self.pixels,
        }
    }

    /// How much two images differ: 0 if they are equal.
    pub(crate) fn distance(&self, other: &Self) -> f32 {
        search::distance(&self.fields, &other.fields)
    }
}

/// The sums of red, green and blue of a row of at most 256 pixels. Two channels at a time, and without iterators, because
/// tests are hardly optimised.
fn sums(row: &[u8]) -> [u32; 3] {
    const EVERY_OTHER: u32 = 0x00ff_00ff;
    let (pixels, _) = row.as_chunks::<4>();
    let (mut even, mut odd, mut at) = (0, 0, 0);
    while at < pixels.len() {
        let pixel = u32::from_le_bytes(pixels[at]);
        even += pixel & EVERY_OTHER;
        odd += (pixel >> 8) & EVERY_OTHER;
        at += 1;
    }
    [even & 0xffff, odd & 0xffff, even >> 16]
}

/// A cache of rendered views.
pub(crate) struct Views {
    renderer: Renderer,
    rendered: HashMap<Pose, Arc<Image>>,
    /// The closed cells of `rendered_closed`.
    closed: Vec<Cell>,
    rendered_closed: HashMap<Pose, Arc<Image>>,
    last_id: u64,
}

impl Views {
    pub(crate) fn new(warehouse: &Warehouse) -> Self {
        let settings =
            RenderSettings { appearance: Appearance::WITH_PLATES, ..RenderSettings::default() };
        let renderer = Renderer::new(warehouse, settings).unwrap();
        let (rendered, rendered_closed) = Default::default();
        Self { renderer, rendered, closed: Vec::new(), rendered_closed, last_id: 0 }
    }

    pub(crate) fn of(&mut self, pose: Pose, variant: &Variant) -> Arc<Image> {
        // Views are large: besides the unchanged world's, only those of one other variant are kept.
        if !variant.closed().is_empty() && self.closed != variant.closed() {
            self.rendered_closed.clear();
            self.closed = variant.closed().to_vec();
        }
        let is_changed = !variant.closed().is_empty();
        let rendered = if is_changed { &mut self.rendered_closed } else { &mut self.rendered };
        let render = || {
            let image = self.renderer.render_image(ViewSpec { pose, variant, stock: 0 }).unwrap();
            let (width, height) = (image.width(), image.height());
            self.last_id += 1;
            Arc::new(Image::new(self.last_id, width, height, image.as_bytes().to_vec()))
        };
        Arc::clone(rendered.entry(pose).or_insert_with(render))
    }
}
