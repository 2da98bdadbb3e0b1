//! A scene under construction: meshes, plates and texts are added object by object.

use std::ops::Range;

use nalgebra::{Isometry3, Point3};
use plates::{self, Plate};

use super::{Layer, Object, Scene, Screen};
use crate::renderer::light::{Light, baked};
use crate::renderer::mesh::builder::Mesh;
use crate::renderer::mesh::hall::barricade;
use crate::renderer::text::{AtlasPlan, Lettering};
use crate::renderer::vertex::{PlateVertex, SolidVertex, TextVertex};

/// What stands on a panel, and in which colours.
pub(super) struct Writing<'a> {
    pub(super) text: &'a str,
    pub(super) ink: [u8; 3],
    pub(super) paper: [u8; 3],
    /// How finely it is drawn.
    pub(super) texels_per_m: f32,
}

/// A panel of text before the atlas is drawn.
struct PanelCorner {
    vertex: TextVertex,
    texel: [u32; 2],
}

/// A scene under construction.
#[derive(Default)]
pub(super) struct Assembly {
    solid: Layer<SolidVertex>,
    plate: Layer<PlateVertex>,
    text: Layer<PanelCorner>,
    objects: Vec<Object>,
    screens: Vec<Screen>,
    barricade: Range<usize>,
    atlas: AtlasPlan,
}

impl Assembly {
    /// Everything that `draw` adds is one object.
    pub(super) fn object(&mut self, draw: impl FnOnce(&mut Self)) {
        let counts =
            |a: &Self| [a.solid.vertices.len(), a.plate.vertices.len(), a.text.vertices.len()];
        let ends = |a: &Self| [a.solid.indices.len(), a.plate.indices.len(), a.text.indices.len()];
        let (first, start) = (counts(self), ends(self));
        draw(self);
        let end = ends(self);
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let solid = self.solid.vertices[first[0]..].iter().map(|v| v.position);
        let plate = self.plate.vertices[first[1]..].iter().map(|v| v.position);
        let text = self.text.vertices[first[2]..].iter().map(|v| v.vertex.position);
        for position in solid.chain(plate).chain(text) {
            for axis in 0..3 {
                min[axis] = min[axis].min(position[axis]);
                max[axis] = max[axis].max(position[axis]);
            }
        }
        self.objects.push(Object {
            min,
            max,
            near: start[0]..end[0],
            far: start[0]..end[0],
            plate: start[1]..end[1],
            text: start[2]..end[2],
        });
    }

    /// As [`Self::object`], with other lit meshes when seen from afar: those that `far` adds. Both lie
    /// within the same bounds.
    pub(super) fn object_with_far(
        &mut self,
        draw: impl FnOnce(&mut Self),
        far: impl FnOnce(&mut Self),
    ) {
        self.object(draw);
        let start = self.solid.indices.len();
        far(self);
        let end = self.solid.indices.len();
        if let Some(object) = self.objects.last_mut() {
            object.far = start..end;
        }
    }

    pub(super) fn solid(&mut self, mesh: &Mesh, world_from_mesh: &Isometry3<f32>, light: Light) {
        let first = self.solid.vertices.len() as u32;
        self.solid.vertices.extend(mesh.vertices.iter().map(|vertex| SolidVertex {
            position: (world_from_mesh * vertex.position).into(),
            colour: baked(vertex, light),
        }));
        self.solid.indices.extend(mesh.indices.iter().map(|index| first + index));
    }

    /// A rectangle in a face's frame, `out` metres in front of it: its corners from the bottom left,
    /// counter-clockwise.
    fn panel(world_from_face: &Isometry3<f32>, [l, b, r, t]: [f32; 4], out: f32) -> [[f32; 3]; 4] {
        [[l, b], [r, b], [r, t], [l, t]]
            .map(|[x, z]| (world_from_face * Point3::new(x, -out, z)).into())
    }

