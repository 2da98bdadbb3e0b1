//! The renderer's CPU backend: draws triangles into RGBA images with vector instructions. Knows no scene, no poses and
//! no shared memory.
//!
//! The scene needs three fixed ways of colouring (lit, label plate, text), so they are compiled into the loops that fill
//! blocks of 4 x 4 pixels, one vector register per value. `geometry` holds the data that the GPU backend draws too,
//! `corner` transforms vertices, `triangle` finds the samples that a triangle covers, `shade` colours them, `canvas`
//! holds colour and depth.
//!
//! An image depends on its view alone: every vector width does the same arithmetic, and nothing is contracted or
//! approximated.

mod canvas;
mod corner;
mod geometry;
mod shade;
mod triangle;

pub use fearless_simd::Level;
use fearless_simd::Simd;

use canvas::SampledImage;
use corner::{Corners, Grid, Transform};
pub use geometry::{
    Atlas, DrawList, FOG_PER_M, FOG_RGB, Geometry, NEAR_M, Placement, PlateVertex, PreparedView,
    SolidVertex, TextVertex, TriangleLayer,
};
use shade::{Lettering, LitShader, PlateShader, TextShader};

/// Samples per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Samples {
    /// No anti-aliasing.
    One,
    /// Four, resolved into one.
    Four,
}

impl Samples {
    /// The number of samples.
    pub const fn count(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Four => 4,
        }
    }
}

/// Draws views of one scene on the calling thread.
pub struct Rasterizer {
    level: Level,
    layers: Layers,
    canvas: AnyCanvas,
}

enum AnyCanvas {
    One(SampledImage<1>),
    Four(SampledImage<4>),
}

/// The scene's vertices in the order that vector instructions read them.
struct Layers {
    grid: Grid,
    solid: Corners,
    plate: Corners,
    text: Corners,
    lettering: Lettering,
}

impl Rasterizer {
    /// Copies what it needs of `geometry`, for images of `width_px` x `height_px`.
    pub fn new(geometry: &Geometry, width_px: u32, height_px: u32, samples: Samples) -> Self {
        let solid = geometry.solid.vertices.iter().map(|vertex| {
            let [r, g, b, fog] = vertex.colour.map(f32::from);
            (vertex.position, fog / 255.0, [r, g, b])
        });
        let plate = geometry.plate.vertices.iter().map(|vertex| {
            let [x, y] = vertex.across;
            (vertex.position, 0.0, [x, y, 0.0])
        });
        let text = geometry.text.vertices.iter().map(|vertex| {
            let [x, y] = vertex.atlas;
            (vertex.position, 0.0, [x, y, 0.0])
        });
        let layers = Layers {
            grid: Grid::new(width_px, height_px),
            solid: Corners::new(solid),
            plate: Corners::new(plate),
            text: Corners::new(text),
            lettering: Lettering::new(&geometry.atlas),
        };
        let canvas = match samples {
            Samples::One => AnyCanvas::One(SampledImage::new(width_px, height_px)),
            Samples::Four => AnyCanvas::Four(SampledImage::new(width_px, height_px)),
        };
        Self { level: Level::new(), layers, canvas }
    }

    /// Uses the vector instructions of `level` instead of the widest that the processor has.
    #[must_use]
    pub fn with_level(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// Draws a view of `geometry` into `pixels`, RGBA in rows from the top; `background` is RGBA with red in the lowest
    /// byte.
    pub fn draw(
        &mut self,
        geometry: &Geometry,
        view: &PreparedView,
        background: u32,
        pixels: &mut [u8],
    ) {
        let Self { level, layers, canvas } = self;
        match canvas {
            AnyCanvas::One(canvas) => {
                canvas.clear(background);
                layers.draw_at(*level, geometry, view, canvas, pixels);
            }
            AnyCanvas::Four(canvas) => {
                canvas.clear(background);
                layers.draw_at(*level, geometry, view, canvas, pixels);
            }
        }
    }
}

impl Layers {
    /// Draws with AVX-512, AVX2 or SSE2. Each level is a compiled copy of everything below, so SSE4.2, which only
    /// processors from before 2013 stop at, has none.
    #[cfg(target_arch = "x86_64")]
    fn draw_at<const M: usize>(
        &mut self,
        level: Level,
        geometry: &Geometry,
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        if let Some(simd) = level.as_avx512() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, geometry, view, canvas, pixels),
            );
        } else if let Some(simd) = level.as_avx2() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, geometry, view, canvas, pixels),
            );
        } else if let Some(simd) = level.as_sse2() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, geometry, view, canvas, pixels),
            );
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn draw_at<const M: usize>(
        &mut self,
        level: Level,
        geometry: &Geometry,
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        fearless_simd::dispatch!(level, simd => self.draw(simd, geometry, view, canvas, pixels));
    }

    #[inline(always)]
    fn draw<V: Simd, const M: usize>(
        &mut self,
        simd: V,
        geometry: &Geometry,
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        let Self { grid, solid, plate, text, lettering } = self;
        let transform = Transform::new(grid, view.clip_from_world);
        plate.forget();
        text.forget();
        // In the order of the GPU backend: what hangs in front comes first, so that little is drawn over.
        for indices in view.list.plate.chunks_exact(3) {
            let shader = PlateShader { code: geometry.plate.vertices[indices[0] as usize].code };
            let corners = plate.triangle(simd, &transform, indices);
            triangle::draw(simd, canvas, grid, corners, &shader);
        }
        for indices in view.list.text.chunks_exact(3) {
            let vertex = &geometry.text.vertices[indices[0] as usize];
            let shader = TextShader { lettering, ink: vertex.ink, paper: vertex.paper };
            let corners = text.triangle(simd, &transform, indices);
            triangle::draw(simd, canvas, grid, corners, &shader);
        }
        let sides = view.barricades.iter().map(|&side| {
            let barricade = &geometry.solid.indices[geometry.barricade.clone()];
            (barricade, side)
        });
        for (indices, placement) in
            std::iter::once((&view.list.solid[..], Placement::IDENTITY)).chain(sides)
        {
            let transform = transform.at(placement);
            solid.forget();
            for indices in indices.chunks_exact(3) {
                let corners = solid.triangle(simd, &transform, indices);
                triangle::draw(simd, canvas, grid, corners, &LitShader);
            }
        }
        canvas.resolve(simd, pixels);
    }
}
