//! Paths in the cache folder.
//!
//! `cargo xtask setup` fetches models and the runtime into it. This crate downloads nothing; it writes embeddings and
//! documents there.

use std::path::{Path, PathBuf};

use domain::{NoCacheFolder, cache_folder};

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

    /// ONNX Runtime's library.
    pub fn runtime(&self) -> PathBuf {
        self.root.join("onnxruntime").join("libonnxruntime.so")
    }

    /// The folder of embedding caches.
    pub fn embeddings(&self) -> PathBuf {
        self.root.join("embeddings")
    }
}
