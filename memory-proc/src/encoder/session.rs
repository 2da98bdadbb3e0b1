//! ONNX Runtime sessions.
//!
//! A model file's SHA-256 is compared with the manifest's, and every session is created from bytes that have it. The hash of
//! a file that has not changed since it was read is taken from a record in the cache folder: a process whose images all have
//! known embeddings never reads the model.
//! A session computes on one thread and takes one image a call, so an embedding cannot depend on other images.

use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail, ensure};
use domain::{RUNTIME_SHA256, RUNTIME_VARIABLE, hex};
use ort::environment::Environment;
use ort::session::Session as OrtSession;
use ort::session::builder::{BuilderResult, GraphOptimizationLevel, SessionBuilder};
use ort::session::{HasSelectedOutputs, OutputSelector, RunOptions};
use ort::value::{Outlet, TensorElementType, TensorRef};
use sha2::{Digest, Sha256};

use super::{Provider, cut};
use crate::environment::{INSTALL_MODEL, INSTALL_RUNTIME, PythonEnvironment, RUNTIMES};
use crate::manifest::{Model, Pooling};
use crate::paths::{CacheFolder, RuntimeLibrary};
use search::Embedding;

/// A model file, checked against its manifest entry.
#[derive(Debug)]
pub struct ModelFile {
    /// Its manifest entry.
    pub model: Model,
    /// Its path.
    pub path: PathBuf,
    /// Whether the model is cut from the file, which is a package's.
    is_cut: bool,
    /// SHA-256 of its bytes, in hexadecimal; after the cut, if it is cut.
    pub sha256: String,
    /// Its bytes, once they have been read.
    bytes: Mutex<Option<Arc<[u8]>>>,
}

/// A file may change twice at the same recorded time: hashes of files this young are not kept.
const SETTLED: Duration = Duration::from_secs(10);

fn sha256_of(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// The bytes of the model in the file `path`, which `is_cut` from it or is the whole file.
fn read_model(path: &Path, is_cut: bool) -> io::Result<Arc<[u8]>> {
    let bytes = durable::input::read_large(path)?;
    if !is_cut {
        return Ok(bytes.into());
    }
    cut::backbone(&bytes).map(Arc::from).map_err(io::Error::other)
}

/// The record of the SHA-256 of the model in the file `path` as it is now; `None` if it may still be changing.
fn hash_record(path: &Path, is_cut: bool, cache: &CacheFolder) -> Option<PathBuf> {
    let path = path.canonicalize().ok()?;
    let facts = path.metadata().ok()?;
    let is_settled = facts.modified().ok()?.elapsed().is_ok_and(|age| age > SETTLED);
    let identity = format!(
        "{path:?}{} {} {} {} {}.{} {}.{}",
        if is_cut { " cut" } else { "" },
        facts.dev(),
        facts.ino(),
        facts.size(),
        facts.mtime(),
        facts.mtime_nsec(),
        facts.ctime(),
        facts.ctime_nsec()
    );
    let name = blake3::hash(identity.as_bytes()).to_hex();
    is_settled.then(|| cache.root().join("model-hashes").join(&name[..32]))
}

/// Writes a record. Without it the file is only read again.
fn keep_record(record: &Path, sha256: &str) {
    let write = || {
        std::fs::create_dir_all(record.parent().unwrap_or(record))?;
        let draft = record.with_extension(std::process::id().to_string());
        durable::output::write(&draft, sha256)?;
        std::fs::rename(draft, record)
    };
    if let Err(error) = write() {
        tracing::debug!(%error, "cannot keep the hash of the model");
    }
}

impl ModelFile {
    /// A model's file: `given`, else the one in the Python environment of this program, else the one that setup put into the cache
    /// folder. It is read if its hash is not known.
    ///
    /// # Errors
    /// When there is no such file, or its SHA-256 is not the manifest's.
    pub fn read(model: &Model, given: Option<&Path>, cache: &CacheFolder) -> Result<Self> {
        let environment = PythonEnvironment::of_this_program();
        let (path, is_cut) = match (given, &model.file) {
            (Some(given), _) => (given.to_path_buf(), false),
            (None, Some(file)) => match environment.uncut_model(file) {
                Some(uncut) => (uncut, true),
                None => (cache.model(file), false),
            },
            (None, None) => bail!(
                "the encoder {} needs a model file: pass --encoder-file (docs/encoders.md says how to export one)",
                model.name
            ),
        };
        let bringing = match environment.brings(model.file.as_deref()) {
            true => Some(INSTALL_MODEL),
            false => model.brought_by.as_deref(),
        };
        let bringing = bringing.filter(|_| given.is_none());
        let shown = path.display();
        let record = hash_record(&path, is_cut, cache);
        let known = record.as_ref().and_then(|record| durable::input::read_text(record).ok());
        let known = known.filter(|known| known.len() == 64);
        let read = || read_model(&path, is_cut);
        let bytes = known.is_none().then(read).transpose().map_err(|error| match bringing {
            Some(command) if error.kind() == std::io::ErrorKind::NotFound => anyhow!(
                "the encoder {} needs {shown}, which is not there; run `{command}`",
                model.name
            ),
            _ => anyhow!("cannot read the model file {shown}: {error}"),
        })?;
        let sha256 = match &bytes {
            None => known.unwrap_or_default(),
            Some(bytes) => {
                let sha256 = sha256_of(bytes);
                record.iter().for_each(|record| keep_record(record, &sha256));
                sha256
            }
        };
        if let Some(expected) = model.sha256.as_ref().filter(|expected| **expected != sha256) {
            let next = match bringing {
                Some(command) if is_cut => format!("run `{command}`"),
                Some(command) => format!("delete it and run `{command}`"),
                None => "give the right file, or correct the model's entry in models.toml".into(),
            };
            bail!(
                "{shown} is not the model that the manifest describes: its SHA-256 is {sha256}, not {expected}; {next}"
            );
        }
        Ok(Self { model: model.clone(), path, is_cut, sha256, bytes: Mutex::new(bytes) })
    }

    /// The bytes, read now unless they have been.
    fn bytes(&self) -> Result<Arc<[u8]>> {
        let mut bytes = self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bytes) = &*bytes {
            return Ok(bytes.clone());
        }
        let path = self.path.display();
        let read = read_model(&self.path, self.is_cut)
            .with_context(|| format!("cannot read the model file {path}"))?;
        ensure!(
            sha256_of(&read) == self.sha256,
            "the model file {path} has changed since this process started: start the run again"
        );
        Ok(bytes.insert(read).clone())
    }
}

