//! The encoder: frames in, embeddings out, on worker threads.
//!
//! [`Encoder`] turns an image into its input tensor on the caller's thread, straight from the frame's
//! bytes, and hands the tensor to one of its workers, each with its own ONNX Runtime session of one thread.
//! An image is always a call of its own, so its embedding has the same bits whatever else is in flight.
//! Results come back in any order, named by content.
//!
//! It knows nothing of frames, lanes or caches: those are [`crate::serve`]'s.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use crossbeam::channel::{Receiver, Sender, bounded, unbounded};

use crate::embedding::{ContentHash, Embedding};

mod preprocess;
mod session;

pub use preprocess::Image;
pub use session::ModelFile;

use preprocess::Preprocessor;
use session::{Runtime, Session};

/// Why an encoder cannot be started or an image not embedded.
#[derive(Debug, Clone, thiserror::Error)]
#[expect(missing_docs, reason = "the fields are what the messages show")]
pub enum EncoderError {
    /// Setup has not fetched the model.
    #[error("the encoder {name} needs {path}, which is not there; run `cargo xtask setup`")]
    ModelMissing { name: String, path: PathBuf },
    /// The user brings this model's file and has not.
    #[error("the encoder {name} needs a file of yours: pass --encoder-file (docs/encoders.md says how to export one)")]
    FileNotGiven { name: String },
    /// The file cannot be read.
    #[error("cannot read the model file {path}: {message}")]
    Read { path: PathBuf, message: String },
    /// The file is another one.
    #[error(
        "{path} is not the model that the manifest describes: its SHA-256 is {found}, not {expected}; \
         delete it and run `cargo xtask setup`, or correct assets/models.toml if the file is yours"
    )]
    WrongFile { path: PathBuf, expected: String, found: String },
    /// ONNX Runtime is not there.
    #[error("ONNX Runtime is not at {path}; run `cargo xtask setup`")]
    RuntimeMissing { path: PathBuf },
    /// The library is there and cannot be used.
    #[error("ONNX Runtime at {path} cannot be used ({message}); delete it and run `cargo xtask setup`")]
    Runtime { path: PathBuf, message: String },
    /// ONNX Runtime cannot make anything of the file.
    #[error("ONNX Runtime refuses the model file {path}: {message}")]
    Rejected { path: PathBuf, message: String },
    /// The file has no tensor of the name that the manifest gives.
    #[error("{path} has no {side} tensor {name}; it has {known}. Correct the model's entry in models.toml")]
    NoTensor { path: PathBuf, side: &'static str, name: String, known: String },
    /// The tensor is of another shape.
    #[error("tensor {name} of {path} is {found}, not float {expected}. Correct the model's entry in models.toml")]
    WrongShape { path: PathBuf, name: String, found: String, expected: String },
    /// A call failed.
    #[error("the encoder failed on an image: {message}")]
    Run { message: String },
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
    /// Version of ONNX Runtime.
    pub runtime: String,
    /// Its execution provider.
    pub provider: &'static str,
    /// Worker threads, each with a session of one thread.
    pub threads: usize,
    /// Length of an embedding.
    pub dimension: usize,
    /// Equal for encoders whose embeddings may be mixed: it covers model, preprocessing, runtime and the
    /// processor's vector instructions.
    pub fingerprint: [u8; 32],
}

/// An embedding that came back from a worker.
#[derive(Debug)]
pub struct Embedded {
    /// The image's content.
    pub content: ContentHash,
    /// Its embedding, or why there is none.
    pub embedding: Result<Embedding, EncoderError>,
}

struct Job {
    content: ContentHash,
    tensor: Vec<f32>,
}

/// A pool of workers that embed images. Dropping it lets them finish what they are at.
pub struct Encoder {
    facts: EncoderFacts,
    preprocessor: Preprocessor,
    jobs: Option<Sender<Job>>,
    results: Receiver<Embedded>,
    workers: Vec<JoinHandle<()>>,
    in_flight: usize,
}

/// Images that wait at each worker beside the one it is at, so that it never waits for the next.
const WAITING_PER_WORKER: usize = 1;

