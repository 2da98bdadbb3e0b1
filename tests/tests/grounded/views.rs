//! Views of the world, each rendered once as long as it is kept.

use std::collections::HashMap;
use std::sync::Arc;

use domain::{Cell, Heading, Pose};
use policy_proc::FrameView;
use sim_proc::renderer::{RenderSettings, Renderer, View};
use warehouse::{Variant, Warehouse};

/// Fields across and down of the small picture that views are compared by.
const SIDE: usize = 28;

/// One view.
pub(crate) struct Picture {
    id: u64,
    width: u32,
    height: u32,
    pixels: Vec<u8>,
    /// Sum of each channel over the fields of a coarse grid.
    fields: Vec<u32>,
}

impl Picture {
    pub(crate) fn new(id: u64, width: u32, height: u32, pixels: Vec<u8>) -> Self {
        let mut fields = vec![0; SIDE * SIDE * 3];
        for (i, pixel) in pixels.chunks_exact(4).enumerate() {
            let (x, y) = (i % width as usize, i / width as usize);
            let field = y * SIDE / height as usize * SIDE + x * SIDE / width as usize;
            for channel in 0..3 {
                fields[3 * field + channel] += u32::from(pixel[channel]);
            }
        }
        Self { id, width, height, pixels, fields }
    }

    pub(crate) fn frame(&self) -> FrameView<'_> {
        FrameView {
            id: self.id,
            content_hash: u128::from(self.id).to_le_bytes(),
            width: self.width,
            height: self.height,
            pixels: &self.pixels,
        }
    }

    /// How much two pictures differ: 0 for equal ones.
    pub(crate) fn distance(&self, other: &Self) -> u64 {
        let fields = self.fields.iter().zip(&other.fields);
        fields.map(|(&a, &b)| u64::from(a.abs_diff(b))).sum()
    }
}

/// The views that were asked for so far.
pub(crate) struct Views {
    renderer: Renderer,
    rendered: HashMap<Pose, Arc<Picture>>,
    /// With barricades on these cells.
    closed: Vec<Cell>,
    rendered_closed: HashMap<Pose, Arc<Picture>>,
    last_id: u64,
}

impl Views {
    pub(crate) fn new(warehouse: &Warehouse) -> Self {
        let renderer = Renderer::new(warehouse, RenderSettings::default()).unwrap();
        let (rendered, rendered_closed) = Default::default();
        Self { renderer, rendered, closed: Vec::new(), rendered_closed, last_id: 0 }
    }

    pub(crate) fn of(&mut self, pose: Pose, variant: &Variant) -> Arc<Picture> {
        // Views of one world at a time are kept beside those of the unchanged one: they are large.
        if !variant.closed().is_empty() && self.closed != variant.closed() {
            self.rendered_closed.clear();
            self.closed = variant.closed().to_vec();
        }
        let is_changed = !variant.closed().is_empty();
        let rendered = if is_changed { &mut self.rendered_closed } else { &mut self.rendered };
        let render = || {
            let image = self.renderer.render_image(View { pose, variant }).unwrap();
            let (width, height) = image.dimensions();
            self.last_id += 1;
            Arc::new(Picture::new(self.last_id, width, height, image.into_raw()))
        };
        Arc::clone(rendered.entry(pose).or_insert_with(render))
    }
}

/// Every pose there is, in a fixed order.
pub(crate) fn poses(warehouse: &Warehouse) -> Vec<Pose> {
    let cells = warehouse.layout.free_cells();
    cells.flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading })).collect()
}
