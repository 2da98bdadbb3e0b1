//! Paths in the cache folder, and the place of ONNX Runtime.
//!
//! In a checkout `cargo xtask setup` fetches models and the runtime into the cache folder; for programs of the wheel they lie in its
//! Python environment. This crate downloads nothing; it writes embeddings and documents into the cache folder.

use std::path::{Path, PathBuf};

use domain::{NoCacheFolder, RUNTIME_FILE, RUNTIME_VARIABLE, cache_folder};

use crate::environment::PythonEnvironment;

/// ONNX Runtime's library, which the process loads as code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RuntimeLibrary {
    /// The one in the cache folder. It is used only if its hash is that of a library that set-up fetches.
    Cached(PathBuf),
    /// The one of the package `onnxruntime` in the environment of this program. It is used only if its hash is that of a release
    /// which the wheel allows.
    Installed(PathBuf),
    /// One of the user's own.
    Own(PathBuf),
}

impl RuntimeLibrary {
    /// The library that the environment names ([`RUNTIME_VARIABLE`]), else the one in the Python environment of this
    /// program, else the one in `cache`.
    pub fn from_environment(cache: &CacheFolder) -> Self {
        match std::env::var_os(RUNTIME_VARIABLE).filter(|path| !path.is_empty()) {
            Some(path) => Self::Own(path.into()),
            None => PythonEnvironment::of_this_program()
                .runtime()
                .map_or_else(|| cache.runtime(), Self::Installed),
        }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        match self {
            Self::Cached(path) | Self::Installed(path) | Self::Own(path) => path,
        }
    }
}

/// The cache folder.
#[derive(Debug, Clone)]
pub struct CacheFolder {
    root: PathBuf,
}

impl CacheFolder {
    /// The cache in `folder`.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { root: folder.into() }
    }

    /// The cache folder that the environment names ([`cache_folder`]).
    ///
    /// # Errors
    /// When it names none.
    pub fn from_environment() -> Result<Self, NoCacheFolder> {
        cache_folder().map(Self::at)
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The model file called `file`.
    pub fn model(&self, file: &str) -> PathBuf {
        self.root.join("models").join(file)
    }

    /// ONNX Runtime's library in it.
    pub fn runtime(&self) -> RuntimeLibrary {
        RuntimeLibrary::Cached(self.root.join(RUNTIME_FILE))
    }

    /// The folder of embedding caches.
    pub fn embeddings(&self) -> PathBuf {
        self.root.join("embeddings")
    }
}
