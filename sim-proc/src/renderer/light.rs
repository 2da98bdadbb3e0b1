//! Bakes light into vertex colours.
//!
//! Nothing in the warehouse moves, so light is computed once per vertex and shaders only add fog. There are two lights. In
//! a bay, light comes from in front of the face, above and slightly from the left, whatever the direction of the face: an
//! item looks the same wherever it stands. In the hall, light comes from above, and each wall has its own brightness.

use nalgebra::Vector3;

use super::mesh::builder::Vertex;
use super::mesh::rack::{BAY_DEPTH_M, SHELF_TOP_M};

/// The light that a mesh stands in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Light {
    /// In a bay. Positions are in the frame of its face.
    Bay,
    /// As [`Light::Bay`], for an item that stands on the shelf.
    Shelf,
    /// In the hall. Positions are in the world.
    Hall,
}

/// The baked colour: sRGB, and in alpha the share of fog that the vertex takes.
pub(super) fn baked(vertex: &Vertex, light: Light) -> [u8; 4] {
    let material = vertex.material;
    if material.glows {
        let [r, g, b] = material.rgb;
        return [r, g, b, 0];
    }
    let normal = vertex.normal;
    let (strength, highlight) = match light {
        Light::Bay | Light::Shelf => {
            let key = Vector3::new(-0.42, -0.62, 0.66);
            let viewer = Vector3::new(0.0, -1.0, 0.1);
            let towards = normal.dot(&key).max(0.0);
            let half = (key + viewer).normalize();
            let highlight = material.gloss * normal.dot(&half).max(0.0).powi(28);
            (ambient(normal) + 0.78 * towards, highlight)
        }
        Light::Hall => {
            let key = Vector3::new(-0.3, -0.5, 0.81);
            (ambient(normal) + 0.52 * normal.dot(&key).max(0.0), 0.0)
        }
    };
    let strength = strength * openness(vertex, light);
    let linear = material.rgb.map(linear_from_srgb);
    let [r, g, b] = linear.map(|c| srgb_from_linear(c * strength + 0.75 * highlight));
    [r, g, b, 255]
}

/// Ambient light: more from above than from below.
fn ambient(normal: Vector3<f32>) -> f32 {
    0.42 + 0.16 * normal.z
}

/// The share of light that reaches a place: less deep in a bay, near the floor and close to a shelf.
fn openness(vertex: &Vertex, light: Light) -> f32 {
    let (p, n) = (vertex.position, vertex.normal);
    match light {
        Light::Hall => 1.0,
        Light::Bay => {
            let deep = (p.y / BAY_DEPTH_M).clamp(0.0, 1.0);
            let low = (p.z / 0.7).clamp(0.0, 1.0);
            (1.0 - 0.34 * deep) * (0.66 + 0.34 * low)
        }
        Light::Shelf => {
            let above = ((p.z - SHELF_TOP_M) / 0.14).clamp(0.0, 1.0);
            let facing_away = (n.y * 0.5).max(0.0);
            (0.68 + 0.32 * above) * (1.0 - 0.4 * facing_away)
        }
    }
}

fn linear_from_srgb(value: u8) -> f32 {
    let c = f32::from(value) / 255.0;
    if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

fn srgb_from_linear(value: f32) -> u8 {
    let c = value.clamp(0.0, 1.0);
    let encoded = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}
