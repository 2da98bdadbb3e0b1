//! The renderer's CPU backend: draws triangles into RGBA images with vector instructions. Knows no scene, no poses and
//! no shared memory.
//!
//! The scene needs three fixed ways of colouring (lit, label plate, text), so they are compiled into the loops that fill
//! blocks of 4 x 4 pixels, one vector register per value. `geometry` holds the data that the GPU backend draws too,
//! `quads` pairs triangles, `corner` transforms vertices, `fill` finds the samples that are covered, `shade` colours
//! them, `canvas` holds colour and depth.
//!
//! An image depends on its view alone: every vector width does the same arithmetic, and nothing is contracted or
//! approximated.

mod canvas;
mod corner;
mod fill;
mod geometry;
mod quads;
mod shade;

pub use fearless_simd::Level;
use fearless_simd::Simd;

use canvas::SampledImage;
use corner::{Corners, Grid, Transform, Vertices};
pub use geometry::{
    Atlas, DrawList, FOG_PER_M, FOG_RGB, Geometry, NEAR_M, Placement, PlateVertex, PreparedView,
    SolidVertex, TextVertex, TriangleLayer,
};
use quads::Quads;
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

/// A scene's geometry in the order that vector instructions read it, once for all rasterizers of a process.
pub struct PackedGeometry {
    solid: PackedLayer,
    plate: PackedLayer,
    text: PackedLayer,
    lettering: Lettering,
}

