//! Walls up to the racks' height, and what stands against them or hangs on them.
//!
//! The frame of a wall: x to the viewer's right, y into the wall, z up. What protrudes from the wall has a negative y.

use domain::Heading;

use super::builder::{Detail, Material, Mesh, MeshBuilder, Side};

/// How far boards with text protrude from the wall, in metres.
pub(crate) const BOARD_OFFSET_M: f32 = 0.075;

/// The text of a notice: left, bottom, right, top.
pub(crate) const NOTICE_M: [f32; 4] = [-0.6, 1.72, 0.6, 2.0];

const WALL: Material = Material::dull([198, 202, 204]);
const STEEL: Material = Material::dull([112, 120, 130]);
const YELLOW: Material = Material::dull([236, 190, 36]);
const BLACK: Material = Material::dull([40, 40, 42]);

/// The colour at the foot of walls that face a viewer looking in this direction. Each side of the hall has its own.
fn stripe(facing: Heading) -> Material {
    Material::dull(match facing {
        Heading::N => [62, 104, 142],
        Heading::E => [78, 122, 96],
        Heading::S => [142, 92, 66],
        Heading::W => [122, 112, 88],
    })
}

/// A metre of corrugated wall above a painted foot.
pub(crate) fn cladding(facing: Heading, top: f32) -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let shade = |[_, _, z]: [f32; 3]| 0.70 + 0.30 * (z / 0.7).min(1.0);
    let mut strip = |material: Material, x0: f32, x1: f32, z0: f32, z1: f32| {
        b.material(material);
        b.shaded_polygon(&[[x0, 0.0, z0], [x1, 0.0, z0], [x1, 0.0, z1], [x0, 0.0, z1]], shade);
    };
    // From below the floor, so that no gap opens between the two.
    strip(stripe(facing), -0.5, 0.5, -0.02, 0.7);
    strip(stripe(facing), -0.5, 0.5, 0.7, 1.0);
    strip(Material::dull([232, 232, 228]), -0.5, 0.5, 1.0, 1.05);
    // Corrugation is painted on: at this distance only its shade is visible.
    for i in 0..6 {
        let x = -0.5 + i as f32 / 6.0;
        strip(WALL, x, x + 0.105, 1.05, top);
        strip(WALL.shaded(0.93), x + 0.105, x + 1.0 / 6.0, 1.05, top);
    }
    b.finish()
}

/// A steel column, as high as the racks.
pub(crate) fn column() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    b.material(STEEL);
    let hidden = [Side::Bottom, Side::Back, Side::Top];
    b.block_without([-0.11, -0.05, 0.0], [0.11, 0.0, 3.0], &hidden);
    b.block_without([-0.035, -0.17, 0.0], [0.035, -0.05, 3.0], &hidden);
    b.block_without([-0.1, -0.2, 0.0], [0.1, -0.17, 3.0], &hidden[..1]);
    for k in 0..4 {
        b.material(if k % 2 == 0 { YELLOW } else { BLACK });
        let z = 0.25 * k as f32;
        b.block_without([-0.115, -0.205, z], [0.115, -0.165, z + 0.25], &[Side::Bottom]);
    }
    b.finish()
}

/// A roller gate between striped posts.
pub(crate) fn gate() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let (half, top) = (1.25, 2.45);
    let slats = 14;
    for i in 0..slats {
        let height = top / slats as f32;
        let low = height * i as f32;
        // A slat bulges: its lower half faces down, its upper half up, and a dark groove separates two slats.
        let edges = [
            (low, 0.012),
            (low + 0.012, 0.012),
            (low + height / 2.0, 0.034),
            (low + height, 0.012),
        ];
        let groove = Material::dull([78, 86, 96]);
        let steel = Material::dull([158, 168, 178]);
        for (pair, material) in edges.windows(2).zip([groove, steel, steel]) {
            let [(z0, out0), (z1, out1)] = [pair[0], pair[1]];
            b.material(material);
            b.polygon(&[
                [-half, -out0, z0],
                [half, -out0, z0],
                [half, -out1, z1],
                [-half, -out1, z1],
            ]);
        }
    }
    for side in [-1.0_f32, 1.0] {
        let (p, q) = (side * half, side * (half + 0.14));
        let (x0, x1) = (p.min(q), p.max(q));
        for k in 0..10 {
            b.material(if k % 2 == 0 { YELLOW } else { BLACK });
            let z = 0.25 * k as f32;
            let hidden = [Side::Bottom, Side::Top, Side::Back];
            b.block_without([x0, -0.09, z], [x1, 0.0, z + 0.25], &hidden);
        }
    }
    b.material(STEEL.shaded(0.8));
    b.block_without([-half - 0.14, -0.07, top], [half + 0.14, 0.0, 2.86], &[Side::Back]);
    b.finish()
}

/// An emergency exit with its push bar, under a lit sign.
pub(crate) fn exit() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    b.material(STEEL.shaded(0.75));
    b.block_without([-0.56, -0.04, 0.0], [0.56, 0.0, 2.12], &[Side::Back, Side::Bottom]);
    b.material(Material::dull([72, 128, 104]));
    b.block_without([-0.49, -0.055, 0.0], [0.49, -0.04, 2.05], &[Side::Back, Side::Bottom]);
    b.material(Material::dull([60, 108, 88]));
    for (low, high) in [(0.15, 0.85), (1.2, 1.9)] {
        b.block_without([-0.38, -0.06, low], [0.38, -0.055, high], &[Side::Back]);
    }
    b.material(Material::dull([200, 52, 44]));
    b.block_without([-0.42, -0.11, 0.99], [0.42, -0.055, 1.05], &[Side::Back]);
    b.material(BLACK);
    b.block_without([-0.4, -0.07, 2.16], [0.4, 0.0, 2.48], &[Side::Back]);
    b.finish()
}

/// The frame of a notice.
pub(crate) fn notice_board() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    b.material(Material::dull([52, 62, 78]));
    let [left, bottom, right, top] = NOTICE_M;
    let frame = 0.04;
    let (min, max) = ([left - frame, -0.07, bottom - frame], [right + frame, 0.0, top + frame]);
    b.block_without(min, max, &[Side::Back]);
    b.finish()
}
