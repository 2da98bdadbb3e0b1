//! Building blocks of meshes: boxes, bodies of revolution, tubes and polygons, with materials and normals.
//!
//! A [`Mesh`] has no light and no place in the world. The scene bakes both into its vertices.

use nalgebra::{Isometry3, Point3, Quaternion, Unit, UnitQuaternion, Vector3};

/// A point in the space of the mesh, in metres: x right, y away from the viewer, z up.
pub(crate) type MeshPoint = Point3<f32>;

/// A surface: its colour and how it reflects light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Material {
    /// Colour in sRGB.
    pub(crate) rgb: [u8; 3],
    /// Strength of the highlight: 0 is dull (cardboard), 1 glossy (lacquer).
    pub(crate) gloss: f32,
    /// Whether the surface emits light, so that light, shade and fog do not change it.
    pub(crate) glows: bool,
}

impl Material {
    /// A surface without highlight.
    pub(crate) const fn dull(rgb: [u8; 3]) -> Self {
        Self { rgb, gloss: 0.0, glows: false }
    }

    /// A surface with a highlight.
    pub(crate) const fn glossy(rgb: [u8; 3]) -> Self {
        Self { rgb, gloss: 0.6, glows: false }
    }

    /// A surface that emits light.
    pub(crate) const fn glowing(rgb: [u8; 3]) -> Self {
        Self { rgb, gloss: 0.0, glows: true }
    }

    /// The same surface, darker (below 1) or brighter (above 1).
    pub(crate) fn shaded(self, factor: f32) -> Self {
        Self { rgb: self.rgb.map(|c| (f32::from(c) * factor).round() as u8), ..self }
    }
}

/// What a mesh is part of. Determines the light that it stands in, and its tint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MeshPart {
    /// A bay, or the closed face of a rack. Positions are in the frame of the face.
    Rack,
    /// As [`MeshPart::Rack`], an item on the shelf of a bay.
    Item,
    /// Lit as a rack.
    Barricade,
    /// The floor, in the world.
    Floor,
    /// Walls and roof, in the world.
    Wall,
    /// What hangs or stands in the hall: lamps, signs, columns, gates, doors; in the world.
    Fixture,
}

/// A corner of a triangle, before light is baked in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeshVertex {
    pub(crate) position: MeshPoint,
    pub(crate) normal: Vector3<f32>,
    pub(crate) material: Material,
}

/// Triangles, counter-clockwise seen from outside.
#[derive(Debug, Clone, Default)]
pub(crate) struct Mesh {
    pub(crate) vertices: Vec<MeshVertex>,
    pub(crate) indices: Vec<u32>,
}

/// Level of detail of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Detail {
    /// For nearby views.
    Near,
    /// For views from several metres: fewer segments and no small parts.
    Far,
}

impl Detail {
    /// Both levels.
    #[cfg(test)]
    pub(crate) const ALL: [Self; 2] = [Self::Near, Self::Far];
}

/// Adds shapes to a mesh, in the current frame and material.
pub(crate) struct MeshBuilder {
    mesh: Mesh,
    mesh_from_local: Isometry3<f32>,
    material: Material,
    detail: Detail,
}

impl MeshBuilder {
    pub(crate) fn new(detail: Detail) -> Self {
        Self {
            detail,
            mesh: Mesh::default(),
            mesh_from_local: Isometry3::identity(),
            material: Material::dull([128; 3]),
        }
    }

    pub(crate) fn finish(self) -> Mesh {
        self.mesh
    }

    /// Adds a part that is too small for distant views.
    pub(crate) fn small(&mut self, draw: impl FnOnce(&mut Self)) {
        if self.detail == Detail::Near {
            draw(self);
        }
    }

    /// The number of segments at this level of detail of a round shape with `segments` at the finest.
    fn segments(&self, segments: u32) -> u32 {
        match self.detail {
            Detail::Near => segments,
            Detail::Far => (segments * 9 / 20).max(4),
        }
    }

    /// Sets the material of the shapes that follow.
    pub(crate) fn material(&mut self, material: Material) -> &mut Self {
        self.material = material;
        self
    }

