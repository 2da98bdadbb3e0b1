//! What shaders read: vertex attributes and the uniform of a view. A test compares each layout with its shader's.

use bytemuck::{Pod, Zeroable};
use raster::{Placement, PlateVertex, SolidVertex, TextVertex};

/// What shaders know about a view: `View` in `view.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct ViewUniform {
    /// Column by column.
    pub(super) clip_from_world: [[f32; 4]; 4],
    pub(super) fog_rgb: [f32; 3],
    pub(super) fog_per_m: f32,
}

/// A vertex type and the attributes that its shader reads.
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
