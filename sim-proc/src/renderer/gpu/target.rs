//! The textures that views are drawn on: colour, depth, and the single-sampled result.

use super::device::Gpu;

/// Bytes of a pixel: red, green, blue and alpha, 8 bits each.
const BYTES_PER_PIXEL: u64 = 4;

/// Colour is stored as it is read, without conversion, so that the colours of label plates stay exact.
pub(super) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Depth is reversed (1 near, 0 infinitely far), which distributes the precision of a float evenly.
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A set of attachments, used by the views of a batch in turn.
pub(super) struct RenderTarget {
    width_px: u32,
    height_px: u32,
    /// The finished frame.
    result: wgpu::Texture,
    result_view: wgpu::TextureView,
    /// Multisampled colour, resolved into the result; `None` without anti-aliasing.
    multisampled: Option<wgpu::TextureView>,
    depth: wgpu::TextureView,
}

impl RenderTarget {
    pub(super) fn new(gpu: &Gpu, width_px: u32, height_px: u32, samples: u32) -> Self {
        let texture = |label, format, sample_count, extra_usage| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: extent(width_px, height_px),
                mip_level_count: 1,
                sample_count,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | extra_usage,
                view_formats: &[],
            })
        };
        let (none, copies) = (
            wgpu::TextureUsages::empty(),
            wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST,
        );
        let result = texture("frame", COLOUR_FORMAT, 1, copies);
        let multisampled = (samples > 1)
            .then(|| texture("samples", COLOUR_FORMAT, samples, none).create_view(&<_>::default()));
        let depth = texture("depth", DEPTH_FORMAT, samples, none).create_view(&<_>::default());
        let result_view = result.create_view(&<_>::default());
        Self { width_px, height_px, result, result_view, multisampled, depth }
    }

    /// Bytes of a finished frame.
    pub(super) fn frame_bytes(&self) -> u64 {
        u64::from(self.width_px) * u64::from(self.height_px) * BYTES_PER_PIXEL
    }

    /// Begins a render pass that clears colour to `background` and depth to infinity.
    pub(super) fn begin<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        background: wgpu::Color,
    ) -> wgpu::RenderPass<'e> {
        let (view, resolve_target, store) = match &self.multisampled {
            Some(samples) => (samples, Some(&self.result_view), wgpu::StoreOp::Discard),
            None => (&self.result_view, None, wgpu::StoreOp::Store),
        };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("view"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(background), store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }

    /// Records the copy of the finished frame into `buffer`, in rows from the top without gaps.
    pub(super) fn copy_to(&self, encoder: &mut wgpu::CommandEncoder, buffer: &wgpu::Buffer) {
        encoder.copy_texture_to_buffer(
            self.result.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer, layout: self.layout() },
            extent(self.width_px, self.height_px),
        );
    }

    /// Replaces the finished frame by these pixels.
    pub(super) fn fill(&self, gpu: &Gpu, pixels: &[u8]) {
        let (layout, size) = (self.layout(), extent(self.width_px, self.height_px));
        gpu.queue.write_texture(self.result.as_image_copy(), pixels, layout, size);
    }

    fn layout(&self) -> wgpu::TexelCopyBufferLayout {
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(self.width_px * BYTES_PER_PIXEL as u32),
            rows_per_image: Some(self.height_px),
        }
    }
}

fn extent(width: u32, height: u32) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}
