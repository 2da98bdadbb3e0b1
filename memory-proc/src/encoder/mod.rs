//! The encoder: frames in, embeddings out, on worker threads.
//!
//! Each worker has an ONNX Runtime session of one thread. It makes the input tensor straight from the
//! picture's bytes, wherever they lie, and every picture is a call of its own: so an embedding has the
//! same bits whatever else is in flight. Results come back in any order, named by content.
//!
//! What can be told without a session (is everything there, what will it run on) is told by [`Prepared`];
//! opening sessions takes longer, and is left to the workers.
//!
//! The encoder knows nothing of frames, lanes or caches.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use shm_types::process::monotonic_ns;

use crate::embedding::{ContentHash, Embedding};
use crate::manifest::Precision;

mod amx;
mod onnx;
mod precision;
mod preprocess;
mod product;
mod session;

pub use preprocess::Image;
pub use session::ModelFile;

use precision::Products;
use preprocess::Preprocessor;
use session::{Runtime, Session};

/// Why an encoder cannot be started or an image not embedded.
#[derive(Debug, Clone, thiserror::Error)]
#[expect(missing_docs, reason = "the fields are what the messages show")]
pub enum EncoderError {
    /// Setup has not fetched the model.
    #[error("the encoder {name} needs {path}, which is not there; run `{command}`")]
    ModelMissing { name: String, path: PathBuf, command: String },
    /// The user brings this model's file and has not.
    #[error(
        "the encoder {name} needs a file of yours: pass --encoder-file (docs/encoders.md says how to export one)"
    )]
    FileNotGiven { name: String },
    /// The file cannot be read.
    #[error("cannot read the model file {path}: {message}")]
    Read { path: PathBuf, message: String },
    /// The file is another one.
    #[error(
        "{path} is not the model that the manifest describes: its SHA-256 is {found}, not {expected}; \
         {next}"
    )]
    WrongFile { path: PathBuf, expected: String, found: String, next: String },
    /// ONNX Runtime is not there.
    #[error("ONNX Runtime is not at {path}; run `cargo xtask setup`")]
    RuntimeMissing { path: PathBuf },
    /// The library is there and cannot be used.
    #[error(
        "ONNX Runtime at {path} cannot be used ({message}); delete it and run `cargo xtask setup`"
    )]
    Runtime { path: PathBuf, message: String },
    /// The precision that was asked for by name cannot be had.
    #[error(
        "the encoder cannot run at {precision} here: no processor with amx_tile and amx_bf16 that programs may use; \
         f32 runs anywhere"
    )]
    Precision { precision: &'static str },
    /// ONNX Runtime cannot make anything of the file.
    #[error("ONNX Runtime refuses the model file {path}: {message}")]
    Rejected { path: PathBuf, message: String },
    /// The file has no tensor of the name that the manifest gives.
    #[error(
        "{path} has no {side} tensor {name}; it has {known}. Correct the model's entry in models.toml"
    )]
    NoTensor { path: PathBuf, side: &'static str, name: String, known: String },
    /// The tensor is of another shape.
    #[error(
        "tensor {name} of {path} is {found}, not float {expected}. Correct the model's entry in models.toml"
    )]
    WrongShape { path: PathBuf, name: String, found: String, expected: String },
    /// The file says of itself what the manifest does not say.
    #[error(
        "the weights in {path} are untrained, and {name} would be taken for trained: pass --encoder vit-b16-untrained"
    )]
    Untrained { path: PathBuf, name: String },
    /// A call failed.
    #[error("the encoder failed on an image: {message}")]
    Run { message: String },
    /// The workers have ended before their time.
    #[error("the encoder's worker threads have ended")]
    WorkersGone,
    /// The image's size and bytes do not match.
    #[error("an image of {width} x {height} pixels has {bytes} bytes")]
    BadImage { width: u32, height: u32, bytes: usize },
}

