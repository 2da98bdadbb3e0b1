//! Variation of light and tints by a seed, within bounds that leave everything recognisable.
//!
//! Items are lit differently but never tinted: their colours are part of their names.

use nalgebra::Vector3;

use super::mesh::builder::MeshPart;

/// How far the lights turn about the vertical axis, in degrees.
const TURN_DEG: f32 = 40.0;

/// Light and tints. Factors apply to linear light.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Look {
    /// Sine and cosine of the angle by which the lights turn about the vertical axis.
    turn: [f32; 2],
    /// Strength of the directed light.
    pub(super) key: f32,
    /// Strength of the ambient light.
    pub(super) ambient: f32,
    /// Colour of all light.
    pub(super) colour: [f32; 3],
    floor: [f32; 3],
    wall: [f32; 3],
    rack: [f32; 3],
}

impl Look {
    /// The look of `seed`; that of 0 changes nothing.
    pub(super) fn of(seed: u64) -> Self {
        if seed == 0 {
            let none = [1.0; 3];
            return Self {
                turn: [0.0, 1.0],
                key: 1.0,
                ambient: 1.0,
                colour: none,
                floor: none,
                wall: none,
                rack: none,
            };
        }
        let mut draws = blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof();
        // A number in -1..=1.
        let mut draw = || {
            let mut bytes = [0; 2];
            draws.fill(&mut bytes);
            f32::from(u16::from_le_bytes(bytes)) / 32_767.5 - 1.0
        };
        let (sin, cos) = (TURN_DEG * draw()).to_radians().sin_cos();
        let (key, ambient, warm) = (1.0 + 0.25 * draw(), 0.95 + 0.2 * draw(), 0.1 * draw());
        let mut tint = |brightness: f32, hue: f32| {
            let brightness = 0.95 + brightness * draw();
            [0, 1, 2].map(|_| brightness * (1.0 + hue * draw()))
        };
        Self {
            turn: [sin, cos],
            key,
            ambient,
            colour: [1.0 + warm, 1.0, 1.0 - warm],
            floor: tint(0.35, 0.2),
            wall: tint(0.25, 0.25),
            rack: tint(0.2, 0.3),
        }
    }

    /// The direction of a light that stands at `key` in the standard look.
    pub(super) fn turned(&self, key: Vector3<f32>) -> Vector3<f32> {
        let [sin, cos] = self.turn;
        Vector3::new(cos * key.x - sin * key.y, sin * key.x + cos * key.y, key.z)
    }

    /// The factor for the colours of `part`.
    pub(super) fn tint(&self, part: MeshPart) -> [f32; 3] {
        match part {
            MeshPart::Floor => self.floor,
            MeshPart::Wall => self.wall,
            MeshPart::Rack => self.rack,
            MeshPart::Item | MeshPart::Barricade | MeshPart::Fixture => [1.0; 3],
        }
    }
}
