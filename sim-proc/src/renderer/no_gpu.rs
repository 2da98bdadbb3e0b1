//! Stands in for `gpu` in a build without the feature `wgpu`: there is no device.

use anyhow::{Result, bail};
use raster::{Geometry, PreparedView};

use super::job::Destination;
use super::settings::{RenderReport, RenderSettings};

/// A device. There is none.
pub(super) enum Gpu {}

/// Opens no adapter.
pub(super) fn open(_wanted: &str) -> Result<Gpu> {
    bail!("this program was built without wgpu and renders on the CPU only")
}

/// Finds no graphics card.
pub(super) fn open_graphics_card() -> Result<Option<Gpu>> {
    Ok(None)
}

/// Draws on a [`Gpu`].
pub(super) struct GpuBackend(Gpu);

impl GpuBackend {
    pub(super) fn new(gpu: Gpu, _geometry: &Geometry, _settings: &RenderSettings) -> Self {
        Self(gpu)
    }

    pub(super) fn report(&self) -> RenderReport {
        match self.0 {}
    }

    pub(super) fn forget_imports(&mut self) {}

    pub(super) fn draw(
        &mut self,
        _geometry: &Geometry,
        _views: &[PreparedView],
        _background: [f32; 3],
        _destinations: &mut [&mut Destination<'_>],
    ) -> Result<()> {
        match self.0 {}
    }
}
