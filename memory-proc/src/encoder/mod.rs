//! The encoder: images in, embeddings out, on worker threads.
//!
//! Each worker has an ONNX Runtime session of one thread. It converts an image's bytes to the input tensor in place,
//! and every image is a call of its own, so an embedding has the same bits whatever else is in flight. Results
//! arrive in any order, named by content.
//!
//! [`PreparedEncoder`] checks without opening a session that everything the encoder needs is there. Sessions take
//! longer to open and are opened by the workers.
//!
//! The encoder does not know frames, lanes or caches.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use shm_types::process::monotonic_ns;

use search::{ContentHash, Embedding};

mod cut;
mod preprocess;
mod provider;
mod session;

pub use preprocess::Image;
pub use provider::Provider;
pub use session::ModelFile;

use preprocess::Preprocessor;
use session::{EncoderSession, Runtime};

use crate::paths::RuntimeLibrary;

/// Facts about an encoder, reported wherever its results appear.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncoderFacts {
    /// The model's name; an untrained one says so.
    pub model: String,
    /// SHA-256 of its file.
    pub sha256: String,
    /// Whether the weights are trained.
    pub trained: bool,
    /// Which build of ONNX Runtime.
    pub runtime: String,
    /// The execution provider that the model runs on.
    pub provider: Provider,
    /// Worker threads, each with a session of one thread.
    pub threads: usize,
    /// Length of an embedding.
    pub dimension: usize,
    /// Equal for encoders whose embeddings may be mixed: covers model, preprocessing, runtime, execution provider and
    /// the processor's vector instructions.
    pub fingerprint: [u8; 32],
    /// Equal for encoders that differ at most in what they run on: covers model and preprocessing.
    pub model_fingerprint: [u8; 32],
}

/// A worker's result.
#[derive(Debug)]
pub struct Embedded {
    /// The image's content.
    pub content: ContentHash,
    /// Its embedding.
    pub embedding: Result<Embedding>,
    /// The worker's number, from 0.
    pub worker: usize,
    /// Start and end in nanoseconds of CLOCK_MONOTONIC.
    pub span_ns: Range<u64>,
}

/// A source of pixels that can be sent to a worker.
pub trait ImageSource: Send + 'static {
    /// The pixels.
    fn image(&self) -> Image<'_>;
}

struct Job {
    content: ContentHash,
    image: Box<dyn ImageSource>,
}

/// When workers open their sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SessionOpening {
    /// At once.
    Eagerly,
    /// When the first image arrives: there may be none.
    OnDemand,
}

/// An encoder whose model file and runtime are loaded and whose workers have not started.
pub struct PreparedEncoder {
    file: Arc<ModelFile>,
    runtime: Runtime,
    facts: EncoderFacts,
}

impl PreparedEncoder {
    /// Loads ONNX Runtime for an encoder of `threads` workers.
    ///
    /// # Errors
    /// When the runtime cannot be used, or its execution provider cannot.
    pub fn new(
        file: ModelFile,
        runtime: &RuntimeLibrary,
        threads: NonZeroUsize,
        provider: Provider,
    ) -> Result<Self> {
        let runtime = Runtime::load(runtime)?;
        provider.check(runtime.path)?;
        // A first session shows whether the provider's libraries are there: before the run starts, not at its first image.
        drop(runtime.builder(provider)?);
        let (model, build) = (&file.model, runtime.build());
        let facts = EncoderFacts {
            model: model.label(),
            sha256: file.sha256.clone(),
            trained: model.trained,
            provider,
            threads: threads.get(),
            dimension: model.dimension,
            fingerprint: fingerprint(&file, &build, provider),
            model_fingerprint: *blake3::hash(model_text(&file).as_bytes()).as_bytes(),
            runtime: build,
        };
        Ok(Self { file: Arc::new(file), runtime, facts })
    }

    /// Facts about the encoder.
    pub fn facts(&self) -> &EncoderFacts {
        &self.facts
    }

    /// The model's file and the runtime's library.
    pub fn files(&self) -> [&Path; 2] {
        [&self.file.path, self.runtime.path]
    }

