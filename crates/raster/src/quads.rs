//! Pairs of triangles that make a flat, convex quad. Drawn at once, a quad costs little more than a triangle.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::geometry::TriangleLayer;

/// For a vertex at which no diagonal ends.
const NONE: u32 = u32::MAX;

/// How far the fourth corner may be from the plane of the others, as a share of the quad's size.
const FLATNESS: f32 = 1e-4;

/// The quads of a layer.
pub(super) struct Quads {
    /// By the second end of a quad's diagonal, the first.
    diagonals: Vec<u32>,
}

impl Quads {
    /// Finds the quads of a layer: two triangles in succession, fanning out from the first corner, whose values are linear
    /// across both but for `tolerance`.
    pub(super) fn new<V, const N: usize>(
        layer: &TriangleLayer<V>,
        corner: impl Fn(&V) -> ([f32; 3], [f32; N]),
        tolerance: f32,
    ) -> Self {
        let mut diagonals = vec![NONE; layer.vertices.len()];
        for six in layer.indices.windows(6).step_by(3) {
            let &[a, b, c, e, f, d] = six else { continue };
            let corners = [a, b, c, d].map(|index| corner(&layer.vertices[index as usize]));
            if [e, f] == [a, c] && is_quad(corners, tolerance) {
                diagonals[c as usize] = a;
            }
        }
        Self { diagonals }
    }

    /// The corners of the quads that triangles make. Those of a triangle by itself end with its last corner once more.
    #[inline(always)]
    pub(super) fn of<'a>(&'a self, triangles: &'a [u32]) -> impl Iterator<Item = [u32; 4]> + 'a {
        let mut rest = triangles;
        std::iter::from_fn(move || match *rest {
            [a, b, c, e, f, d, ..] if [e, f] == [a, c] && self.diagonals[c as usize] == a => {
                rest = &rest[6..];
                Some([a, b, c, d])
            }
            [a, b, c, ..] => {
                rest = &rest[3..];
                Some([a, b, c, c])
            }
            _ => None,
        })
    }
}

/// Whether the corners, counter-clockwise, make a flat and convex quad with linear values.
fn is_quad<const N: usize>(corners: [([f32; 3], [f32; N]); 4], tolerance: f32) -> bool {
    let [a, b, c, d] = corners.map(|(position, _)| Vector3::from(position));
    let (across, up) = (b - a, d - a);
    let (ac, bd) = (c - a, d - b);
    let normal = across.cross(&up);
    let turns = [(across, c - b), (c - b, d - c), (d - c, a - d), (a - d, across)];
    let is_convex = turns.iter().all(|(from, to)| from.cross(to).dot(&normal) > 0.0);
    let size = ac.norm().max(bd.norm());
    if !is_convex || ac.dot(&normal).abs() > FLATNESS * size * normal.norm() {
        return false;
    }
    // As in `Plane`: through the mean of the corners, and changing along the diagonals as they do.
    let system = Matrix2::new(ac.dot(&ac), ac.dot(&bd), ac.dot(&bd), bd.dot(&bd));
    let Some(inverse) = system.try_inverse() else { return false };
    let centre = (a + b + c + d) / 4.0;
    let values = corners.map(|(_, values)| values);
    (0..N).all(|i| {
        let [va, vb, vc, vd] = values.map(|values| values[i]);
        let (along_ac, along_bd) = (vc - va, vd - vb);
        let mean = (va + vb + vc + vd) / 4.0;
        [(a, va), (b, vb), (c, vc), (d, vd)].into_iter().all(|(corner, value)| {
            let at = corner - centre;
            let share = inverse * Vector2::new(ac.dot(&at), bd.dot(&at));
            (mean + along_ac * share.x + along_bd * share.y - value).abs() <= tolerance
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    type Vertex = ([f32; 3], [f32; 1]);

    const SQUARE: [Vertex; 5] = [
        ([0.0, 0.0, 0.0], [10.0]),
        ([2.0, 0.0, 0.0], [20.0]),
        ([2.0, 2.0, 0.0], [26.0]),
        ([0.0, 2.0, 0.0], [16.0]),
        ([-1.0, 1.0, 0.0], [8.0]),
    ];

    fn faces(vertices: [Vertex; 5], indices: &[u32]) -> Vec<[u32; 4]> {
        let layer = TriangleLayer { vertices: vertices.to_vec(), indices: indices.to_vec() };
        Quads::new(&layer, |&vertex| vertex, 1.0).of(indices).collect()
    }

    #[test]
    fn triangles_of_a_fan_are_paired() {
        let fan = [0, 1, 2, 0, 2, 3, 0, 3, 4];
        assert_eq!(faces(SQUARE, &fan), [[0, 1, 2, 3], [0, 3, 4, 4]]);
        let apart = [0, 1, 2, 0, 3, 4, 0, 2, 3];
        assert_eq!(faces(SQUARE, &apart), [[0, 1, 2, 2], [0, 3, 4, 4], [0, 2, 3, 3]]);
    }

    #[test]
    fn what_is_not_flat_convex_or_linear_stays_in_triangles() {
        let changed = |corner: usize, vertex: Vertex| {
            let mut vertices = SQUARE;
            vertices[corner] = vertex;
            faces(vertices, &[0, 1, 2, 0, 2, 3]).len()
        };
        assert_eq!(changed(3, ([0.0, 2.0, 0.1], [16.0])), 2, "bent");
        assert_eq!(changed(1, ([0.9, 1.2, 0.0], [20.0])), 2, "dented");
        // A quarter of what the fourth corner is off is missed at each.
        assert_eq!(changed(3, SQUARE[3]), 1);
        assert_eq!([19.0, 21.0].map(|value| changed(3, ([0.0, 2.0, 0.0], [value]))), [1, 2]);
    }
}