/// The loaded ONNX Runtime. A process loads one, and keeps it.
#[derive(Clone, Copy)]
pub(super) struct Runtime {
    environment: &'static Environment,
    /// The library.
    pub(super) path: &'static Path,
}

impl Runtime {
    /// Loads the library, unless this process has loaded one already. One of the user's own is loaded as it is, any other only if
    /// its hash is known.
    pub(super) fn load(library: &RuntimeLibrary) -> Result<Self> {
        static ENVIRONMENT: OnceLock<(PathBuf, Result<Environment, String>)> = OnceLock::new();
        let path = library.path();
        let shown = path.display();
        let next = match library {
            RuntimeLibrary::Own(_) => format!("{RUNTIME_VARIABLE} names it"),
            _ if PythonEnvironment::of_this_program().is_there() => {
                format!("run `{INSTALL_RUNTIME}`")
            }
            _ => "run `cargo xtask setup`".to_owned(),
        };
        ensure!(path.is_file(), "ONNX Runtime is not at {shown}; {next}");
        let load = || {
            match library {
                RuntimeLibrary::Cached(path) => check_known(path, RUNTIME_SHA256)?,
                RuntimeLibrary::Installed(path) => {
                    check_known(path, &RUNTIMES.map(|(_, sha256)| sha256))?;
                }
                RuntimeLibrary::Own(path) => {
                    check_whole(path).map_err(|error| error.to_string())?
                }
            }
            let builder = ort::init_from(path).map_err(|error| error.to_string())?;
            let builder = builder.with_name("memtransfer").with_telemetry(false);
            builder.build().map_err(|error| error.to_string())
        };
        match ENVIRONMENT.get_or_init(|| (path.to_owned(), load())) {
            (path, Ok(environment)) => Ok(Self { environment, path }),
            (path, Err(message)) => {
                bail!("ONNX Runtime at {} cannot be used: {message}; {next}", path.display())
            }
        }
    }

    /// Settings of a session on this provider.
    ///
    /// # Errors
    /// When the libraries that the provider needs are missing.
    pub(super) fn builder(self, provider: Provider) -> Result<SessionBuilder> {
        fn plain(result: BuilderResult) -> Result<SessionBuilder, ort::Error> {
            result.map_err(|error| ort::Error::new(error.message()))
        }
        let builder = || {
            let builder = OrtSession::builder(self.environment)?;
            let builder = plain(builder.with_execution_providers([provider.dispatch()]))?;
            let builder = plain(builder.with_intra_threads(1))?;
            let builder = plain(builder.with_deterministic_compute(true))?;
            plain(builder.with_optimization_level(GraphOptimizationLevel::All))
        };
        builder().map_err(|error| {
            anyhow!(
                "ONNX Runtime cannot use its execution provider `{provider}`: {}. Install the libraries that this \
                 provider needs (docs/encoders.md), or pass --provider cpu",
                error.message().trim_end()
            )
        })
    }

