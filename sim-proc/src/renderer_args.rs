//! The flags that choose a backend, and how the world looks.

use program::AppearanceArgs;

use crate::renderer::{Backend, RenderSettings};

/// The flags that choose a backend, and how the world looks.
#[derive(Debug, clap::Args)]
pub(crate) struct RendererArgs {
    /// Render on the CPU, whose pixels are the same on every machine, or on a Vulkan device (wgpu); without this, on a
    /// graphics card if there is one and otherwise on the CPU.
    #[arg(long, value_name = "cpu|wgpu")]
    backend: Option<Backend>,

    /// Render on the best Vulkan adapter whose name contains this.
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,

    #[command(flatten)]
    appearance: AppearanceArgs,
}

impl RendererArgs {
    /// `settings` with this backend, adapter and appearance.
    pub(crate) fn apply(&self, settings: RenderSettings) -> RenderSettings {
        RenderSettings {
            backend: self.backend,
            adapter: self.adapter.clone(),
            appearance: self.appearance.clone().into(),
            ..settings
        }
    }
}
