//! A scene under construction: meshes, label plates and texts are added object by object.

use std::sync::OnceLock;

use domain::Appearance;
use nalgebra::{Isometry3, Point3};
use plates::Plate;
use raster::{Atlas, Geometry, PlateVertex, SolidVertex, TextVertex, TriangleLayer};

use super::object::{Scene, SceneObject, StockObjects, bounds};
use crate::renderer::light::baked;
use crate::renderer::look::Look;
use crate::renderer::mesh::builder::Mesh;
use crate::renderer::mesh::builder::MeshPart;
use crate::renderer::mesh::hall::barricade;
use crate::renderer::text::{AtlasBuilder, PanelText};

/// Indices of a text's panel.
pub(super) const PANEL_INDICES: usize = 6;

/// A text and its colours.
pub(super) struct Label<'a> {
    pub(super) text: &'a str,
    pub(super) ink: [u8; 3],
    pub(super) paper: [u8; 3],
    /// Resolution in the atlas.
    pub(super) texels_per_m: f32,
}

/// A corner of a text panel before the size of the atlas is known.
struct PanelCorner {
    vertex: TextVertex,
    texel: [u32; 2],
}

/// A scene under construction.
pub(super) struct Assembly {
    appearance: Appearance,
    look: Look,
    solid: TriangleLayer<SolidVertex>,
    plate: TriangleLayer<PlateVertex>,
    text: TriangleLayer<PanelCorner>,
    objects: Vec<SceneObject>,
    atlas: AtlasBuilder,
}

impl Assembly {
    /// An empty scene.
    pub(super) fn new(appearance: Appearance) -> Self {
        Self {
            appearance,
            look: Look::of(appearance.seed),
            solid: TriangleLayer::default(),
            plate: TriangleLayer::default(),
            text: TriangleLayer::default(),
            objects: Vec::new(),
            atlas: AtlasBuilder::default(),
        }
    }

    /// How the world looks.
    pub(super) fn appearance(&self) -> Appearance {
        self.appearance
    }

    /// All objects so far, as a stock.
    pub(super) fn stock(&self) -> StockObjects {
        let objects = (0..self.objects.len() as u32).collect();
        StockObjects { objects, ..StockObjects::default() }
    }

    /// Makes everything that `add` adds one object, and returns its index.
    pub(super) fn object(&mut self, add: impl FnOnce(&mut Self)) -> u32 {
        let counts =
            |a: &Self| [a.solid.vertices.len(), a.plate.vertices.len(), a.text.vertices.len()];
        let ends = |a: &Self| [a.solid.indices.len(), a.plate.indices.len(), a.text.indices.len()];
        let (first, start) = (counts(self), ends(self));
        add(self);
        let end = ends(self);
        let solid = self.solid.vertices[first[0]..].iter().map(|v| v.position);
        let plate = self.plate.vertices[first[1]..].iter().map(|v| v.position);
        let text = self.text.vertices[first[2]..].iter().map(|v| v.vertex.position);
        let [min, max] = bounds(solid.chain(plate).chain(text));
        self.objects.push(SceneObject {
            min,
            max,
            near: start[0]..end[0],
            far: start[0]..end[0],
            plate: start[1]..end[1],
            text: start[2]..end[2],
            item: [0; 3],
        });
        self.objects.len() as u32 - 1
    }

    /// As [`Self::object`], with the lit meshes of `far` in place of those of `near` when seen from several metres. Both
    /// have the same bounds.
    pub(super) fn object_with_far(
        &mut self,
        near: impl FnOnce(&mut Self),
        far: impl FnOnce(&mut Self),
    ) -> u32 {
        let object = self.object(near);
        let start = self.solid.indices.len();
        far(self);
        let end = self.solid.indices.len();
        self.objects[object as usize].far = start..end;
        object
    }

    /// Notes which indices at the beginning of `object`'s are those of the item in it, as in [`SceneObject::item`].
    pub(super) fn note_item(&mut self, object: u32, item: [usize; 3]) {
        self.objects[object as usize].item = item;
    }

    /// Adds a mesh, lit.
    pub(super) fn solid(&mut self, mesh: &Mesh, world_from_mesh: &Isometry3<f32>, part: MeshPart) {
        let first = self.solid.vertices.len() as u32;
        self.solid.vertices.extend(mesh.vertices.iter().map(|vertex| SolidVertex {
            position: (world_from_mesh * vertex.position).into(),
            colour: baked(vertex, part, &self.look),
        }));
        self.solid.indices.extend(mesh.indices.iter().map(|index| first + index));
    }

