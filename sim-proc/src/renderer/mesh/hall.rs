//! The hall around the racks: floor with markings, upper walls, roof, lamps, signs, barricades.
//!
//! Signs and barricades are in the frame of a viewer who faces them, everything else in world space: x east, y north, z up,
//! in metres.

use domain::{Cell, Heading};
use warehouse::{Layout, Square};

use super::builder::{Detail, Material, Mesh, MeshBuilder, Side};

/// Height of the roof, in metres.
pub(crate) const ROOF_M: f32 = 5.6;

/// How far shade reaches from a rack's foot, in metres.
const SHADE_REACH_M: f32 = 0.4;

const CONCRETE: Material = Material::dull([150, 150, 147]);
const LINE: Material = Material::dull([232, 190, 44]);
const WALL: Material = Material::dull([196, 200, 202]);
const ROOF: Material = Material::dull([168, 174, 180]);
const TRUSS: Material = Material::dull([104, 112, 122]);

/// The floor of a free cell, darker at the foot of racks and walls, in slabs of slightly different tone.
pub(crate) fn floor(layout: &Layout, cell: Cell) -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let (x0, y0) = (f32::from(cell.x), f32::from(cell.y));
    let solid = solid_around(layout, cell);
    let slab = dice(u32::from(cell.x) / 4, u32::from(cell.y) / 4);
    b.material(CONCRETE.shaded(0.97 + 0.06 * slab));
    let splits = [0.0, SHADE_REACH_M, 1.0 - SHADE_REACH_M, 1.0];
    for i in 0..3 {
        for j in 0..3 {
            let (l, r) = (x0 + splits[i], x0 + splits[i + 1]);
            let (f, k) = (y0 + splits[j], y0 + splits[j + 1]);
            b.shaded_polygon(&[[l, f, 0.0], [r, f, 0.0], [r, k, 0.0], [l, k, 0.0]], |[x, y, _]| {
                floor_shade(&solid, x, y)
            });
        }
    }
    markings(&mut b, layout, cell);
    b.finish()
}

/// The south-west corners of all cells around `cell` that are not free.
fn solid_around(layout: &Layout, cell: Cell) -> Vec<[f32; 2]> {
    let mut solid = Vec::new();
    for dy in -1..=1_i16 {
        for dx in -1..=1_i16 {
            let (x, y) = (i16::from(cell.x) + dx, i16::from(cell.y) + dy);
            if !is_free(layout, x, y) {
                solid.push([f32::from(x), f32::from(y)]);
            }
        }
    }
    solid
}

fn is_free(layout: &Layout, x: i16, y: i16) -> bool {
    match (u8::try_from(x), u8::try_from(y)) {
        (Ok(x), Ok(y)) => layout.is_free(Cell::new(x, y)),
        _ => false,
    }
}

/// The brightness of the floor at (x, y): lower near racks and walls.
fn floor_shade(solid: &[[f32; 2]], x: f32, y: f32) -> f32 {
    let nearest = solid
        .iter()
        .map(|&[sx, sy]| {
            let dx = (sx - x).max(x - sx - 1.0).max(0.0);
            let dy = (sy - y).max(y - sy - 1.0).max(0.0);
            dx.hypot(dy)
        })
        .fold(SHADE_REACH_M, f32::min);
    // A faint stain keeps large areas of concrete from looking uniform.
    let stain = 0.02 * ((x * 1.7).sin() * (y * 1.3).cos() + (x * 0.61 + y * 0.83).sin());
    0.62 + 0.38 * (nearest / SHADE_REACH_M) + stain
}

/// Yellow lines along the racks.
fn markings(b: &mut MeshBuilder, layout: &Layout, cell: Cell) {
    let (cx, cy) = cell.centre();
    let is_rack = |heading: Heading| {
        cell.step(heading).is_some_and(|next| layout.square(next) == Square::Rack)
    };
    let (inner, outer, z) = (0.34, 0.40, 0.003);
    // A point in the frame of a viewer who looks towards `heading`: to the right, then ahead.
    let point = |heading: Heading, along: f32, ahead: f32| {
        let ((fx, fy), (rx, ry)) = (vector(heading), vector(heading.right()));
        [cx + rx * along + fx * ahead, cy + ry * along + fy * ahead, z]
    };
    b.material(LINE);
    for heading in Heading::ALL {
        if !is_rack(heading) {
            continue;
        }
        let at = |along: f32, ahead: f32| point(heading, along, ahead);
        let (left, right) = (is_rack(heading.left()), is_rack(heading.right()));
        let l = if left { -inner } else { -0.5 };
        let r = if right { inner } else { 0.5 };
        b.polygon(&[at(l, inner), at(r, inner), at(r, outer), at(l, outer)]);
    }
    // Around an outer corner of a rack the line continues through the diagonal cell.
    for heading in Heading::ALL {
        let diagonal = cell.step(heading).and_then(|c| c.step(heading.right()));
        let corner = diagonal.is_some_and(|c| layout.square(c) == Square::Rack)
            && !is_rack(heading)
            && !is_rack(heading.right());
        if !corner {
            continue;
        }
        let at = |along: f32, ahead: f32| point(heading, along, ahead);
        b.polygon(&[at(inner, inner), at(0.5, inner), at(0.5, outer), at(inner, outer)]);
        b.polygon(&[at(inner, outer), at(outer, outer), at(outer, 0.5), at(inner, 0.5)]);
    }
}

fn vector(heading: Heading) -> (f32, f32) {
    let (x, y) = heading.vector();
    (f32::from(x), f32::from(y))
}