    /// Adds shapes in a frame moved by (x, y, z) from the current one.
    pub(crate) fn moved(&mut self, [x, y, z]: [f32; 3], draw: impl FnOnce(&mut Self)) {
        self.framed(Isometry3::translation(x, y, z), draw);
    }

    /// Adds shapes in a frame rotated by `degrees` about `axis`, counter-clockwise seen against the axis.
    pub(crate) fn turned(
        &mut self,
        axis: Unit<Vector3<f32>>,
        degrees: f32,
        draw: impl FnOnce(&mut Self),
    ) {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        let rotation =
            UnitQuaternion::new_unchecked(Quaternion::from_parts(cos, axis.as_ref() * sin));
        self.framed(Isometry3::from_parts(Default::default(), rotation), draw);
    }

    fn framed(&mut self, outer_from_inner: Isometry3<f32>, draw: impl FnOnce(&mut Self)) {
        let outer = self.mesh_from_local;
        self.mesh_from_local = outer * outer_from_inner;
        draw(self);
        self.mesh_from_local = outer;
    }

    fn vertex(&mut self, position: MeshPoint, normal: Vector3<f32>) -> u32 {
        self.mesh.vertices.push(MeshVertex {
            position: self.mesh_from_local * position,
            normal: self.mesh_from_local * normal,
            material: self.material,
        });
        self.mesh.vertices.len() as u32 - 1
    }

    /// Adds a convex polygon, its corners counter-clockwise seen from the front.
    pub(crate) fn polygon(&mut self, corners: &[[f32; 3]]) {
        self.shaded_polygon(corners, |_| 1.0);
    }

    /// As [`Self::polygon`], with a factor of brightness at each corner.
    pub(crate) fn shaded_polygon(&mut self, corners: &[[f32; 3]], shade: impl Fn([f32; 3]) -> f32) {
        let points: Vec<MeshPoint> = corners.iter().map(|&c| MeshPoint::from(c)).collect();
        let normal = (points[1] - points[0]).cross(&(points[2] - points[0])).normalize();
        let first = self.mesh.vertices.len() as u32;
        let material = self.material;
        for (point, &corner) in points.into_iter().zip(corners) {
            self.material = material.shaded(shade(corner));
            self.vertex(point, normal);
        }
        self.material = material;
        for i in 1..corners.len() as u32 - 1 {
            self.mesh.indices.extend([first, first + i, first + i + 1]);
        }
    }

