//! Drawing beside the serve loop: views go in, filled slots come out.

use std::ops::Range;
use std::thread::{self, JoinHandle};

use crossbeam::channel::{Receiver, Sender, unbounded};
use domain::Pose;
use shm_types::FrameSlot;
use shm_types::process::monotonic_ns;
use warehouse::Variant;

use crate::painter::{Painter, Painting};
use crate::renderer::RenderError;
use crate::views::ViewKey;

/// Paintings that wait for each painter beside those it is at, so that it never waits for the next. No more: who
/// comes later may be more urgent.
const WAITING_PER_PAINTER: usize = 1;

/// The pixel of a blank frame, RGBA.
const GREY: [u8; 4] = [128, 128, 128, 255];

/// A view to be drawn.
#[derive(Debug)]
pub(crate) struct Order {
    /// Its name.
    pub(crate) view: ViewKey,
    /// With which barricades, and from where; nothing but grey without.
    pub(crate) look: Option<(Variant, Pose)>,
    /// Where to.
    pub(crate) slot: FrameSlot,
}

/// What a painter drew at once.
#[derive(Debug)]
pub(crate) struct Batch {
    /// Who drew it.
    pub(crate) painter: usize,
    /// When, CLOCK_MONOTONIC.
    pub(crate) span_ns: Range<u64>,
    /// Bytes of pixels that were copied for it.
    pub(crate) copied: u64,
    /// At least one.
    pub(crate) drawn: Vec<Drawn>,
}

/// A view that was drawn.
#[derive(Debug)]
pub(crate) struct Drawn {
    /// Its name.
    pub(crate) view: ViewKey,
    /// Its pixels.
    pub(crate) slot: FrameSlot,
    /// First 16 bytes of their BLAKE3 hash.
    pub(crate) content_hash: [u8; 16],
}

/// Painters, each on a thread of its own. Dropping it lets them finish what they are at.
#[derive(Debug)]
pub(crate) struct Easels {
    orders: Option<Sender<Order>>,
    done: Receiver<Result<Batch, RenderError>>,
    threads: Vec<JoinHandle<()>>,
    room: usize,
    in_flight: usize,
}

impl Easels {
    /// Sets `painters` to work, each on up to `at_once` views. `wake` is called, on a painter's thread, whenever
    /// something can be [taken](Self::take).
    pub(crate) fn new(
        painters: Vec<Box<dyn Painter>>,
        at_once: usize,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Self {
        let room = painters.len() * at_once * (1 + WAITING_PER_PAINTER);
        let ((orders, queue), (sender, done)) = (unbounded(), unbounded());
        let threads = painters.into_iter().enumerate().map(|(painter, mut hand)| {
            let (queue, done, wake) =
                (Receiver::clone(&queue), Sender::clone(&sender), wake.clone());
            thread::spawn(move || {
                while let Ok(first) = queue.recv() {
                    let more = queue.try_iter().take(at_once - 1);
                    let orders = std::iter::once(first).chain(more).collect();
                    if done.send(paint(&mut *hand, painter, orders)).is_err() {
                        break;
                    }
                    wake();
                }
            })
        });
        Self { threads: threads.collect(), orders: Some(orders), done, room, in_flight: 0 }
    }

    /// Orders that may be given now.
    pub(crate) fn room(&self) -> usize {
        self.room - self.in_flight
    }

    /// Has a view drawn.
    ///
    /// # Errors
    /// When the painters are gone.
    pub(crate) fn give(&mut self, order: Order) -> Result<(), RenderError> {
        let given = self.orders.as_ref().and_then(|orders| orders.send(order).ok());
        given.ok_or(RenderError::PaintersGone)?;
        self.in_flight += 1;
        Ok(())
    }

    /// What a painter drew at once, if one has finished.
    ///
    /// # Errors
    /// The painter's, and that one is gone.
    pub(crate) fn take(&mut self) -> Result<Option<Batch>, RenderError> {
        let Ok(batch) = self.done.try_recv() else {
            let is_gone = self.threads.iter().any(JoinHandle::is_finished);
            return if is_gone { Err(RenderError::PaintersGone) } else { Ok(None) };
        };
        let batch = batch?;
        self.in_flight -= batch.drawn.len();
        Ok(Some(batch))
    }
}

impl Drop for Easels {
    fn drop(&mut self) {
        self.orders = None;
        for thread in self.threads.drain(..) {
            // A painter that panicked has said so.
            let _ = thread.join();
        }
    }
}

fn paint(
    hand: &mut dyn Painter,
    painter: usize,
    mut orders: Vec<Order>,
) -> Result<Batch, RenderError> {
    let begun = monotonic_ns();
    let mut paintings = Vec::with_capacity(orders.len());
    for Order { look, slot, .. } in &mut orders {
        match look {
            Some((variant, pose)) => paintings.push(Painting { variant, pose: *pose, slot }),
            None => slot
                .pixels_mut()
                .chunks_exact_mut(GREY.len())
                .for_each(|pixel| pixel.copy_from_slice(&GREY)),
        }
    }
    let copied = if paintings.is_empty() { 0 } else { hand.paint(&mut paintings)? };
    let span_ns = begun..monotonic_ns();
    let finish = |Order { view, slot, .. }| {
        let mut content_hash = [0; 16];
        content_hash.copy_from_slice(&blake3::hash(slot.pixels()).as_bytes()[..16]);
        Drawn { view, slot, content_hash }
    };
    let drawn = orders.into_iter().map(finish).collect();
    Ok(Batch { painter, span_ns, copied, drawn })
}
