//! Triangles as the renderer's scene stores them and both of its backends draw them.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};

/// Nothing nearer to the camera than this is drawn, in metres.
pub const NEAR_M: f32 = 0.05;

/// The colour that fog adds, as sRGB in 0..1.
pub const FOG_RGB: [f32; 3] = [0.80, 0.825, 0.845];

/// The share of fog that each metre of distance adds.
pub const FOG_PER_M: f32 = 0.011;

/// A corner of a lit triangle.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SolidVertex {
    /// In metres.
    pub position: [f32; 3],
    /// Colour with light baked in; alpha is the share of fog that the surface takes.
    pub colour: [u8; 4],
}

/// A corner of a label plate.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct PlateVertex {
    /// In metres.
    pub position: [f32; 3],
    /// Position on the plate: (0, 0) is its top left corner, (1, 1) its bottom right.
    pub across: [f32; 2],
    /// Colours of bands and frame, three bits each.
    pub code: u32,
}

/// A corner of a panel with text.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TextVertex {
    /// In metres.
    pub position: [f32; 3],
    /// Position in the text atlas, as shares of its width and height.
    pub atlas: [f32; 2],
    /// Colour of the letters, RGBA.
    pub ink: [u8; 4],
    /// Colour of the panel, RGBA.
    pub paper: [u8; 4],
}

/// Where an instance of a lit mesh stands.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Placement {
    /// East and north, in metres.
    pub at: [f32; 2],
    /// Cosine and sine of the rotation about the vertical axis.
    pub turn: [f32; 2],
}

impl Placement {
    /// Leaves a mesh where its vertices say.
    pub const IDENTITY: Self = Self { at: [0.0, 0.0], turn: [1.0, 0.0] };
}

/// Indexed triangles with one kind of vertex.
#[derive(Debug, Clone)]
pub struct TriangleLayer<V> {
    /// Vertices.
    pub vertices: Vec<V>,
    /// Three vertex indices for each triangle, counter-clockwise seen from its front.
    pub indices: Vec<u32>,
}

impl<V> Default for TriangleLayer<V> {
    fn default() -> Self {
        Self { vertices: Vec::new(), indices: Vec::new() }
    }
}

/// The texts of a scene as coverage values, one byte per texel.
#[derive(Debug, Clone, Default)]
pub struct Atlas {
    /// Width of the finest level, in texels.
    pub width: u32,
    /// Height of the finest level, in texels.
    pub height: u32,
    /// Levels of detail, each half as wide and high as the one before.
    pub levels: Vec<Vec<u8>>,
}

/// All triangles of a scene.
#[derive(Debug, Clone, Default)]
pub struct Geometry {
    /// Lit triangles.
    pub solid: TriangleLayer<SolidVertex>,
    /// Label plates.
    pub plate: TriangleLayer<PlateVertex>,
    /// Panels with text.
    pub text: TriangleLayer<TextVertex>,
    /// What is written on the panels.
    pub atlas: Atlas,
    /// Indices, in the solid layer, of one side of a barricade. Views place instances of it.
    pub barricade: Range<usize>,
}

impl Geometry {
    /// Bytes of all triangles and of the atlas.
    pub fn bytes(&self) -> usize {
        let layer = |vertices: usize, indices: &[u32]| vertices + size_of_val(indices);
        layer(size_of_val(&self.solid.vertices[..]), &self.solid.indices)
            + layer(size_of_val(&self.plate.vertices[..]), &self.plate.indices)
            + layer(size_of_val(&self.text.vertices[..]), &self.text.indices)
            + self.atlas.levels.iter().map(Vec::len).sum::<usize>()
    }
}

/// The vertex indices of the triangles that a view draws, layer by layer.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawList {
    /// Lit triangles.
    pub solid: Vec<u32>,
    /// Label plates.
    pub plate: Vec<u32>,
    /// Panels with text.
    pub text: Vec<u32>,
}

/// Everything a backend needs to draw a view.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedView {
    /// Column by column. Depth is reversed: 1 at [`NEAR_M`], 0 infinitely far away.
    pub clip_from_world: [[f32; 4]; 4],
    /// Visible triangles.
    pub list: DrawList,
    /// Sides of barricades.
    pub barricades: Vec<Placement>,
}