/// What is told about an encoder wherever its numbers appear.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncoderFacts {
    /// The model's name; an untrained one says so.
    pub model: String,
    /// SHA-256 of its file.
    pub sha256: String,
    /// Whether its weights learned anything.
    pub trained: bool,
    /// Which build of ONNX Runtime.
    pub runtime: String,
    /// Its execution provider.
    pub provider: &'static str,
    /// What it computes with.
    pub precision: Precision,
    /// Worker threads, each with a session of one thread.
    pub threads: usize,
    /// Length of an embedding.
    pub dimension: usize,
    /// Equal for encoders whose embeddings may be mixed: it covers model, preprocessing, runtime, precision and the processor's vector instructions.
    pub fingerprint: [u8; 32],
}

/// An embedding that came back from a worker.
#[derive(Debug)]
pub struct Embedded {
    /// The image's content.
    pub content: ContentHash,
    /// Its embedding, or why there is none.
    pub embedding: Result<Embedding, EncoderError>,
    /// Which worker made it, from 0.
    pub worker: usize,
    /// From when to when, CLOCK_MONOTONIC.
    pub span_ns: Range<u64>,
}

/// Something with pixels that a worker can look at.
pub trait Picture: Send + 'static {
    /// Its pixels.
    fn image(&self) -> Image<'_>;
}

struct Job {
    content: ContentHash,
    picture: Box<dyn Picture>,
}

/// When workers open their sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Open {
    /// As soon as they run: there will be work.
    AtOnce,
    /// When the first picture comes to them: there may be none.
    WhenNeeded,
}

/// An encoder that is known to have what it needs and has not been started.
pub struct Prepared {
    file: Arc<ModelFile>,
    runtime: Runtime,
    products: Products,
    facts: EncoderFacts,
}

impl Prepared {
    /// Loads ONNX Runtime from `runtime` for an encoder of `threads` workers at the precision that was `asked` for,
    /// or else the model's own as far as this machine can.
    ///
    /// # Errors
    /// When the runtime cannot be used, or this machine cannot do what was asked for.
    pub fn new(
        file: ModelFile,
        runtime: &Path,
        threads: NonZeroUsize,
        asked: Option<Precision>,
    ) -> Result<Self, EncoderError> {
        let products = Products::choose(&file.model, asked)?;
        let runtime = Runtime::load(runtime)?;
        let (model, build) = (&file.model, runtime.build());
        let facts = EncoderFacts {
            model: model.label(),
            sha256: file.sha256.clone(),
            trained: model.trained,
            provider: "CPU",
            precision: products.precision(),
            threads: threads.get(),
            dimension: model.dimension,
            fingerprint: fingerprint(&file, &build, products),
            runtime: build,
        };
        Ok(Self { file: Arc::new(file), runtime, products, facts })
    }

    /// What it is.
    pub fn facts(&self) -> &EncoderFacts {
        &self.facts
    }

    /// Starts the workers. `wake` is called, on a worker's thread, whenever a result can be fetched with
    /// [`Encoder::poll`]. A model that cannot be opened is what becomes of every picture.
    pub fn start(self, open: Open, wake: impl Fn() + Clone + Send + 'static) -> Encoder {
        let Self { file, runtime, products, facts } = self;
        let threads = facts.threads;
        let (jobs, queue) = bounded(threads * (1 + WAITING_PER_WORKER));
        let (done, results) = unbounded();
        let work_of = |worker: usize| {
            let (file, wake) = (file.clone(), wake.clone());
            let (queue, done) = (queue.clone(), done.clone());
            move || {
                let first: Option<Job> = match open {
                    Open::AtOnce => None,
                    Open::WhenNeeded => match queue.recv() {
                        Ok(job) => Some(job),
                        Err(_) => return,
                    },
                };
                let (size, mean, std) = (file.model.input_size, file.model.mean, file.model.std);
                let mut preprocessor = Preprocessor::new(size, mean, std);
                let mut session = Session::new(runtime, products, &file);
                // The model's bytes are not needed any more, and may be many.
                drop(file);
                for Job { content, picture } in first.into_iter().chain(&queue) {
                    let start = monotonic_ns();
                    let embed = |session: &mut Session| {
                        session.embed(&preprocessor.tensor(picture.image())?)
                    };
                    let embedding = session.as_mut().map_err(|error| error.clone()).and_then(embed);
                    drop(picture);
                    let span_ns = start..monotonic_ns();
                    if done.send(Embedded { content, embedding, worker, span_ns }).is_err() {
                        break;
                    }
                    wake();
                }
            }
        };
        let workers = (0..threads).map(|worker| std::thread::spawn(work_of(worker))).collect();
        Encoder { facts, jobs: Some(jobs), results, workers, in_flight: 0 }
    }
}

