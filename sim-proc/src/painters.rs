//! Several renderers that share what is to be drawn.
//!
//! A driver that draws on the processor draws a view on several threads, and waits for all of them several times
//! a view. Told to keep to one thread (`LP_NUM_THREADS=0`, which Mesa's lavapipe reads) it does not wait; two of
//! them, each with views of its own, get more out of two cores than one with two threads does. A graphics card is
//! shared by nobody.

use std::thread;

use shm_types::Pose;
use warehouse::{Variant, Warehouse};

use crate::painter::{Painter, Painting};
use crate::renderer::{
    Destination, FramePath, RenderError, RenderJob, RenderSettings, Renderer, View,
};

/// The environment variable by which lavapipe is told how many threads it may start.
pub const DRIVER_THREADS: &str = "LP_NUM_THREADS";

/// Renderers on the processor, at most: each holds the scene.
const MOST: usize = 8;

/// One renderer, or several of a driver that keeps to one thread.
pub struct Painters {
    /// At least one.
    renderers: Vec<Renderer>,
}

impl Painters {
    /// Opens as many as there are cores where the driver draws on the processor and keeps to one thread,
    /// otherwise one.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn open(warehouse: &Warehouse, settings: &RenderSettings) -> Result<Self, RenderError> {
        let first = Renderer::new(warehouse, settings.clone())?;
        let keeps_to_one = std::env::var_os(DRIVER_THREADS).is_some_and(|threads| threads == "0");
        let wanted = if first.is_on_processor() && keeps_to_one {
            thread::available_parallelism().map_or(1, |cores| cores.get().min(MOST))
        } else {
            1
        };
        let mut renderers = vec![first];
        for _ in 1..wanted {
            renderers.push(Renderer::new(warehouse, settings.clone())?);
        }
        Ok(Self { renderers })
    }
}

impl Painter for Painters {
    fn paint(&mut self, paintings: &mut [Painting<'_>]) -> Result<(), RenderError> {
        let mut jobs: Vec<RenderJob<'_>> = paintings
            .iter_mut()
            .map(|painting| RenderJob {
                view: View { pose: painting.pose, variant: painting.variant },
                destination: Destination::Slot(bytemuck::cast_slice_mut(painting.slot.pages_mut())),
            })
            .collect();
        let each = jobs.len().div_ceil(self.renderers.len()).max(1);
        thread::scope(|scope| {
            let mut parts = self.renderers.iter_mut().zip(jobs.chunks_mut(each));
            // The first part is this thread's own.
            let own = parts.next();
            let others: Vec<_> =
                parts.map(|(renderer, jobs)| scope.spawn(move || renderer.render(jobs))).collect();
            let mut outcome = own.map_or(Ok(()), |(renderer, jobs)| renderer.render(jobs));
            for other in others {
                let drawn = other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                outcome = outcome.and(drawn);
            }
            outcome
        })
    }

    fn may_show_barricade(&mut self, variant: &Variant, pose: Pose) -> bool {
        self.renderers[0].may_show_barricade(View { pose, variant })
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let report = self.renderers[0].report();
        let path = match report.frame_path {
            FramePath::Direct => "direct".to_owned(),
            FramePath::Copied { reason } => format!("copied: {reason}"),
        };
        let renderers = self.renderers.len().to_string();
        vec![("adapter", report.adapter), ("frame path", path), ("renderers", renderers)]
    }

    fn pixel_bytes_copied(&self) -> u64 {
        self.renderers.iter().map(|renderer| renderer.report().bytes_copied).sum()
    }
}
