//! Render workers: threads beside the serve loop that render views into slots of the frame store.

use std::ops::Range;
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, ensure};
use crossbeam::channel::{Receiver, Sender, unbounded};
use domain::Pose;
use shm_types::FrameSlot;
use shm_types::process::monotonic_ns;
use warehouse::Variant;

use crate::renderer::{ViewSpec, VisibleChanges};
use crate::view_cache::FrameKey;

/// Requests that wait for each worker in addition to those it works on, so that it never idles. More would delay later
/// requests that are more urgent.
const WAITING_PER_WORKER: usize = 1;

const WORKER_ENDED: &str = "a render worker has ended; its own message on standard error says why";

/// The pixel of a blank frame, RGBA.
pub(crate) const GREY: [u8; 4] = [128, 128, 128, 255];

/// A view and the slot that it is rendered into.
#[derive(Debug)]
pub struct RenderTask<'a> {
    /// The index of what stands on the shelves.
    pub stock: u32,
    /// Which passages are closed.
    pub variant: &'a Variant,
    /// The camera's pose.
    pub pose: Pose,
    /// Where the pixels go.
    pub slot: &'a mut FrameSlot,
    /// The first 16 bytes of the BLAKE3 hash of the pixels, if the worker knows it already.
    pub content_hash: Option<[u8; 16]>,
}