struct PackedLayer {
    vertices: Vertices,
    quads: Quads,
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

/// The places of the scene's vertices in the current view.
struct Layers {
    grid: Grid,
    solid: Corners,
    plate: Corners,
    text: Corners,
}

impl PackedGeometry {
    /// Copies what rasterizers need of `geometry`.
    pub fn new(geometry: &Geometry) -> Self {
        let solid = PackedLayer::new(&geometry.solid, COLOUR_TOLERANCE, |vertex| {
            let [r, g, b, fog] = vertex.colour.map(f32::from);
            (vertex.position, [r, g, b, fog / 255.0])
        });
        let plate = PackedLayer::new(&geometry.plate, PLACE_TOLERANCE, |vertex| {
            let [x, y] = vertex.across;
            (vertex.position, [x, y, 0.0, 0.0])
        });
        let text = PackedLayer::new(&geometry.text, PLACE_TOLERANCE, |vertex| {
            let [x, y] = vertex.atlas;
            (vertex.position, [x, y, 0.0, 0.0])
        });
        Self { solid, plate, text, lettering: Lettering::new(&geometry.atlas) }
    }
}

impl PackedLayer {
    /// `corner` is the position of a vertex, three values and its share of fog.
    fn new<V>(
        layer: &TriangleLayer<V>,
        tolerance: f32,
        corner: impl Fn(&V) -> ([f32; 3], [f32; 4]),
    ) -> Self {
        let vertices = layer.vertices.iter().map(|vertex| {
            let (position, [a, b, c, fog]) = corner(vertex);
            (position, fog, [a, b, c])
        });
        Self { vertices: Vertices::new(vertices), quads: Quads::new(layer, &corner, tolerance) }
    }
}

impl Rasterizer {
    /// For images of `width_px` x `height_px` of `packed`.
    pub fn new(packed: &PackedGeometry, width_px: u32, height_px: u32, samples: Samples) -> Self {
        let layers = Layers {
            grid: Grid::new(width_px, height_px),
            solid: Corners::new(&packed.solid.vertices),
            plate: Corners::new(&packed.plate.vertices),
            text: Corners::new(&packed.text.vertices),
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

    /// Draws a view of `geometry` into `pixels`, RGBA in rows from the top; `packed` is made from it, and `background` is
    /// RGBA with red in the lowest byte.
    pub fn draw(
        &mut self,
        geometry: &Geometry,
        packed: &PackedGeometry,
        view: &PreparedView,
        background: u32,
        pixels: &mut [u8],
    ) {
        let Self { level, layers, canvas } = self;
        match canvas {
            AnyCanvas::One(canvas) => {
                canvas.clear(background);
                layers.draw_at(*level, (geometry, packed), view, canvas, pixels);
            }
            AnyCanvas::Four(canvas) => {
                canvas.clear(background);
                layers.draw_at(*level, (geometry, packed), view, canvas, pixels);
            }
        }
    }
}

/// The largest error of colours, 0 to 255, across a quad.
const COLOUR_TOLERANCE: f32 = 2.0;

/// The largest error of positions on a plate or in the atlas, 0 to 1.
const PLACE_TOLERANCE: f32 = 1e-5;

impl Layers {
    /// Draws with AVX-512, AVX2 or SSE2. Each level is a compiled copy of everything below, so SSE4.2, which only
    /// processors from before 2013 stop at, has none.
    #[cfg(target_arch = "x86_64")]
    fn draw_at<const M: usize>(
        &mut self,
        level: Level,
        scene: (&Geometry, &PackedGeometry),
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        if let Some(simd) = level.as_avx512() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, scene, view, canvas, pixels),
            );
        } else if let Some(simd) = level.as_avx2() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, scene, view, canvas, pixels),
            );
        } else if let Some(simd) = level.as_sse2() {
            simd.vectorize(
                #[inline(always)]
                || self.draw(simd, scene, view, canvas, pixels),
            );
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn draw_at<const M: usize>(
        &mut self,
        level: Level,
        scene: (&Geometry, &PackedGeometry),
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        fearless_simd::dispatch!(level, simd => self.draw(simd, scene, view, canvas, pixels));
    }

    #[inline(always)]
    fn draw<V: Simd, const M: usize>(
        &mut self,
        simd: V,
        scene: (&Geometry, &PackedGeometry),
        view: &PreparedView,
        canvas: &mut SampledImage<M>,
        pixels: &mut [u8],
    ) {
        let Self { grid, solid, plate, text } = self;
        let (geometry, packed) = scene;
        let transform = Transform::new(grid, view.clip_from_world);
        // In the order of the GPU backend: what hangs in front comes first, so that little is drawn over.
        let PackedLayer { vertices, quads } = &packed.plate;
        plate.forget();
        for quad in quads.of(&view.list.plate) {
            let shader = PlateShader { code: geometry.plate.vertices[quad[0] as usize].code };
            let corners = plate.quad(simd, &transform, vertices, quad);
            fill::draw(simd, canvas, grid, corners, &shader);
        }
        let PackedLayer { vertices, quads } = &packed.text;
        text.forget();
        for quad in quads.of(&view.list.text) {
            let &TextVertex { ink, paper, .. } = &geometry.text.vertices[quad[0] as usize];
            let shader = TextShader { lettering: &packed.lettering, ink, paper };
            let corners = text.quad(simd, &transform, vertices, quad);
            fill::draw(simd, canvas, grid, corners, &shader);
        }
        let PackedLayer { vertices, quads } = &packed.solid;
        let sides = view.barricades.iter().map(|&side| {
            let barricade = &geometry.solid.indices[geometry.barricade.clone()];
            (barricade, side)
        });
        for (triangles, placement) in
            std::iter::once((&view.list.solid[..], Placement::IDENTITY)).chain(sides)
        {
            let transform = transform.at(placement);
            solid.forget();
            for quad in quads.of(triangles) {
                let corners = solid.quad(simd, &transform, vertices, quad);
                let shader = LitShader::new(simd, corners);
                fill::draw(simd, canvas, grid, corners, &shader);
            }
        }
        canvas.resolve(simd, pixels);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 64;

    /// Random numbers from -1 to 1.
    struct Random(u32);

    impl Random {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 23) as f32 - 1.0
        }
    }

    /// A view of these two triangles from the origin, a right angle wide, with y ahead.
    fn image(corners: [[f32; 3]; 4], colours: [[u8; 4]; 4], indices: [u32; 6]) -> Vec<[u8; 4]> {
        let vertices = corners.into_iter().zip(colours);
        let vertices = vertices.map(|(position, colour)| SolidVertex { position, colour });
        let geometry = Geometry {
            solid: TriangleLayer { vertices: vertices.collect(), indices: indices.to_vec() },
            atlas: Atlas { width: 1, height: 1, levels: vec![vec![0]] },
            ..Geometry::default()
        };
        let list = DrawList { solid: indices.to_vec(), ..DrawList::default() };
        let clip_from_world =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0], [0.0; 4]];
        let view = PreparedView { clip_from_world, list, barricades: Vec::new() };
        let mut pixels = vec![0; SIDE * SIDE * 4];
        let packed = PackedGeometry::new(&geometry);
        let mut rasterizer = Rasterizer::new(&packed, SIDE as u32, SIDE as u32, Samples::One);
        rasterizer.draw(&geometry, &packed, &view, 0, &mut pixels);
        pixels.as_chunks().0.to_vec()
    }

    #[test]
    fn a_quad_covers_what_its_triangles_cover_in_the_same_colours() {
        let mut random = Random(1);
        let (mut cut, mut covered) = (0, 0);
        for _ in 0..2000 {
            // A parallelogram, some of them thin, some of them behind the camera in part.
            let centre = [random.next(), 1.5 + 2.0 * random.next(), random.next()];
            let thin = if random.next() > 0.5 { 0.02 } else { 0.8 };
            let [u, v] = [0.8, thin].map(|size| [0; 3].map(|_| size * random.next()));
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|[s, t]| [0, 1, 2].map(|axis| centre[axis] + s * u[axis] + t * v[axis]));
            cut += usize::from(corners.iter().any(|corner| corner[1] < NEAR_M));
            let colours =
                [[40, 90, 200, 0], [80, 90, 200, 0], [80, 130, 180, 0], [40, 130, 180, 0]];
            let quad = image(corners, colours, [0, 1, 2, 0, 2, 3]);
            // The same triangles, which are not recognised as a quad.
            let triangles = image(corners, colours, [1, 2, 0, 2, 3, 0]);
            covered += quad.iter().filter(|pixel| **pixel != [0; 4]).count();
            for (a, b) in quad.iter().zip(&triangles) {
                assert!(
                    a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1),
                    "{corners:?}: {a:?} {b:?}"
                );
            }
        }
        assert!(cut > 100 && covered > 100_000, "{cut} cut, {covered} pixels covered");
    }
}