    /// Adds a box between two corners, without its `hidden` sides.
    pub(crate) fn block_without(&mut self, min: [f32; 3], max: [f32; 3], hidden: &[Side]) {
        let ([x0, y0, z0], [x1, y1, z1]) = (min, max);
        let faces = [
            (Side::Left, [[x0, y1, z0], [x0, y0, z0], [x0, y0, z1], [x0, y1, z1]]),
            (Side::Right, [[x1, y0, z0], [x1, y1, z0], [x1, y1, z1], [x1, y0, z1]]),
            (Side::Front, [[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]]),
            (Side::Back, [[x1, y1, z0], [x0, y1, z0], [x0, y1, z1], [x1, y1, z1]]),
            (Side::Bottom, [[x0, y1, z0], [x1, y1, z0], [x1, y0, z0], [x0, y0, z0]]),
            (Side::Top, [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]]),
        ];
        for (side, corners) in faces {
            if !hidden.contains(&side) {
                self.polygon(&corners);
            }
        }
    }

    /// Adds a box between two corners, without its bottom.
    pub(crate) fn block(&mut self, min: [f32; 3], max: [f32; 3]) {
        self.block_without(min, max, &[Side::Bottom]);
    }

    /// Adds a box whose vertical and upper edges are bevelled by `bevel` metres.
    pub(crate) fn bevelled(&mut self, min: [f32; 3], max: [f32; 3], bevel: f32) {
        if self.detail == Detail::Far {
            return self.block(min, max);
        }
        let ([x0, y0, z0], [x1, y1, z1]) = (min, max);
        let outline = |inset: f32, z: f32| {
            let (l, r, f, b) = (x0 + inset, x1 - inset, y0 + inset, y1 - inset);
            [
                [l + bevel, f, z],
                [r - bevel, f, z],
                [r, f + bevel, z],
                [r, b - bevel, z],
                [r - bevel, b, z],
                [l + bevel, b, z],
                [l, b - bevel, z],
                [l, f + bevel, z],
            ]
        };
        let (low, high, top) = (outline(0.0, z0), outline(0.0, z1 - bevel), outline(bevel, z1));
        for i in 0..8 {
            let j = (i + 1) % 8;
            self.polygon(&[low[i], low[j], high[j], high[i]]);
            self.polygon(&[high[i], high[j], top[j], top[i]]);
        }
        self.polygon(&top);
    }

    /// Adds a prism: a convex `outline` (x, z), counter-clockwise seen from the front, from y0 to y1.
    pub(crate) fn prism(&mut self, outline: &[[f32; 2]], y0: f32, y1: f32) {
        let front: Vec<[f32; 3]> = outline.iter().map(|&[x, z]| [x, y0, z]).collect();
        let back: Vec<[f32; 3]> = outline.iter().rev().map(|&[x, z]| [x, y1, z]).collect();
        self.polygon(&front);
        self.polygon(&back);
        for (i, &[x, z]) in outline.iter().enumerate() {
            let [u, w] = outline[(i + 1) % outline.len()];
            self.polygon(&[[x, y1, z], [u, y1, w], [u, y0, w], [x, y0, z]]);
        }
    }

    /// Adds a body of revolution about the z axis. `profile` lists (radius, height) from bottom to top, with the outside
    /// on the right; segments meet in edges. Radius 0 closes the body.
    pub(crate) fn turned_body(&mut self, profile: &[[f32; 2]], segments: u32) {
        for pair in profile.windows(2) {
            let ([r0, z0], [r1, z1]) = (pair[0], pair[1]);
            let (rise, run) = (z1 - z0, r1 - r0);
            let length = rise.hypot(run);
            if length < 1e-6 {
                continue;
            }
            let normals = [[rise / length, -run / length]; 2];
            self.ring([pair[0], pair[1]], normals, segments);
        }
    }

    /// As [`Self::turned_body`], with smooth transitions between segments.
    pub(crate) fn smooth_body(&mut self, profile: &[[f32; 2]], segments: u32) {
        let slope = |i: usize, j: usize| {
            let (run, rise) = (profile[j][0] - profile[i][0], profile[j][1] - profile[i][1]);
            let length = rise.hypot(run).max(1e-6);
            [rise / length, -run / length]
        };
        let last = profile.len() - 1;
        let normals: Vec<[f32; 2]> = (0..=last)
            .map(|i| {
                let [a, b] =
                    [slope(i.max(1) - 1, i.max(1)), slope(i.min(last - 1), i.min(last - 1) + 1)];
                let sum = [a[0] + b[0], a[1] + b[1]];
                let length = sum[0].hypot(sum[1]).max(1e-6);
                sum.map(|c| c / length)
            })
            .collect();
        for i in 0..last {
            self.ring([profile[i], profile[i + 1]], [normals[i], normals[i + 1]], segments);
        }
    }

    /// Adds a segment of a body of revolution, with a normal (outward, up) at each end.
    fn ring(&mut self, ends: [[f32; 2]; 2], normals: [[f32; 2]; 2], segments: u32) {
        let segments = self.segments(segments);
        let first = self.mesh.vertices.len() as u32;
        for i in 0..=segments {
            let angle = (i % segments) as f32 / segments as f32 * std::f32::consts::TAU;
            let (sin, cos) = angle.sin_cos();
            for ([radius, z], [out, up]) in ends.into_iter().zip(normals) {
                let position = MeshPoint::new(radius * cos, radius * sin, z);
                self.vertex(position, Vector3::new(out * cos, out * sin, up));
            }
        }
        for i in 0..segments {
            let (low, high) = (first + 2 * i, first + 2 * i + 1);
            if ends[0][0] > 0.0 {
                self.mesh.indices.extend([low, low + 2, high + 2]);
            }
            if ends[1][0] > 0.0 {
                self.mesh.indices.extend([low, high + 2, high]);
            }
        }
    }

    /// Adds a bar through `path` with `sides` sides and flat ends.
    pub(crate) fn tube(&mut self, path: &[[f32; 3]], radius: f32, sides: u32) {
        let sides = if self.detail == Detail::Far { 3 } else { sides };
        let points: Vec<MeshPoint> = path.iter().map(|&p| MeshPoint::from(p)).collect();
        let last = points.len() - 1;
        let direction = |i: usize| {
            let (from, to) = (i.max(1) - 1, (i + 1).min(last));
            (points[to] - points[from]).normalize()
        };
        // A fixed reference direction, as far from the path's as possible, keeps the sides from twisting.
        let span = points[last] - points[0];
        let reference = [Vector3::y(), Vector3::x(), Vector3::z()]
            .into_iter()
            .min_by(|a, b| {
                let along = |axis: &Vector3<f32>| {
                    points.windows(2).map(|w| (w[1] - w[0]).dot(axis).abs()).sum::<f32>()
                };
                along(a).total_cmp(&along(b))
            })
            .unwrap_or(span);
        let mut first = Vec::new();
        for (i, &point) in points.iter().enumerate() {
            let along = direction(i);
            let side = along.cross(&reference).normalize();
            let up = side.cross(&along);
            let around: Vec<Vector3<f32>> = (0..sides)
                .map(|k| {
                    let angle = k as f32 / sides as f32 * std::f32::consts::TAU;
                    side * angle.cos() + up * angle.sin()
                })
                .collect();
            first.push(self.mesh.vertices.len() as u32);
            for normal in &around {
                self.vertex(point + normal * radius, *normal);
            }
            let rim = around.iter().map(|normal| (point + normal * radius).into());
            if i == 0 {
                self.polygon(&rim.collect::<Vec<_>>());
            } else if i == last {
                self.polygon(&rim.rev().collect::<Vec<_>>());
            }
        }
        for pair in first.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            for k in 0..sides {
                let l = (k + 1) % sides;
                self.mesh.indices.extend([a + k, b + k, b + l, a + k, b + l, a + l]);
            }
        }
    }
}