/// Renders views into slots of the frame store. The pixels of a view must not depend on the worker or on the other views
/// of the batch.
pub trait RenderWorker: Send {
    /// Renders all `tasks`. Returns how many bytes of pixels the program itself has copied.
    ///
    /// # Errors
    /// When the device fails.
    fn render_into(&mut self, tasks: &mut [RenderTask<'_>]) -> Result<u64>;
}

/// Which changes of a world may be visible in a view. The frame of the world without the others is used instead.
pub type FindChanges = Box<dyn FnMut(ViewSpec<'_>) -> VisibleChanges>;

/// What a simulator renders with.
pub struct RenderSetup {
    /// At least one. Each works on a thread of its own.
    pub workers: Vec<Box<dyn RenderWorker>>,
    /// Whether the first worker renders on the simulator's own thread instead, and the others not at all: for drills that
    /// execute all processes one at a time.
    pub on_serve_thread: bool,
    /// Maximum number of views in a batch of one worker: several where a device renders them faster together.
    pub batch_views: usize,
    /// Which views differ from those of the unchanged world.
    pub find_changes: FindChanges,
    /// Backend and adapter, for the run's manifest.
    pub facts: Vec<(&'static str, String)>,
}

/// A view to be rendered.
#[derive(Debug)]
pub(crate) struct RenderRequest {
    pub(crate) view: FrameKey,
    /// What the view shows (stock, closed passages, pose); `None` is uniform grey.
    pub(crate) world: Option<(u32, Variant, Pose)>,
    pub(crate) slot: FrameSlot,
}

/// Views that a worker has rendered together.
#[derive(Debug)]
pub(crate) struct RenderedBatch {
    /// The worker's number.
    pub(crate) worker: usize,
    /// Begin and end, CLOCK_MONOTONIC.
    pub(crate) span_ns: Range<u64>,
    pub(crate) bytes_copied: u64,
    pub(crate) views: Vec<RenderedView>,
}

/// A view that has been rendered.
#[derive(Debug)]
pub(crate) struct RenderedView {
    pub(crate) view: FrameKey,
    pub(crate) slot: FrameSlot,
    /// The first 16 bytes of the BLAKE3 hash of the pixels.
    pub(crate) content_hash: [u8; 16],
}

/// Worker threads. When dropped, it waits for them to complete what they have been sent.
pub(crate) struct RenderPool {
    requests: Requests,
    rendered: Receiver<Result<RenderedBatch>>,
    threads: Vec<JoinHandle<()>>,
    capacity: usize,
    in_flight: usize,
}

/// Where requests go.
enum Requests {
    /// To the worker threads; `None` once these have to end.
    Threads(Option<Sender<RenderRequest>>),
    /// To a worker on the thread of the caller.
    Caller(Box<dyn FnMut(RenderRequest)>),
}

impl RenderPool {
    /// Renders on the thread that calls [`Self::send`], which then calls `wake`.
    pub(crate) fn on_caller(mut worker: Box<dyn RenderWorker>, wake: impl Fn() + 'static) -> Self {
        let (sender, rendered) = unbounded();
        let render = move |request| {
            let batch = render_batch(&mut *worker, 0, vec![request]);
            // The receiver is a field of this pool.
            let _ = sender.send(batch);
            wake();
        };
        Self {
            requests: Requests::Caller(Box::new(render)),
            rendered,
            threads: Vec::new(),
            capacity: 1 + WAITING_PER_WORKER,
            in_flight: 0,
        }
    }

    /// Starts a thread for each worker. The threads call `wake` whenever [`Self::take`] has something to return.
    ///
    /// # Errors
    /// When the system starts no more threads.
    pub(crate) fn new(
        workers: Vec<Box<dyn RenderWorker>>,
        batch_views: usize,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Result<Self> {
        let capacity = workers.len() * batch_views * (1 + WAITING_PER_WORKER);
        let (requests, queue) = unbounded::<RenderRequest>();
        let (sender, rendered) = unbounded();
        let start = |(number, mut worker): (usize, Box<dyn RenderWorker>)| {
            let (queue, sender, wake) = (queue.clone(), sender.clone(), wake.clone());
            thread::Builder::new().spawn(move || {
                while let Ok(first) = queue.recv() {
                    let more = queue.try_iter().take(batch_views - 1);
                    let batch = std::iter::once(first).chain(more).collect();
                    if sender.send(render_batch(&mut *worker, number, batch)).is_err() {
                        break;
                    }
                    wake();
                }
            })
        };
        let threads = workers.into_iter().enumerate().map(start).collect::<std::io::Result<_>>();
        let threads = threads.context("cannot start a render thread")?;
        let requests = Requests::Threads(Some(requests));
        Ok(Self { requests, rendered, threads, capacity, in_flight: 0 })
    }

    /// How many requests may be sent now.
    pub(crate) fn room(&self) -> usize {
        self.capacity - self.in_flight
    }

    /// Sends a request to the next free worker.
    ///
    /// # Errors
    /// When all workers have ended.
    pub(crate) fn send(&mut self, request: RenderRequest) -> Result<()> {
        self.in_flight += 1;
        match &mut self.requests {
            Requests::Caller(render) => render(request),
            Requests::Threads(requests) => {
                let sent = requests.as_ref().and_then(|requests| requests.send(request).ok());
                sent.context(WORKER_ENDED)?;
            }
        }
        Ok(())
    }

    /// A batch that a worker has completed, if there is one.
    ///
    /// # Errors
    /// When rendering failed, or a worker has ended.
    pub(crate) fn take(&mut self) -> Result<Option<RenderedBatch>> {
        let Ok(batch) = self.rendered.try_recv() else {
            let has_ended = self.threads.iter().any(JoinHandle::is_finished);
            ensure!(!has_ended, WORKER_ENDED);
            return Ok(None);
        };
        let batch = batch?;
        self.in_flight -= batch.views.len();
        Ok(Some(batch))
    }
}

impl Drop for RenderPool {
    fn drop(&mut self) {
        if let Requests::Threads(requests) = &mut self.requests {
            *requests = None;
        }
        for thread in self.threads.drain(..) {
            // A worker that panicked has printed its message.
            let _ = thread.join();
        }
    }
}

fn render_batch(
    worker: &mut dyn RenderWorker,
    number: usize,
    mut requests: Vec<RenderRequest>,
) -> Result<RenderedBatch> {
    let begun = monotonic_ns();
    let mut tasks = Vec::with_capacity(requests.len());
    for RenderRequest { world, slot, .. } in &mut requests {
        match world {
            Some((stock, variant, pose)) => {
                let stock = *stock;
                tasks.push(RenderTask { stock, variant, pose: *pose, slot, content_hash: None });
            }
            None => slot.pixels_mut().as_chunks_mut().0.fill(GREY),
        }
    }
    let bytes_copied = if tasks.is_empty() { 0 } else { worker.render_into(&mut tasks)? };
    let span_ns = begun..monotonic_ns();
    let mut known = tasks.iter().map(|task| task.content_hash).collect::<Vec<_>>().into_iter();
    let finish = |RenderRequest { view, world, slot }| {
        let known = world.and_then(|_| known.next()).flatten();
        let content_hash = known.unwrap_or_else(|| {
            let hash = blake3::hash(slot.pixels());
            std::array::from_fn(|at| hash.as_bytes()[at])
        });
        RenderedView { view, slot, content_hash }
    };
    let views = requests.into_iter().map(finish).collect();
    Ok(RenderedBatch { worker: number, span_ns, bytes_copied, views })
}
