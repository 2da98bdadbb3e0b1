//! The bytes that go to the device: vertices, instances and the view's uniform.
//!
//! Each struct has its twin in a shader; a test compares the two layouts.

use bytemuck::{Pod, Zeroable};

/// A corner of a lit triangle: `Corner` in `solid.wgsl`, without the instance's part.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct SolidVertex {
    pub(super) position: [f32; 3],
    /// Baked colour, and how much fog it takes.
    pub(super) colour: [u8; 4],
}

/// A corner of a label plate: `Corner` in `plate.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct PlateVertex {
    pub(super) position: [f32; 3],
    pub(super) across: [f32; 2],
    pub(super) code: u32,
}

/// A corner of a panel with text: `Corner` in `text.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct TextVertex {
    pub(super) position: [f32; 3],
    pub(super) atlas: [f32; 2],
    pub(super) ink: [u8; 4],
    pub(super) paper: [u8; 4],
}

/// Where a copy of a lit mesh stands.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct Placement {
    /// East and north, in metres.
    pub(super) at: [f32; 2],
    /// Cosine and sine of the turn about the upward axis.
    pub(super) turn: [f32; 2],
}

impl Placement {
    /// Where the mesh itself says.
    pub(super) const IDENTITY: Self = Self { at: [0.0, 0.0], turn: [1.0, 0.0] };
}

/// What the shaders know about a view: `View` in `view.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct ViewUniform {
    /// Column by column.
    pub(super) clip_from_world: [[f32; 4]; 4],
    pub(super) fog_rgb: [f32; 3],
    pub(super) fog_per_m: f32,
}

/// A vertex type with the attributes that its shader reads.
pub(super) trait Vertex: Pod {
    /// Attributes by shader location.
    const ATTRIBUTES: &'static [wgpu::VertexAttribute];
}

impl Vertex for SolidVertex {
    const ATTRIBUTES: &'static [wgpu::VertexAttribute] =
        &wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm8x4];
}

impl Vertex for PlateVertex {
    const ATTRIBUTES: &'static [wgpu::VertexAttribute] =
        &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Uint32];
}

impl Vertex for TextVertex {
    const ATTRIBUTES: &'static [wgpu::VertexAttribute] =
        &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Unorm8x4, 3 => Unorm8x4];
}

impl Vertex for Placement {
    const ATTRIBUTES: &'static [wgpu::VertexAttribute] = &wgpu::vertex_attr_array![2 => Float32x4];
}