/// A side of a box, as seen from the front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// Towards smaller x.
    Left,
    /// Towards larger x.
    Right,
    /// Towards smaller y, the viewer.
    Front,
    /// Towards larger y.
    Back,
    /// Towards smaller z.
    Bottom,
    /// Towards larger z.
    Top,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that every triangle faces the same way as the normals of its corners.
    fn assert_faces_outward(name: &str, draw: impl Fn(&mut MeshBuilder)) {
        for detail in Detail::ALL {
            let mut builder = MeshBuilder::new(detail);
            builder.moved([0.3, -0.2, 0.1], |b| b.turned(Vector3::x_axis(), 30.0, &draw));
            let mesh = builder.finish();
            assert!(!mesh.indices.is_empty());
            for corners in mesh.indices.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|i| mesh.vertices[corners[i] as usize]);
                let winding = (b.position - a.position).cross(&(c.position - a.position));
                let normal = a.normal + b.normal + c.normal;
                assert!(winding.norm() > 1e-9, "{name}: a triangle without area");
                assert!(winding.dot(&normal) > 0.0, "{name}: a triangle faces inward");
            }
        }
    }

    #[test]
    fn shapes_face_outward() {
        assert_faces_outward("block", |b| b.block_without([0.0; 3], [1.0, 2.0, 3.0], &[]));
        assert_faces_outward("bevelled", |b| b.bevelled([0.0; 3], [1.0, 2.0, 3.0], 0.1));
        assert_faces_outward("prism", |b| {
            b.prism(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 0.0, 0.5);
        });
        assert_faces_outward("turned", |b| {
            b.turned_body(&[[0.0, 0.0], [1.0, 0.0], [0.5, 1.0], [0.0, 1.0]], 12);
        });
        assert_faces_outward("smooth", |b| {
            b.smooth_body(&[[0.0, 0.0], [1.0, 0.5], [0.5, 1.0], [0.0, 1.2]], 12);
        });
        assert_faces_outward("tube", |b| {
            b.tube(&[[0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 1.2], [1.0, 0.0, 0.0]], 0.1, 6);
        });
    }
}
