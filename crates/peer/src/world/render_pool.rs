//! Render workers: threads beside the serve loop that render views into slots of the frame store.

use std::ops::Range;
use std::thread::{self, JoinHandle};

use crossbeam::channel::{Receiver, Sender, unbounded};
use shm_types::FrameSlot;
use shm_types::process::monotonic_ns;

use super::{RenderTask, RenderWorker, Renderers, WorldFailure};

/// Requests that wait for each worker in addition to those it works on, so that it never idles. More would delay later
/// requests that are more urgent.
const WAITING_PER_WORKER: usize = 1;

const WORKER_ENDED: &str = "a render worker has ended; its own message on standard error says why";

/// The pixel of a grey frame, which stands for a view that is not shown, RGBA.
pub const GREY: [u8; 4] = [128, 128, 128, 255];

/// A view to be rendered.
pub(super) struct RenderRequest<V, P> {
    pub(super) view: V,
    /// What the view shows; `None` is uniform grey.
    pub(super) picture: Option<P>,
    pub(super) slot: FrameSlot,
}

/// Views that a worker has rendered together.
#[derive(Debug)]
pub(super) struct RenderedBatch<V> {
    /// The worker's number.
    pub(super) worker: usize,
    /// Begin and end, CLOCK_MONOTONIC.
    pub(super) span_ns: Range<u64>,
    pub(super) bytes_copied: u64,
    pub(super) views: Vec<RenderedView<V>>,
}

/// A view that has been rendered.
#[derive(Debug)]
pub(super) struct RenderedView<V> {
    pub(super) view: V,
    pub(super) slot: FrameSlot,
    /// The first 16 bytes of the BLAKE3 hash of the pixels.
    pub(super) content_hash: [u8; 16],
}

/// Worker threads. When dropped, it waits for them to complete what they have been sent.
pub(super) struct RenderPool<V, P> {
    requests: Requests<V, P>,
    rendered: Receiver<Result<RenderedBatch<V>, WorldFailure>>,
    threads: Vec<JoinHandle<()>>,
    capacity: usize,
    in_flight: usize,
}

/// Where requests go.
enum Requests<V, P> {
    /// To the worker threads; `None` once these have to end.
    Threads(Option<Sender<RenderRequest<V, P>>>),
    /// To a worker on the thread of the caller.
    Caller(Box<dyn FnMut(RenderRequest<V, P>)>),
}

impl<V: Copy + Send + 'static, P: Send + 'static> RenderPool<V, P> {
    /// Lets `renderers` render, which call `wake` whenever [`Self::take`] has something to return.
    ///
    /// # Errors
    /// When the system starts no more threads.
    pub(super) fn new(
        renderers: Renderers<P>,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Result<Self, WorldFailure> {
        match renderers {
            Renderers::Threads { workers, batch } => Self::on_threads(workers, batch, wake),
            Renderers::Caller(worker) => Ok(Self::on_caller(worker, wake)),
        }
    }

    /// Renders on the thread that calls [`Self::send`].
    fn on_caller(mut worker: Box<dyn RenderWorker<P>>, wake: impl Fn() + 'static) -> Self {
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

    /// Starts a thread for each worker.
    fn on_threads(
        workers: Vec<Box<dyn RenderWorker<P> + Send>>,
        batch_views: usize,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Result<Self, WorldFailure> {
        let capacity = workers.len() * batch_views * (1 + WAITING_PER_WORKER);
        let (requests, queue) = unbounded::<RenderRequest<V, P>>();
        let (sender, rendered) = unbounded();
        let start = |(number, mut worker): (usize, Box<dyn RenderWorker<P> + Send>)| {
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
        let threads = threads.map_err(|error| format!("cannot start a render thread: {error}"))?;
        let requests = Requests::Threads(Some(requests));
        Ok(Self { requests, rendered, threads, capacity, in_flight: 0 })
    }

    /// How many requests may be sent now.
    pub(super) fn room(&self) -> usize {
        self.capacity - self.in_flight
    }

    /// Sends a request to the next free worker.
    ///
    /// # Errors
    /// When all workers have ended.
    pub(super) fn send(&mut self, request: RenderRequest<V, P>) -> Result<(), WorldFailure> {
        self.in_flight += 1;
        match &mut self.requests {
            Requests::Caller(render) => render(request),
            Requests::Threads(requests) => {
                let sent = requests.as_ref().and_then(|requests| requests.send(request).ok());
                sent.ok_or(WORKER_ENDED)?;
            }
        }
        Ok(())
    }

    /// A batch that a worker has completed, if there is one.
    ///
    /// # Errors
    /// When rendering failed, or a worker has ended.
    pub(super) fn take(&mut self) -> Result<Option<RenderedBatch<V>>, WorldFailure> {
        let Ok(batch) = self.rendered.try_recv() else {
            let has_ended = self.threads.iter().any(JoinHandle::is_finished);
            return if has_ended { Err(WORKER_ENDED.into()) } else { Ok(None) };
        };
        let batch = batch?;
        self.in_flight -= batch.views.len();
        Ok(Some(batch))
    }
}

impl<V, P> Drop for RenderPool<V, P> {
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

fn render_batch<V, P>(
    worker: &mut (impl RenderWorker<P> + ?Sized),
    number: usize,
    mut requests: Vec<RenderRequest<V, P>>,
) -> Result<RenderedBatch<V>, WorldFailure> {
    let begun = monotonic_ns();
    let mut tasks = Vec::with_capacity(requests.len());
    for RenderRequest { picture, slot, .. } in &mut requests {
        match picture {
            Some(picture) => tasks.push(RenderTask { picture, slot, content_hash: None }),
            None => slot.pixels_mut().as_chunks_mut().0.fill(GREY),
        }
    }
    let bytes_copied = if tasks.is_empty() { 0 } else { worker.render_into(&mut tasks)? };
    let span_ns = begun..monotonic_ns();
    let mut known = tasks.iter().map(|task| task.content_hash).collect::<Vec<_>>().into_iter();
    let finish = |RenderRequest { view, picture, slot }: RenderRequest<V, P>| {
        let known = picture.and_then(|_| known.next()).flatten();
        let content_hash = known.unwrap_or_else(|| {
            let hash = blake3::hash(slot.pixels());
            std::array::from_fn(|at| hash.as_bytes()[at])
        });
        RenderedView { view, slot, content_hash }
    };
    let views = requests.into_iter().map(finish).collect();
    Ok(RenderedBatch { worker: number, span_ns, bytes_copied, views })
}