    /// Starts the workers. A worker calls `wake` whenever a result can be fetched with [`Encoder::poll`]. If the model
    /// cannot be opened, that error is the result for every image.
    ///
    /// # Errors
    /// When the system starts no more threads.
    pub fn start(
        self,
        open: SessionOpening,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Result<Encoder> {
        let Self { file, runtime, facts } = self;
        let threads = facts.threads;
        let (jobs, queue) = bounded(threads * (1 + WAITING_PER_WORKER));
        let (done, results) = unbounded();
        let work_of = |worker: usize| {
            let (file, wake) = (file.clone(), wake.clone());
            let (queue, done) = (queue.clone(), done.clone());
            move || {
                let first: Option<Job> = match open {
                    SessionOpening::Eagerly => None,
                    SessionOpening::OnDemand => match queue.recv() {
                        Ok(job) => Some(job),
                        Err(_) => return,
                    },
                };
                let (size, mean, std) = (file.model.input_size, file.model.mean, file.model.std);
                let mut preprocessor = Preprocessor::new(size, mean, std);
                let mut session = EncoderSession::new(runtime, facts.provider, &file);
                // The sessions have copied what they need of the model's bytes.
                drop(file);
                for Job { content, image } in first.into_iter().chain(&queue) {
                    let start = monotonic_ns();
                    let embed = |session: &mut EncoderSession| {
                        session.embed(&preprocessor.tensor(image.image())?)
                    };
                    let embedding =
                        session.as_mut().map_err(|error| anyhow!("{error}")).and_then(embed);
                    drop(image);
                    let span_ns = start..monotonic_ns();
                    if done.send(Embedded { content, embedding, worker, span_ns }).is_err() {
                        break;
                    }
                    wake();
                }
            }
        };
        let start = |worker| std::thread::Builder::new().spawn(work_of(worker));
        let workers = (0..threads).map(start).collect::<std::io::Result<Vec<_>>>();
        let workers = workers.context("cannot start a thread of the encoder")?;
        Ok(Encoder { facts, jobs: Jobs::Threads(Some(jobs)), results, workers, in_flight: 0 })
    }
}

/// A pool of workers that embed images. Dropping it waits for images in progress.
pub struct Encoder {
    facts: EncoderFacts,
    jobs: Jobs,
    results: Receiver<Embedded>,
    workers: Vec<JoinHandle<()>>,
    in_flight: usize,
}

/// Where images go.
enum Jobs {
    /// To the worker threads; `None` once these have to end.
    Threads(Option<Sender<Job>>),
    /// To a function on the thread of the caller.
    Caller(Box<dyn FnMut(Job)>),
}

const WORKERS_GONE: &str = "a worker thread of the encoder has ended";

/// Images queued for each worker beside the one in progress, so that a worker never waits for the next.
const WAITING_PER_WORKER: usize = 1;

impl Encoder {
    /// An encoder that calls `embed` on the thread that submits an image, and then `wake`: for drills that execute all
    /// processes one at a time.
    pub fn on_caller(
        facts: EncoderFacts,
        mut embed: impl FnMut(Image<'_>) -> Result<Embedding> + 'static,
        wake: impl Fn() + 'static,
    ) -> Self {
        let (done, results) = unbounded();
        let work = move |Job { content, image }: Job| {
            let start = monotonic_ns();
            let embedding = embed(image.image());
            let span_ns = start..monotonic_ns();
            // The receiver is a field of this encoder.
            let _ = done.send(Embedded { content, embedding, worker: 0, span_ns });
            wake();
        };
        let jobs = Jobs::Caller(Box::new(work));
        Self { facts, jobs, results, workers: Vec::new(), in_flight: 0 }
    }

    /// Facts about the encoder.
    pub fn facts(&self) -> &EncoderFacts {
        &self.facts
    }

    /// Whether [`Self::submit`] would return without waiting.
    pub fn has_room(&self) -> bool {
        self.in_flight < self.facts.threads * (1 + WAITING_PER_WORKER)
    }

    /// Images submitted whose results have not been fetched.
    pub fn in_flight(&self) -> usize {
        self.in_flight
    }

    /// Submits an image, which is dropped as soon as it is embedded.
    ///
    /// # Errors
    /// When the workers have ended.
    pub fn submit(&mut self, content: ContentHash, image: impl ImageSource) -> Result<()> {
        let job = Job { content, image: Box::new(image) };
        self.in_flight += 1;
        match &mut self.jobs {
            Jobs::Caller(work) => work(job),
            Jobs::Threads(jobs) => {
                let sent = jobs.as_ref().and_then(|jobs| jobs.send(job).ok());
                sent.context(WORKERS_GONE)?;
            }
        }
        Ok(())
    }

    /// The next result, if one is ready.
    ///
    /// # Errors
    /// When a worker has ended: its image would never come back.
    pub fn poll(&mut self) -> Result<Option<Embedded>> {
        let Ok(embedded) = self.results.try_recv() else {
            ensure!(!self.workers.iter().any(JoinHandle::is_finished), WORKERS_GONE);
            return Ok(None);
        };
        self.in_flight -= 1;
        Ok(Some(embedded))
    }

    /// Embeds images and returns their embeddings in the same order.
    ///
    /// # Errors
    /// The first failure, if any image fails.
    pub fn embed_all<I: ImageSource>(
        &mut self,
        images: impl IntoIterator<Item = I>,
    ) -> Result<Vec<Embedding>> {
        // Images are named by their position here, so equal ones are embedded separately.
        let mut embeddings = BTreeMap::new();
        for (position, image) in (0_u128..).zip(images) {
            if !self.has_room() {
                let Embedded { content, embedding, .. } = self.wait()?;
                embeddings.insert(u128::from_be_bytes(content), embedding?);
            }
            self.submit(position.to_be_bytes(), image)?;
        }
        while self.in_flight > 0 {
            let Embedded { content, embedding, .. } = self.wait()?;
            embeddings.insert(u128::from_be_bytes(content), embedding?);
        }
        Ok(embeddings.into_values().collect())
    }

    fn wait(&mut self) -> Result<Embedded> {
        let embedded = self.results.recv().map_err(|_| anyhow!(WORKERS_GONE))?;
        self.in_flight -= 1;
        Ok(embedded)
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        if let Jobs::Threads(jobs) = &mut self.jobs {
            *jobs = None;
        }
        for worker in self.workers.drain(..) {
            // A worker that panicked has printed its panic already.
            let _ = worker.join();
        }
    }
}

/// Hashes everything that an embedding's bits depend on beside the image.
fn fingerprint(file: &ModelFile, runtime: &str, provider: Provider) -> [u8; 32] {
    let model = model_text(file);
    let text = format!("{model} | onnxruntime {runtime} | {}", provider.fingerprint());
    *blake3::hash(text.as_bytes()).as_bytes()
}

/// What an embedding depends on beside the image and what the encoder runs on.
fn model_text(file: &ModelFile) -> String {
    let model = &file.model;
    format!(
        "{} {} {} {:?} {:?} {} {} {} | preprocessing {}",
        file.sha256,
        model.input,
        model.input_size,
        model.mean,
        model.std,
        model.output,
        model.pooling.word(),
        model.dimension,
        preprocess::VERSION,
    )
}