    /// The library's build: its commit, or its whole description where that names no commit.
    pub(super) fn build(&self) -> String {
        let info = ort::info();
        let commit = info.split([' ', ',']).find_map(|word| word.strip_prefix("git-commit-id="));
        commit.map_or_else(|| info.to_owned(), |commit| format!("commit {commit}"))
    }
}

/// Checks that the library `path` has one of these SHA-256: it is code, and the cache folder also holds what others sent.
fn check_known(path: &Path, known: &[&str]) -> Result<(), String> {
    let bytes = durable::input::read_large(path).map_err(|error| error.to_string())?;
    let sha256 = sha256_of(&bytes);
    if known.contains(&&*sha256) {
        return Ok(());
    }
    Err(format!(
        "it is not the library of a known release, and was not loaded (its SHA-256 is {sha256}). A build of your own is used \
         from another folder, with {RUNTIME_VARIABLE}=FILE"
    ))
}

/// Checks that a library of the user has all bytes that its ELF header names: to use one that was cut off ends the process on SIGBUS.
fn check_whole(library: &Path) -> io::Result<()> {
    let mut file = durable::input::open(library)?;
    let size = file.metadata()?.len();
    let mut header = [0; 64];
    let is_elf = file.read_exact(&mut header).is_ok() && header.starts_with(b"\x7fELF");
    if !is_elf {
        return Err(io::Error::other(format!(
            "it is no library: {size} bytes without an ELF header"
        )));
    }
    // The table of sections is the end of the file.
    let [mut offset, mut entry, mut entries] = [[0; 8]; 3];
    offset.copy_from_slice(&header[40..48]);
    entry[..2].copy_from_slice(&header[58..60]);
    entries[..2].copy_from_slice(&header[60..62]);
    let [offset, entry, entries] = [offset, entry, entries].map(u64::from_le_bytes);
    let end = offset.saturating_add(entry * entries);
    if size < end {
        return Err(io::Error::other(format!("it was cut off: it has {size} of {end} bytes")));
    }
    Ok(())
}

const FAILED: &str = "the encoder failed on an image";

/// An open model, which runs on the calling thread.
pub(super) struct EncoderSession {
    session: OrtSession,
    outputs: RunOptions<HasSelectedOutputs>,
    model: Model,
}

impl EncoderSession {
    pub(super) fn new(runtime: Runtime, provider: Provider, file: &ModelFile) -> Result<Self> {
        let path = file.path.display();
        let rejected = |error: ort::Error| {
            anyhow!("ONNX Runtime rejects the model file {path}: {}", error.message())
        };
        let mut builder = runtime.builder(provider)?;
        let session = builder.commit_from_memory(&file.bytes()?).map_err(rejected)?;
        let model = &file.model;
        let says_untrained = |session: &OrtSession| {
            session.metadata().ok()?.custom("memtransfer.trained").map(|trained| trained == "false")
        };
        ensure!(
            !model.trained || says_untrained(&session) != Some(true),
            "the weights in {path} are untrained, and {} would be taken for trained: pass --encoder vit-b16-untrained",
            model.name
        );
        let input = outlet(file, "input", session.inputs(), &model.input)?;
        let size = i64::from(model.input_size);
        check(file, &model.input, input, &[&[1, 3, size, size]])?;
        let output = outlet(file, "output", session.outputs(), &model.output)?;
        let dimension = model.dimension as i64;
        check(file, &model.output, output, &[&[1, -1, dimension], &[1, dimension]])?;
        let selected = OutputSelector::no_default().with(&model.output);
        let outputs = RunOptions::new().map_err(rejected)?.with_outputs(selected);
        Ok(Self { session, outputs, model: model.clone() })
    }

