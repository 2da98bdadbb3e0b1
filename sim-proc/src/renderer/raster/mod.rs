//! The hand that needs no graphics card: the same pictures, put into pixels by this processor.
//!
//! A software driver of Vulkan runs programs that it has translated from shaders, and takes every triangle through
//! all stages of a graphics card. This scene needs three fixed ways of colouring, so here they are compiled into the
//! loops that fill blocks of sixteen pixels, one vector register each. `corner` places the corners of triangles,
//! `triangle` finds the samples that they cover, `shade` colours them, `canvas` is what is drawn on.
//!
//! What a view's bytes are depends on its pose and variant alone: vectors of every width that processors have do the
//! same arithmetic, and nothing is contracted or approximated.

mod canvas;
mod corner;
mod shade;
mod triangle;

#[cfg(test)]
mod tests;

use fearless_simd::{Level, Simd, dispatch};

use super::scene::Scene;
use super::vertex::Placement;
use super::{Picture, RenderSettings, Samples};
use canvas::Canvas;
use corner::{Corners, Grid, Look};
use shade::{Lettering, Lit, Plate, Text};

/// Draws pictures of one scene on one thread of the processor.
pub(super) struct Raster {
    level: Level,
    layers: Layers,
    canvas: AnyCanvas,
}

enum AnyCanvas {
    One(Canvas<1>),
    Four(Canvas<4>),
}

/// What the scene is made of.
struct Layers {
    grid: Grid,
    solid: Corners,
    plate: Corners,
    text: Corners,
    lettering: Lettering,
}

impl Raster {
    /// For pictures of `scene`.
    pub(super) fn new(scene: &Scene, settings: &RenderSettings) -> Self {
        let (width_px, height_px) = (settings.width_px, settings.height_px);
        let solid = scene.solid.vertices.iter().map(|vertex| {
            let [r, g, b, fog] = vertex.colour.map(f32::from);
            (vertex.position, fog / 255.0, [r, g, b])
        });
        let plate = scene.plate.vertices.iter().map(|vertex| {
            let [x, y] = vertex.across;
            (vertex.position, 0.0, [x, y, 0.0])
        });
        let text = scene.text.vertices.iter().map(|vertex| {
            let [x, y] = vertex.atlas;
            (vertex.position, 0.0, [x, y, 0.0])
        });
        let layers = Layers {
            grid: Grid::new(width_px, height_px),
            solid: Corners::new(solid),
            plate: Corners::new(plate),
            text: Corners::new(text),
            lettering: Lettering::new(&scene.atlas),
        };
        let canvas = match settings.samples {
            Samples::One => AnyCanvas::One(Canvas::new(width_px, height_px)),
            Samples::Four => AnyCanvas::Four(Canvas::new(width_px, height_px)),
        };
        Self { level: Level::new(), layers, canvas }
    }

    /// Draws a picture into `pixels`, which has the size of a frame; `background` is RGBA, red lowest.
    pub(super) fn draw(
        &mut self,
        scene: &Scene,
        picture: &Picture,
        background: u32,
        pixels: &mut [u8],
    ) {
        let Self { level, layers, canvas } = self;
        match canvas {
            AnyCanvas::One(canvas) => {
                canvas.clear(background);
                dispatch!(*level, simd => layers.draw(simd, scene, picture, canvas, pixels));
            }
            AnyCanvas::Four(canvas) => {
                canvas.clear(background);
                dispatch!(*level, simd => layers.draw(simd, scene, picture, canvas, pixels));
            }
        }
    }
}

impl Layers {
    #[inline(always)]
    fn draw<V: Simd, const M: usize>(
        &mut self,
        simd: V,
        scene: &Scene,
        picture: &Picture,
        canvas: &mut Canvas<M>,
        pixels: &mut [u8],
    ) {
        let Self { grid, solid, plate, text, lettering } = self;
        let look = Look::new(grid, &picture.camera);
        plate.look_again();
        text.look_again();
        // As on a graphics card: what hangs in front comes first, so that little is drawn over.
        for indices in picture.list.plate.chunks_exact(3) {
            let shader = Plate { code: scene.plate.vertices[indices[0] as usize].code };
            let corners = plate.triangle(simd, &look, indices);
            triangle::draw(simd, canvas, grid, &corners, &shader);
        }
        for indices in picture.list.text.chunks_exact(3) {
            let vertex = &scene.text.vertices[indices[0] as usize];
            let shader = Text { lettering, ink: vertex.ink, paper: vertex.paper };
            let corners = text.triangle(simd, &look, indices);
            triangle::draw(simd, canvas, grid, &corners, &shader);
        }
        let sides = picture.barricades.iter().map(|&side| {
            let barricade = &scene.solid.indices[scene.barricade.clone()];
            (barricade, side)
        });
        for (indices, placement) in
            std::iter::once((&picture.list.solid[..], Placement::IDENTITY)).chain(sides)
        {
            let look = look.at(placement);
            solid.look_again();
            for indices in indices.chunks_exact(3) {
                let corners = solid.triangle(simd, &look, indices);
                triangle::draw(simd, canvas, grid, &corners, &Lit);
            }
        }
        canvas.resolve(simd, pixels);
    }
}
