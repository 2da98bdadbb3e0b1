//! Bakes light into vertex colours.
//!
//! Nothing in the warehouse moves, so light is computed once per vertex and shaders only add fog. There are two lights. In
//! a bay, light comes from in front of the face, above and slightly from the left, whatever the direction of the face: an
//! item looks the same wherever it stands. In the hall, light comes from above, and each wall has its own brightness. A
//! [`Look`] varies both.

use std::sync::LazyLock;

use nalgebra::Vector3;

use super::look::Look;
use super::mesh::builder::{MeshPart, MeshVertex};
use super::mesh::rack::{BAY_DEPTH_M, SHELF_TOP_M};

/// The baked colour: sRGB, and in alpha the share of fog that the vertex takes.
pub(super) fn baked(vertex: &MeshVertex, part: MeshPart, look: &Look) -> [u8; 4] {
    let material = vertex.material;
    if material.glows {
        let [r, g, b] = material.rgb;
        return [r, g, b, 0];
    }
    let normal = vertex.normal;
    let ambient = look.ambient * ambient(normal);
    let (strength, highlight) = match part {
        MeshPart::Rack | MeshPart::Item | MeshPart::Barricade => {
            let key = look.turned(Vector3::new(-0.42, -0.62, 0.66));
            let viewer = Vector3::new(0.0, -1.0, 0.1);
            let towards = normal.dot(&key).max(0.0);
            let half = (key + viewer).normalize();
            let highlight = material.gloss * normal.dot(&half).max(0.0).powi(28);
            (ambient + look.key * 0.78 * towards, highlight)
        }
        MeshPart::Floor | MeshPart::Wall | MeshPart::Fixture => {
            let key = look.turned(Vector3::new(-0.3, -0.5, 0.81));
            (ambient + look.key * 0.52 * normal.dot(&key).max(0.0), 0.0)
        }
    };
    let strength = strength * openness(vertex, part);
    let tint = look.tint(part);
    let channel = |i: usize| {
        let surface = LINEAR_FROM_SRGB[usize::from(material.rgb[i])] * tint[i];
        srgb_from_linear((surface * strength + 0.75 * highlight) * look.colour[i])
    };
    [channel(0), channel(1), channel(2), 255]
}

/// Ambient light: more from above than from below.
fn ambient(normal: Vector3<f32>) -> f32 {
    0.42 + 0.16 * normal.z
}

/// The share of light that reaches a place: less deep in a bay, near the floor and close to a shelf.
fn openness(vertex: &MeshVertex, part: MeshPart) -> f32 {
    let (p, n) = (vertex.position, vertex.normal);
    match part {
        MeshPart::Floor | MeshPart::Wall | MeshPart::Fixture => 1.0,
        MeshPart::Rack | MeshPart::Barricade => {
            let deep = (p.y / BAY_DEPTH_M).clamp(0.0, 1.0);
            let low = (p.z / 0.7).clamp(0.0, 1.0);
            (1.0 - 0.34 * deep) * (0.66 + 0.34 * low)
        }
        MeshPart::Item => {
            let above = ((p.z - SHELF_TOP_M) / 0.14).clamp(0.0, 1.0);
            let facing_away = (n.y * 0.5).max(0.0);
            (0.68 + 0.32 * above) * (1.0 - 0.4 * facing_away)
        }
    }
}

/// The linear values of all sRGB values.
static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|value| {
        let c = value as f32 / 255.0;
        if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    })
});

/// The smallest linear value of every sRGB value but 0.
static SRGB_STARTS: LazyLock<[f32; 255]> = LazyLock::new(|| {
    std::array::from_fn(|below| {
        // Positive floats are in the order of their bits.
        let (mut low, mut high) = (0, 1.0_f32.to_bits());
        while high - low > 1 {
            let middle = u32::midpoint(low, high);
            if usize::from(encoded(f32::from_bits(middle))) > below {
                high = middle;
            } else {
                low = middle;
            }
        }
        f32::from_bits(high)
    })
});

/// As [`encoded`], in half the time.
fn srgb_from_linear(value: f32) -> u8 {
    SRGB_STARTS.partition_point(|&start| start <= value) as u8
}

/// The sRGB value of a linear one, by its formula.
fn encoded(linear: f32) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let encoded = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_in_the_table_are_those_of_the_formula() {
        let beside_starts = SRGB_STARTS.iter().flat_map(|start| {
            (-300..=300).map(|step| f32::from_bits(start.to_bits().saturating_add_signed(step)))
        });
        let everywhere = (0..400_000).map(|i| i as f32 / 300_000.0);
        for linear in beside_starts.chain(everywhere).chain([-1.0, -0.0, 1e9]) {
            assert_eq!(srgb_from_linear(linear), encoded(linear), "{linear}");
        }
    }
}