    pub(super) fn plate(&mut self, world_from_face: &Isometry3<f32>, plate: Plate) {
        let (half, centre) = (plates::SIZE_M / 2.0, plates::CENTRE_HEIGHT_M);
        let rect = [-half, centre - half, half, centre + half];
        let code = plate_code(plate);
        let first = self.plate.vertices.len() as u32;
        let across = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        for (position, across) in
            Self::panel(world_from_face, rect, plates::FACE_OFFSET_M).into_iter().zip(across)
        {
            self.plate.vertices.push(PlateVertex { position, across, code });
        }
        self.plate.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
    }

    pub(super) fn text(
        &mut self,
        world_from_face: &Isometry3<f32>,
        rect: [f32; 4],
        out: f32,
        writing: &Writing<'_>,
    ) {
        let texels = |metres: f32| (metres * writing.texels_per_m).round() as u32;
        let size = [texels(rect[2] - rect[0]), texels(rect[3] - rect[1])];
        let [l, t, r, b] = self.atlas.rect(Lettering { text: writing.text.to_owned(), size });
        let opaque = |[r, g, b]: [u8; 3]| [r, g, b, 255];
        let first = self.text.vertices.len() as u32;
        for (position, texel) in Self::panel(world_from_face, rect, out).into_iter().zip([
            [l, b],
            [r, b],
            [r, t],
            [l, t],
        ]) {
            let vertex = TextVertex {
                position,
                atlas: [0.0; 2],
                ink: opaque(writing.ink),
                paper: opaque(writing.paper),
            };
            self.text.vertices.push(PanelCorner { vertex, texel });
        }
        self.text.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
    }

    /// Notes an upright sheet that hides what is behind it; ends in the face's frame.
    pub(super) fn screen(&mut self, frame: &Isometry3<f32>, from: [f32; 2], to: [f32; 2]) {
        let at = |[x, y]: [f32; 2]| {
            let point = frame * Point3::new(x, y, 0.0);
            [point.x, point.y]
        };
        self.screens.push(Screen { from: at(from), to: at(to) });
    }

    /// Draws the atlas and hands over.
    pub(super) fn finish(mut self) -> Scene {
        let first = self.solid.indices.len();
        self.solid(&barricade(), &Isometry3::identity(), Light::Bay);
        self.barricade = first..self.solid.indices.len();
        let planes = planes(&self.solid);
        let atlas = self.atlas.draw();
        let text = self.text.vertices.into_iter().map(|corner| {
            let [u, v, ..] = atlas.share([corner.texel[0], corner.texel[1], 0, 0]);
            TextVertex { atlas: [u, v], ..corner.vertex }
        });
        Scene {
            solid: self.solid,
            planes,
            plate: self.plate,
            text: Layer { vertices: text.collect(), indices: self.text.indices },
            objects: self.objects,
            screens: self.screens,
            barricade: self.barricade,
            atlas,
        }
    }
}

/// Three bits a band (red, green, blue), the top band lowest, then the frame's.
fn plate_code(plate: Plate) -> u32 {
    let bits = |rgb: [u8; 3]| {
        let [r, g, b] = rgb.map(|channel| u32::from(channel == 255));
        r | g << 1 | b << 2
    };
    let bands = plate.0.map(|band| plates::BAND_RGB[usize::from(band)]);
    let all = bands.into_iter().chain([plates::FRAME_RGB]);
    all.enumerate().map(|(place, rgb)| bits(rgb) << (3 * place)).sum()
}

/// The plane of every triangle: its unit normal, and the normal's product with any of its points.
fn planes(layer: &Layer<SolidVertex>) -> Vec<[f32; 4]> {
    let triangle = |corners: &[u32]| {
        let [a, b, c] =
            [0, 1, 2].map(|i| Point3::from(layer.vertices[corners[i] as usize].position));
        let normal = (b - a).cross(&(c - a)).normalize();
        [normal.x, normal.y, normal.z, normal.dot(&a.coords)]
    };
    layer.indices.chunks_exact(3).map(triangle).collect()
}
