//! Three pipelines (lit, label plate, text) and the buffers of a batch of views.

use std::ops::Range;

use bytemuck::cast_slice;
use plates;
use raster::{
    Atlas, Geometry, Placement, PlateVertex, PreparedView, SolidVertex, TextVertex, TriangleLayer,
};
use wgpu::util::DeviceExt;

use super::device::Gpu;
use super::target::{COLOUR_FORMAT, DEPTH_FORMAT};
use super::vertex::{Vertex, ViewUniform};

/// The beginning of every shader.
pub(super) const VIEW_WGSL: &str = include_str!("shader/view.wgsl");
/// Shader of lit triangles.
pub(super) const SOLID_WGSL: &str = include_str!("shader/solid.wgsl");
/// Shader of label plates.
pub(super) const PLATE_WGSL: &str = include_str!("shader/plate.wgsl");
/// Shader of labels and signs.
pub(super) const TEXT_WGSL: &str = include_str!("shader/text.wgsl");

/// The distance between the uniforms of two views: an alignment that every device accepts.
const UNIFORM_STRIDE: usize = 256;

/// A pipeline and the static vertices that it draws.
struct Pass {
    pipeline: wgpu::RenderPipeline,
    vertices: wgpu::Buffer,
}

/// Everything on the device that stays the same.
pub(super) struct Pipelines {
    view_layout: wgpu::BindGroupLayout,
    solid: Pass,
    plate: Pass,
    text: Pass,
    atlas: wgpu::BindGroup,
}

impl Pipelines {
    pub(super) fn new(gpu: &Gpu, geometry: &Geometry, samples: u32) -> Self {
        let view_layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("view"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: true,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let (atlas_layout, atlas) = upload_atlas(gpu, &geometry.atlas);
        let plate_constants = [
            ("FRAME_SHARE", f64::from(plates::FRAME_M / plates::SIZE_M)),
            ("BANDS", plates::BANDS as f64),
        ];
        let one = [Some(&view_layout)];
        let two = [Some(&view_layout), Some(&atlas_layout)];
        Self {
            solid: Pass {
                pipeline: PipelinePlan {
                    name: "solid",
                    wgsl: SOLID_WGSL,
                    groups: &one,
                    buffers: &[vertices::<SolidVertex>(), instances::<Placement>()],
                    constants: &[],
                }
                .build(gpu, samples),
                vertices: upload(gpu, "solid", &geometry.solid),
            },
            plate: Pass {
                pipeline: PipelinePlan {
                    name: "plate",
                    wgsl: PLATE_WGSL,
                    groups: &one,
                    buffers: &[vertices::<PlateVertex>()],
                    constants: &plate_constants,
                }
                .build(gpu, samples),
                vertices: upload(gpu, "plate", &geometry.plate),
            },
            text: Pass {
                pipeline: PipelinePlan {
                    name: "text",
                    wgsl: TEXT_WGSL,
                    groups: &two,
                    buffers: &[vertices::<TextVertex>()],
                    constants: &[],
                }
                .build(gpu, samples),
                vertices: upload(gpu, "text", &geometry.text),
            },
            view_layout,
            atlas,
        }
    }
}

/// What differs from pipeline to pipeline.
struct PipelinePlan<'a> {
    name: &'a str,
    wgsl: &'a str,
    groups: &'a [Option<&'a wgpu::BindGroupLayout>],
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    constants: &'a [(&'a str, f64)],
}

impl PipelinePlan<'_> {
    fn build(&self, gpu: &Gpu, samples: u32) -> wgpu::RenderPipeline {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(self.name),
            source: wgpu::ShaderSource::Wgsl(format!("{VIEW_WGSL}{}", self.wgsl).into()),
        });
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(self.name),
            bind_group_layouts: self.groups,
            immediate_size: 0,
        });
        let constants =
            wgpu::PipelineCompilationOptions { constants: self.constants, ..Default::default() };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(self.name),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("corner"),
                compilation_options: constants.clone(),
                buffers: self.buffers,
            },
            primitive: wgpu::PrimitiveState {
                front_face: wgpu::FrontFace::Ccw,
                cull_mode: Some(wgpu::Face::Back),
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: wgpu::MultisampleState { count: samples, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("pixel"),
                compilation_options: constants,
                targets: &[Some(COLOUR_FORMAT.into())],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

fn vertices<V: Vertex>() -> Option<wgpu::VertexBufferLayout<'static>> {
    Some(wgpu::VertexBufferLayout {
        array_stride: size_of::<V>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: V::ATTRIBUTES,
    })
}

fn instances<V: Vertex>() -> Option<wgpu::VertexBufferLayout<'static>> {
    vertices::<V>().map(|layout| wgpu::VertexBufferLayout {
        step_mode: wgpu::VertexStepMode::Instance,
        ..layout
    })
}

fn upload<V: Vertex>(gpu: &Gpu, label: &str, layer: &TriangleLayer<V>) -> wgpu::Buffer {
    gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some(label),
        contents: cast_slice(&layer.vertices),
        usage: wgpu::BufferUsages::VERTEX,
    })
}