/// A pseudo-random number in 0..1.
fn dice(a: u32, b: u32) -> f32 {
    let mixed =
        (a.wrapping_mul(0x9e37_79b1) ^ b.wrapping_mul(0x85eb_ca77)).wrapping_mul(0xc2b2_ae3d);
    (mixed >> 8) as f32 / (1 << 24) as f32
}

/// The wall above the racks between two points of the floor plan, left to right as seen from inside.
pub(crate) fn upper_wall(from: [f32; 2], to: [f32; 2], bottom: f32) -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let ([x0, y0], [x1, y1]) = (from, to);
    b.material(WALL.shaded(0.94));
    b.shaded_polygon(
        &[[x0, y0, bottom], [x1, y1, bottom], [x1, y1, ROOF_M], [x0, y0, ROOF_M]],
        |[_, _, z]| {
            if z > bottom { 0.86 } else { 1.06 }
        },
    );
    b.finish()
}

/// A piece of roof over x0..x1, y0..y1 with a beam along its southern edge.
pub(crate) fn roof(x0: f32, x1: f32, y0: f32, y1: f32) -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    b.material(ROOF);
    b.polygon(&[[x0, y1, ROOF_M], [x1, y1, ROOF_M], [x1, y0, ROOF_M], [x0, y0, ROOF_M]]);
    b.material(TRUSS);
    let hidden = [Side::Top, Side::Left, Side::Right];
    b.block_without([x0, y0 - 0.09, ROOF_M - 0.42], [x1, y0 + 0.09, ROOF_M - 0.02], &hidden);
    b.finish()
}

/// A lamp 1.4 m long above (x, y), along the aisle.
pub(crate) fn lamp(x: f32, y: f32, north_south: bool) -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let (hx, hy) = if north_south { (0.11, 0.7) } else { (0.7, 0.11) };
    let z = 4.3;
    b.material(Material::dull([90, 94, 100]));
    b.block_without([x - hx, y - hy, z], [x + hx, y + hy, z + 0.09], &[Side::Bottom]);
    b.material(Material::glowing([255, 253, 240]));
    b.polygon(&[
        [x - hx, y + hy, z],
        [x + hx, y + hy, z],
        [x + hx, y - hy, z],
        [x - hx, y - hy, z],
    ]);
    b.finish()
}

/// The board of an overhead sign in the frame of a viewer who faces it: left, bottom, right, top.
pub(crate) const SIGN_M: [f32; 4] = [-0.8, 2.52, 0.8, 2.9];

/// The board of an overhead sign, centred on y = 0, and the rods it hangs from.
pub(crate) fn sign_board() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let [left, bottom, right, top] = SIGN_M;
    b.material(Material::dull([40, 52, 70]));
    b.block_without([left, -0.025, bottom], [right, 0.025, top], &[]);
    for x in [0.7 * left, 0.7 * right] {
        b.block_without(
            [x - 0.01, -0.01, top],
            [x + 0.01, 0.01, ROOF_M],
            &[Side::Top, Side::Bottom],
        );
    }
    b.finish()
}

/// One side of a barricade, 1 m wide, in the frame of a face. It stands just behind y = 0 and is striped on both sides.
pub(crate) fn barricade() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    let (front, back) = (0.10, 0.13);
    for (low, high) in [(0.22, 0.44), (0.62, 0.84), (1.02, 1.24)] {
        for (y, facing) in [(front, 1.0), (back, -1.0)] {
            for i in -6..6_i32 {
                let (x, width, lean) = (i as f32 * 0.125, 0.125, 0.125);
                let red = i.rem_euclid(2) == 0;
                let outline =
                    [[x, low], [x + width, low], [x + width + lean, high], [x + lean, high]];
                let clipped = within(&outline, -0.5, 0.5);
                if clipped.len() < 3 {
                    continue;
                }
                b.material(Material::dull(if red { [214, 28, 30] } else { [246, 246, 244] }));
                // Mirroring the outline also makes it face backwards.
                let corners = clipped.iter().map(|&[x, z]| [x * facing, y, z]);
                b.polygon(&corners.collect::<Vec<_>>());
            }
        }
        b.material(Material::dull([180, 180, 178]));
        b.block_without([-0.5, front, low], [0.5, back, high], &[Side::Front, Side::Back]);
    }
    b.material(Material::dull([66, 68, 72]));
    for x in [-0.36, 0.36] {
        b.block_without([x - 0.03, back, 0.05], [x + 0.03, back + 0.05, 1.3], &[Side::Bottom]);
        b.block([x - 0.05, -0.05, 0.0], [x + 0.05, 0.42, 0.05]);
        b.moved([x, back + 0.025, 1.3], |b| {
            b.material(Material::glowing([255, 150, 20]));
            b.smooth_body(&[[0.06, 0.02], [0.075, 0.07], [0.06, 0.13], [0.0, 0.155]], 10);
            b.material(Material::dull([50, 50, 52]));
            b.turned_body(&[[0.065, 0.0], [0.065, 0.02]], 10);
        });
    }
    b.finish()
}

/// The part of a convex outline between `min` and `max` in x.
fn within(outline: &[[f32; 2]], min: f32, max: f32) -> Vec<[f32; 2]> {
    let keep = |outline: &[[f32; 2]], inside: &dyn Fn(f32) -> bool, limit: f32| {
        let mut kept: Vec<[f32; 2]> = Vec::new();
        for (i, &[x0, z0]) in outline.iter().enumerate() {
            let [x1, z1] = outline[(i + 1) % outline.len()];
            if inside(x0) {
                kept.push([x0, z0]);
            }
            if inside(x0) != inside(x1) {
                kept.push([limit, z0 + (z1 - z0) * (limit - x0) / (x1 - x0)]);
            }
        }
        kept
    };
    let kept = keep(outline, &|x| x > min, min);
    keep(&kept, &|x| x < max, max)
}