    /// The corners of a rectangle `out` metres in front of a face, counter-clockwise from the bottom left.
    fn panel(world_from_face: &Isometry3<f32>, [l, b, r, t]: [f32; 4], out: f32) -> [[f32; 3]; 4] {
        [[l, b], [r, b], [r, t], [l, t]]
            .map(|[x, z]| (world_from_face * Point3::new(x, -out, z)).into())
    }

    /// Adds a label plate above the face, if the world has plates.
    pub(super) fn plate(&mut self, world_from_face: &Isometry3<f32>, plate: Plate) {
        if !self.appearance.plates {
            return;
        }
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

    /// Keeps the texts to come from changing a pixel of those so far.
    pub(super) fn separate_texts(&mut self) {
        self.atlas.leave_gap();
    }

    /// Reserves the text's place in the atlas, if it has none. Returns the place in texels: left, top, right, bottom.
    pub(super) fn reserve_text(&mut self, rect: [f32; 4], label: &Label<'_>) -> [u32; 4] {
        let texels = |metres: f32| (metres * label.texels_per_m).round() as u32;
        let size = [texels(rect[2] - rect[0]), texels(rect[3] - rect[1])];
        self.atlas.rect(PanelText { text: label.text.to_owned(), size })
    }

    /// Adds a panel with text, `out` metres in front of the face, if the world has labels.
    pub(super) fn text(
        &mut self,
        world_from_face: &Isometry3<f32>,
        rect: [f32; 4],
        out: f32,
        label: &Label<'_>,
    ) {
        if !self.appearance.labels {
            return;
        }
        let [l, t, r, b] = self.reserve_text(rect, label);
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
                ink: opaque(label.ink),
                paper: opaque(label.paper),
            };
            self.text.vertices.push(PanelCorner { vertex, texel });
        }
        let panel: [u32; PANEL_INDICES] = [0, 1, 2, 0, 2, 3];
        self.text.indices.extend(panel.map(|i| first + i));
    }

    /// Draws the atlas and completes the scene.
    pub(super) fn finish(mut self, stocks: Vec<StockObjects>) -> Scene {
        let first = self.solid.indices.len();
        self.solid(&barricade(), &Isometry3::identity(), MeshPart::Barricade);
        let barricade = first..self.solid.indices.len();
        let planes = planes(&self.solid);
        let atlas = self.atlas.draw();
        let share = |[x, y]: [u32; 2], Atlas { width, height, .. }: &Atlas| {
            [x as f32 / *width as f32, y as f32 / *height as f32]
        };
        let text = self.text.vertices.into_iter();
        let text =
            text.map(|corner| TextVertex { atlas: share(corner.texel, &atlas), ..corner.vertex });
        let text = TriangleLayer { vertices: text.collect(), indices: self.text.indices };
        Scene {
            geometry: Geometry { solid: self.solid, plate: self.plate, text, atlas, barricade },
            planes,
            objects: self.objects,
            stocks,
            packed: OnceLock::new(),
        }
    }
}

/// The colours of a plate, three bits (red, green, blue) per band from the lowest bits and the top band on, then three
/// for the frame.
fn plate_code(plate: Plate) -> u32 {
    let bits = |rgb: [u8; 3]| {
        let [r, g, b] = rgb.map(|channel| u32::from(channel == 255));
        r | g << 1 | b << 2
    };
    let bands = plate.0.map(|band| plates::BAND_RGB[usize::from(band)]);
    let all = bands.into_iter().chain([plates::FRAME_RGB]);
    all.enumerate().map(|(place, rgb)| bits(rgb) << (3 * place)).sum()
}

/// The plane of every triangle, as in [`Scene::planes`].
fn planes(layer: &TriangleLayer<SolidVertex>) -> Vec<[f32; 4]> {
    let at = |corner: u32| Point3::from(layer.vertices[corner as usize].position);
    let triangle = |&[a, b, c]: &[u32; 3]| {
        let (a, b, c) = (at(a), at(b), at(c));
        let normal = (b - a).cross(&(c - a)).normalize();
        [normal.x, normal.y, normal.z, normal.dot(&a.coords)]
    };
    layer.indices.as_chunks().0.iter().map(triangle).collect()
}
