//! Views of any world of a run, one at a time.

use anyhow::{Context, Result, ensure};
use domain::Pose;
use png_file::RgbaImage;

use crate::renderer::{RenderSettings, Renderer, ViewSpec};
use crate::worlds::Worlds;

/// The worlds of a run, and their renderers: one for the tested hall, and one for the hall in which tasks are only
/// demonstrated.
pub struct ViewSource {
    worlds: Worlds,
    renderer: Renderer,
    elsewhere: Option<Renderer>,
}

impl ViewSource {
    /// Opens the renderers.
    ///
    /// # Errors
    /// When there is no such adapter, or frames of this size cannot be rendered.
    pub fn new(worlds: Worlds, settings: RenderSettings) -> Result<Self> {
        let (stocks, other) = worlds.halls();
        let renderer = Renderer::with_stocks(stocks, settings.clone())?;
        let elsewhere = other.map(|other| Renderer::new(other, settings)).transpose()?;
        Ok(Self { worlds, renderer, elsewhere })
    }

    /// Renders the view from `pose` in world variant `variant`.
    ///
    /// # Errors
    /// When there is no such variant, the pose is not on free floor, or the device failed.
    pub fn render(&mut self, variant: u32, pose: Pose) -> Result<RgbaImage> {
        let Self { worlds, renderer, elsewhere } = self;
        let world = worlds.variant(variant);
        let world = world.with_context(|| format!("there is no world variant {variant}"))?;
        let is_free = worlds.layout_of(world).is_free(pose.cell);
        ensure!(is_free, "the cell of pose {pose} is not free floor");
        let view = |stock| ViewSpec { pose, variant: worlds.closed(world), stock };
        match elsewhere {
            Some(other) if world.stock as usize == worlds.halls().0.len() => {
                other.render_image(view(0))
            }
            _ => renderer.render_image(view(world.stock)),
        }
    }
}