impl Encoder {
    /// Loads ONNX Runtime from `runtime` and starts `threads` workers. `wake` is called, on a worker's
    /// thread, whenever a result can be fetched with [`Self::poll`].
    ///
    /// # Errors
    /// When the runtime or the model cannot be used.
    pub fn start(
        file: &ModelFile,
        runtime: &Path,
        threads: NonZeroUsize,
        wake: impl Fn() + Clone + Send + 'static,
    ) -> Result<Self, EncoderError> {
        let runtime = Runtime::load(runtime)?;
        let threads = threads.get();
        let sessions = std::thread::scope(|scope| {
            let open = || Session::new(&runtime, file);
            let opening: Vec<_> = (0..threads).map(|_| scope.spawn(open)).collect();
            let joined = opening.into_iter().map(|thread| thread.join().unwrap_or_else(|panic| {
                std::panic::resume_unwind(panic)
            }));
            joined.collect::<Result<Vec<_>, _>>()
        })?;
        let (jobs, queue) = bounded(threads * (1 + WAITING_PER_WORKER));
        let (done, results) = unbounded();
        let workers = sessions.into_iter().map(|session| {
            let (queue, done, wake) = (queue.clone(), done.clone(), wake.clone());
            std::thread::spawn(move || work(session, &queue, &done, wake))
        });
        let model = &file.model;
        let version = runtime.version();
        Ok(Self {
            preprocessor: Preprocessor::new(model.input_size, model.mean, model.std),
            jobs: Some(jobs),
            results,
            workers: workers.collect(),
            in_flight: 0,
            facts: EncoderFacts {
                model: model.label(),
                sha256: file.sha256.clone(),
                trained: model.trained,
                provider: "CPU",
                threads,
                dimension: model.dimension,
                fingerprint: fingerprint(file, &version),
                runtime: version,
            },
        })
    }

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

    /// Hands in an image. Reads `image` before it returns and keeps nothing of it.
    ///
    /// # Errors
    /// When the image's size and bytes do not match, or the workers are gone.
    pub fn submit(&mut self, content: ContentHash, image: Image<'_>) -> Result<(), EncoderError> {
        if !image.is_sound() {
            let Image { width, height, rgba } = image;
            return Err(EncoderError::BadImage { width, height, bytes: rgba.len() });
        }
        let tensor = self.preprocessor.tensor(image);
        let sent = self.jobs.as_ref().and_then(|jobs| jobs.send(Job { content, tensor }).ok());
        sent.ok_or_else(|| EncoderError::Run { message: "its worker threads have ended".into() })?;
        self.in_flight += 1;
        Ok(())
    }

    /// The next result, if one is there.
    pub fn poll(&mut self) -> Option<Embedded> {
        let embedded = self.results.try_recv().ok()?;
        self.in_flight -= 1;
        Some(embedded)
    }

    /// Embeds images and waits for all of them; results in the images' order.
    ///
    /// # Errors
    /// The first failure, if any image fails.
    pub fn embed_all(&mut self, images: &[Image<'_>]) -> Result<Vec<Embedding>, EncoderError> {
        let mut embeddings = vec![None; images.len()];
        let mut keep = |embedded: Embedded| {
            let index = u128::from_le_bytes(embedded.content) as usize;
            embeddings[index] = Some(embedded.embedding);
        };
        for (index, image) in images.iter().enumerate() {
            if !self.has_room() {
                keep(self.wait()?);
            }
            self.submit((index as u128).to_le_bytes(), *image)?;
        }
        while self.in_flight > 0 {
            keep(self.wait()?);
        }
        embeddings.into_iter().flatten().collect()
    }

    fn wait(&mut self) -> Result<Embedded, EncoderError> {
        let gone = |_| EncoderError::Run { message: "its worker threads have ended".into() };
        let embedded = self.results.recv().map_err(gone)?;
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

fn work(mut session: Session, queue: &Receiver<Job>, done: &Sender<Embedded>, wake: impl Fn()) {
    for Job { content, tensor } in queue {
        let embedding = session.embed(&tensor);
        if done.send(Embedded { content, embedding }).is_err() {
            break;
        }
        wake();
    }
}

/// Everything that an embedding's bits depend on, beside the image.
fn fingerprint(file: &ModelFile, runtime: &str) -> [u8; 32] {
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
        vector_instructions(),
    );
    *blake3::hash(text.as_bytes()).as_bytes()
}

/// The instruction set that decides which kernels ONNX Runtime picks, and with them the last bits.
fn vector_instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::is_x86_feature_detected!("avx512f") {
            "x86-64 avx512"
        } else if std::is_x86_feature_detected!("avx2") {
            "x86-64 avx2"
        } else {
            "x86-64"
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH
    }
}