/// A pool of workers that embed images. Dropping it lets them finish what they are at.
pub struct Encoder {
    facts: EncoderFacts,
    jobs: Option<Sender<Job>>,
    results: Receiver<Embedded>,
    workers: Vec<JoinHandle<()>>,
    in_flight: usize,
}

/// Images that wait at each worker beside the one it is at, so that it never waits for the next.
const WAITING_PER_WORKER: usize = 1;

impl Encoder {
    /// What it is.
    pub fn facts(&self) -> &EncoderFacts {
        &self.facts
    }

    /// Whether [`Self::submit`] would return at once.
    pub fn has_room(&self) -> bool {
        self.in_flight < self.workers.len() * (1 + WAITING_PER_WORKER)
    }

    /// Images handed in and not yet fetched.
    pub fn in_flight(&self) -> usize {
        self.in_flight
    }

    /// Hands in a picture, which is dropped as soon as it is embedded.
    ///
    /// # Errors
    /// When the workers are gone.
    pub fn submit(
        &mut self,
        content: ContentHash,
        picture: impl Picture,
    ) -> Result<(), EncoderError> {
        let job = Job { content, picture: Box::new(picture) };
        let sent = self.jobs.as_ref().and_then(|jobs| jobs.send(job).ok());
        sent.ok_or(EncoderError::WorkersGone)?;
        self.in_flight += 1;
        Ok(())
    }

    /// The next result, if one is there.
    pub fn poll(&mut self) -> Option<Embedded> {
        let embedded = self.results.try_recv().ok()?;
        self.in_flight -= 1;
        Some(embedded)
    }

    /// Embeds pictures and waits for all of them; results in the pictures' order.
    ///
    /// # Errors
    /// The first failure, if any picture fails.
    pub fn embed_all<P: Picture>(
        &mut self,
        pictures: impl IntoIterator<Item = P>,
    ) -> Result<Vec<Embedding>, EncoderError> {
        // Pictures are named by their position here; equal ones are embedded each.
        let mut embeddings = BTreeMap::new();
        for (position, picture) in (0_u128..).zip(pictures) {
            if !self.has_room() {
                let Embedded { content, embedding, .. } = self.wait()?;
                embeddings.insert(u128::from_be_bytes(content), embedding?);
            }
            self.submit(position.to_be_bytes(), picture)?;
        }
        while self.in_flight > 0 {
            let Embedded { content, embedding, .. } = self.wait()?;
            embeddings.insert(u128::from_be_bytes(content), embedding?);
        }
        Ok(embeddings.into_values().collect())
    }

    fn wait(&mut self) -> Result<Embedded, EncoderError> {
        let embedded = self.results.recv().map_err(|_| EncoderError::WorkersGone)?;
        self.in_flight -= 1;
        Ok(embedded)
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        self.jobs = None;
        for worker in self.workers.drain(..) {
            // A worker that panicked has said so; there is nobody left to tell.
            let _ = worker.join();
        }
    }
}

/// Everything that an embedding's bits depend on, beside the image.
fn fingerprint(file: &ModelFile, runtime: &str, products: Products) -> [u8; 32] {
    let model = &file.model;
    let text = format!(
        "{} {} {} {:?} {:?} {} {} {} | preprocessing {} | onnxruntime {runtime} | {}",
        file.sha256,
        model.input,
        model.input_size,
        model.mean,
        model.std,
        model.output,
        model.pooling.word(),
        model.dimension,
        preprocess::VERSION,
        products.fingerprint(),
    );
    *blake3::hash(text.as_bytes()).as_bytes()
}