/// Uploads the text atlas as a texture with all its levels of detail.
fn upload_atlas(gpu: &Gpu, atlas: &Atlas) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("text atlas"),
        size: wgpu::Extent3d { width: atlas.width, height: atlas.height, depth_or_array_layers: 1 },
        mip_level_count: atlas.levels.len() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R8Unorm,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for (level, texels) in (0..).zip(&atlas.levels) {
        let (width, height) = (atlas.width >> level, atlas.height >> level);
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() },
            texels,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(width),
                rows_per_image: Some(height),
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
    }
    let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("text atlas"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Nearest,
        ..Default::default()
    });
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty,
        count: None,
    };
    let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("text atlas"),
        entries: &[
            entry(
                0,
                wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable: true },
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
            ),
            entry(1, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        ],
    });
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("text atlas"),
        layout: &layout,
        entries: &[
            wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&texture.create_view(&<_>::default())),
            },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
        ],
    });
    (layout, group)
}

/// What a view draws: ranges of the batch's buffers.
struct BatchView {
    solid: Range<u32>,
    barricade: Range<u32>,
    plate: Range<u32>,
    text: Range<u32>,
    placements: Range<u32>,
}

/// What a batch of views sends to the device: uniforms, indices of visible triangles, and placements of barricades.
pub(super) struct ViewBatch {
    uniforms: wgpu::Buffer,
    views: wgpu::BindGroup,
    indices: wgpu::Buffer,
    placements: wgpu::Buffer,
    list: Vec<BatchView>,
    uniform_bytes: Vec<u8>,
    index_list: Vec<u32>,
    placement_list: Vec<Placement>,
}

impl ViewBatch {
    pub(super) fn new(gpu: &Gpu, pipelines: &Pipelines, capacity: usize) -> Self {
        let uniforms = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("views"),
            size: (capacity * UNIFORM_STRIDE) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let views = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("views"),
            layout: &pipelines.view_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: &uniforms,
                    offset: 0,
                    size: std::num::NonZeroU64::new(size_of::<ViewUniform>() as u64),
                }),
            }],
        });
        Self {
            uniforms,
            views,
            indices: growable(gpu, "indices", 4 << 16, wgpu::BufferUsages::INDEX),
            placements: growable(gpu, "placements", 16 << 8, wgpu::BufferUsages::VERTEX),
            list: Vec::new(),
            uniform_bytes: Vec::new(),
            index_list: Vec::new(),
            placement_list: Vec::new(),
        }
    }

    /// Begins an empty batch.
    pub(super) fn clear(&mut self) {
        self.list.clear();
        self.uniform_bytes.clear();
        self.index_list.clear();
        self.placement_list.clear();
        self.placement_list.push(Placement::IDENTITY);
    }

    /// Adds a view of `geometry`.
    pub(super) fn push(&mut self, geometry: &Geometry, uniform: &ViewUniform, view: &PreparedView) {
        let PreparedView { list, barricades, .. } = view;
        self.uniform_bytes.resize(self.list.len() * UNIFORM_STRIDE, 0);
        self.uniform_bytes.extend_from_slice(bytemuck::bytes_of(uniform));
        let pieces = if barricades.is_empty() { 0..0 } else { geometry.barricade.clone() };
        let mut indices = |add: &[u32]| {
            let first = self.index_list.len() as u32;
            self.index_list.extend_from_slice(add);
            first..self.index_list.len() as u32
        };
        let (solid, plate, text) =
            (indices(&list.solid), indices(&list.plate), indices(&list.text));
        let barricade = indices(&geometry.solid.indices[pieces]);
        let first = self.placement_list.len() as u32;
        self.placement_list.extend_from_slice(barricades);
        let placements = first..self.placement_list.len() as u32;
        self.list.push(BatchView { solid, barricade, plate, text, placements });
    }

    /// Sends the batch's data to the device.
    pub(super) fn upload(&mut self, gpu: &Gpu) {
        let indices = cast_slice(&self.index_list);
        let placements = cast_slice(&self.placement_list);
        if indices.len() as u64 > self.indices.size() {
            let bytes = indices.len().next_power_of_two() as u64;
            self.indices = growable(gpu, "indices", bytes, wgpu::BufferUsages::INDEX);
        }
        if placements.len() as u64 > self.placements.size() {
            let bytes = placements.len().next_power_of_two() as u64;
            self.placements = growable(gpu, "placements", bytes, wgpu::BufferUsages::VERTEX);
        }
        gpu.queue.write_buffer(&self.uniforms, 0, &self.uniform_bytes);
        gpu.queue.write_buffer(&self.indices, 0, indices);
        gpu.queue.write_buffer(&self.placements, 0, placements);
    }

    /// Draws view number `index` of the batch.
    pub(super) fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        pipelines: &Pipelines,
        index: usize,
    ) {
        let view = &self.list[index];
        pass.set_bind_group(0, &self.views, &[(index * UNIFORM_STRIDE) as u32]);
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
        // What hangs in front is drawn first, so that little is drawn over.
        pass.set_pipeline(&pipelines.plate.pipeline);
        pass.set_vertex_buffer(0, pipelines.plate.vertices.slice(..));
        pass.draw_indexed(view.plate.clone(), 0, 0..1);
        pass.set_pipeline(&pipelines.text.pipeline);
        pass.set_bind_group(1, &pipelines.atlas, &[]);
        pass.set_vertex_buffer(0, pipelines.text.vertices.slice(..));
        pass.draw_indexed(view.text.clone(), 0, 0..1);
        pass.set_pipeline(&pipelines.solid.pipeline);
        pass.set_vertex_buffer(0, pipelines.solid.vertices.slice(..));
        pass.set_vertex_buffer(1, self.placements.slice(..));
        pass.draw_indexed(view.solid.clone(), 0, 0..1);
        pass.draw_indexed(view.barricade.clone(), 0, view.placements.clone());
    }
}

/// A buffer that is replaced by a larger one when it is too small.
fn growable(gpu: &Gpu, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
