//! Where the things that setup fetches lie: one cache folder outside the repository.
//!
//! `cargo xtask setup` fills it and this crate only reads it, except for the embeddings and documents, which
//! are written here. Nothing is ever downloaded by this crate.

use std::path::{Path, PathBuf};

use domain::{NoCacheFolder, cache_folder};

/// The cache folder.
#[derive(Debug, Clone)]
pub struct Cache {
    root: PathBuf,
}

impl Cache {
    /// The cache in `folder`.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { root: folder.into() }
    }

    /// The cache that the environment names ([`cache_folder`]).
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

    /// Where setup puts the model file called `file`.
    pub fn model(&self, file: &str) -> PathBuf {
        self.root.join("models").join(file)
    }

    /// Where setup puts ONNX Runtime.
    pub fn runtime(&self) -> PathBuf {
        self.root.join("onnxruntime").join("libonnxruntime.so")
    }

    /// The folder of the documents that the builder called `builder` made.
    pub fn documents(&self, builder: &str) -> PathBuf {
        self.root.join("documents").join(builder)
    }

    /// The folder of embedding files.
    pub fn embeddings(&self) -> PathBuf {
        self.root.join("embeddings")
    }
}
