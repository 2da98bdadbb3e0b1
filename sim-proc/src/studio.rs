//! Renderers as painters: as many as there are cores where the processor draws, each on a thread of its own with views
//! of its own; one where a graphics card does.

use std::thread;

use warehouse::Warehouse;

use crate::painter::{Painter, Painting, Studio};
use crate::renderer::{
    Destination, FramePath, RenderError, RenderJob, RenderSettings, Renderer, View,
};

/// Renderers on the processor, at most.
const MOST: usize = 8;

/// Views that a graphics card draws at once.
const VIEWS_ON_A_CARD: usize = 8;

impl Painter for Renderer {
    fn paint(&mut self, paintings: &mut [Painting<'_>]) -> Result<u64, RenderError> {
        let before = self.report().bytes_copied;
        let mut jobs: Vec<RenderJob<'_>> = paintings
            .iter_mut()
            .map(|painting| RenderJob {
                view: View { pose: painting.pose, variant: painting.variant },
                destination: Destination::Slot(bytemuck::cast_slice_mut(painting.slot.pages_mut())),
            })
            .collect();
        self.render(&mut jobs)?;
        Ok(self.report().bytes_copied - before)
    }
}

/// Opens renderers that draw at the same time: as many as there are cores, up to eight, where the processor draws,
/// otherwise one.
///
/// # Errors
/// As [`Renderer::new`].
pub fn renderers(
    warehouse: &Warehouse,
    settings: RenderSettings,
) -> Result<Vec<Renderer>, RenderError> {
    let mut renderers = vec![Renderer::new(warehouse, settings)?];
    if renderers[0].keeps_to_its_thread() {
        let cores = thread::available_parallelism().map_or(1, |cores| cores.get().min(MOST));
        for _ in 1..cores {
            renderers.push(renderers[0].beside()?);
        }
    }
    Ok(renderers)
}

impl Studio {
    /// Puts [`renderers`] to work.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn open(warehouse: &Warehouse, settings: RenderSettings) -> Result<Self, RenderError> {
        let renderers = renderers(warehouse, settings)?;
        let first = &renderers[0];
        let at_once = if first.keeps_to_its_thread() { 1 } else { VIEWS_ON_A_CARD };
        let report = first.report();
        let path = match report.frame_path {
            FramePath::Direct => "direct".to_owned(),
            FramePath::Copied { reason } => format!("copied: {reason}"),
        };
        let mut lookout = first.lookout();
        let facts = vec![
            ("adapter", report.adapter),
            ("frame path", path),
            ("renderers", renderers.len().to_string()),
        ];
        let painter = |renderer| Box::new(renderer) as Box<dyn Painter>;
        Ok(Self {
            painters: renderers.into_iter().map(painter).collect(),
            at_once,
            may_show_barricade: Box::new(move |variant, pose| {
                lookout.may_show_barricade(View { pose, variant })
            }),
            facts,
        })
    }
}
