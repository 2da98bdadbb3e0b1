//! Renderers as painters: one, or as many as there are cores.
//!
//! A driver that draws on the processor draws a view on several threads, and waits for all of them several times
//! a view. Told to keep to one thread (`LP_NUM_THREADS=0`, which Mesa's lavapipe reads) it does not wait; two of
//! them, each with views of its own, get more out of two cores than one with two threads does. A graphics card is
//! shared by nobody.

use std::thread;

use warehouse::Warehouse;

use crate::painter::{Painter, Painting, Studio};
use crate::renderer::{
    Destination, FramePath, RenderError, RenderJob, RenderSettings, Renderer, View,
};

/// The environment variable by which lavapipe is told how many threads it may start.
pub const DRIVER_THREADS: &str = "LP_NUM_THREADS";

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

/// Opens renderers that draw at the same time: as many as there are cores, up to eight, where the driver draws on
/// the processor and keeps to one thread, otherwise one.
///
/// # Errors
/// As [`Renderer::new`].
pub fn renderers(
    warehouse: &Warehouse,
    settings: RenderSettings,
) -> Result<Vec<Renderer>, RenderError> {
    let first = Renderer::new(warehouse, settings)?;
    let keeps_to_one = std::env::var_os(DRIVER_THREADS).is_some_and(|threads| threads == "0");
    let wanted = if first.is_on_processor() && keeps_to_one {
        thread::available_parallelism().map_or(1, |cores| cores.get().min(MOST))
    } else {
        1
    };
    let mut renderers = vec![first];
    for _ in 1..wanted {
        renderers.push(renderers[0].beside()?);
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
        let at_once = if first.is_on_processor() { 1 } else { VIEWS_ON_A_CARD };
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