    /// The embedding of an input tensor.
    pub(super) fn embed(&mut self, tensor: &[f32]) -> Result<Embedding> {
        let failed = |error: ort::Error| anyhow!("{FAILED}: {}", error.message());
        let model = &self.model;
        let size = model.input_size as usize;
        let input = TensorRef::from_array_view(([1, 3, size, size], tensor)).map_err(failed)?;
        let inputs = ort::inputs![model.input.as_str() => input];
        let outputs = self.session.run_with_options(inputs, &self.outputs).map_err(failed)?;
        let (_, tokens) = outputs[0].try_extract_tensor::<f32>().map_err(failed)?;
        let output = &model.output;
        let pooled = pool(model, tokens).with_context(|| {
            format!("{FAILED}: {output} holds {} numbers, too few", tokens.len())
        })?;
        Embedding::normalised(&pooled).with_context(|| {
            format!("{FAILED}: {output} holds only zeros, or a value that is not finite")
        })
    }
}

/// The input or output called `name`.
fn outlet<'a>(
    file: &ModelFile,
    side: &'static str,
    outlets: &'a [Outlet],
    name: &str,
) -> Result<&'a Outlet> {
    outlets.iter().find(|outlet| outlet.name() == name).with_context(|| {
        let known: Vec<&str> = outlets.iter().map(Outlet::name).collect();
        format!(
            "{} has no {side} tensor {name}; it has {}. Correct the model's entry in models.toml",
            file.path.display(),
            known.join(", ")
        )
    })
}

/// Checks that a tensor holds floats and has one of the `expected` shapes; -1 stands for any length.
fn check(file: &ModelFile, name: &str, outlet: &Outlet, expected: &[&[i64]]) -> Result<()> {
    let kind = outlet.dtype();
    let fits = |shape: &[i64], expected: &[i64]| {
        let free = |n: i64| n < 0;
        let mut pairs = shape.iter().zip(expected);
        shape.len() == expected.len() && pairs.all(|(&s, &e)| free(s) || free(e) || s == e)
    };
    let shape = kind.tensor_shape().map(|shape| shape.to_vec()).unwrap_or_default();
    let is_float = kind.tensor_type() == Some(TensorElementType::Float32);
    if is_float && expected.iter().any(|expected| fits(&shape, expected)) {
        return Ok(());
    }
    let expected: Vec<_> = expected.iter().map(|shape| format!("{shape:?}")).collect();
    bail!(
        "tensor {name} of {} is {kind}, not float {}. Correct the model's entry in models.toml",
        file.path.display(),
        expected.join(" or ")
    )
}

/// Reduces the output tensor to one vector: a single vector is kept as it is, tokens are pooled.
fn pool(model: &Model, tokens: &[f32]) -> Option<Vec<f32>> {
    let (first, others) = tokens.split_at_checked(model.dimension)?;
    let count = others.len() / model.dimension;
    if count == 0 || model.pooling == Pooling::Cls {
        return Some(first.to_vec());
    }
    let mut mean = vec![0.0_f32; model.dimension];
    for token in others.chunks_exact(model.dimension) {
        for (sum, value) in mean.iter_mut().zip(token) {
            *sum += value / count as f32;
        }
    }
    Some(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::EncoderManifest;

    #[test]
    fn a_model_file_that_is_a_device_is_refused() {
        let manifest = EncoderManifest::shipped().unwrap();
        let (folder, device) = (tempfile::tempdir().unwrap(), Path::new("/dev/zero"));
        let cache = CacheFolder::at(folder.path());
        for model in &manifest.models {
            let error = ModelFile::read(model, Some(device), &cache).unwrap_err().to_string();
            assert!(error.ends_with("it is a device and not a regular file"), "{error}");
        }
    }

    #[test]
    fn a_library_that_was_cut_off_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join("library.so");
        let program = std::fs::read("/proc/self/exe").unwrap();
        std::fs::write(&library, &program).unwrap();
        check_whole(&library).unwrap();
        for (bytes, expected) in [(program.len() - 1, "cut off"), (4096, "cut off"), (40, "no lib")]
        {
            std::fs::write(&library, &program[..bytes]).unwrap();
            let error = check_whole(&library).unwrap_err().to_string();
            assert!(error.contains(expected), "{bytes}: {error}");
        }
    }

    #[test]
    fn pooling_takes_the_first_token_or_the_mean_of_the_others() {
        let mut model = EncoderManifest::shipped().unwrap().models[0].clone();
        model.dimension = 2;
        let tokens = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(pool(&model, &tokens), Some(vec![1.0, 2.0]));
        model.pooling = Pooling::Mean;
        assert_eq!(pool(&model, &tokens), Some(vec![4.0, 5.0]));
        assert_eq!(pool(&model, &tokens[..2]), Some(vec![1.0, 2.0]));
        assert_eq!(pool(&model, &tokens[..1]), None);
    }
}
