//! Where the things that setup fetches lie: one cache folder outside the repository.
//!
//! `cargo xtask setup` fills it and this crate only reads it, except for the embeddings and documents, which
//! are written here. Nothing is ever downloaded by this crate.

use std::path::{Path, PathBuf};

/// The environment names no folder in which a cache could lie.
#[derive(Debug, thiserror::Error)]
#[error(
    "no cache folder: none of MEMTRANSFER_CACHE, XDG_CACHE_HOME and HOME is set; pass --cache DIR"
)]
pub struct NoCacheFolder;

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

    /// The cache that the environment names: `$MEMTRANSFER_CACHE`, else `$XDG_CACHE_HOME/memtransfer`,
    /// else `~/.cache/memtransfer`.
    ///
    /// # Errors
    /// When none of the three variables is set.
    pub fn from_environment() -> Result<Self, NoCacheFolder> {
        let set =
            |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        set("MEMTRANSFER_CACHE")
            .or_else(|| Some(set("XDG_CACHE_HOME")?.join("memtransfer")))
            .or_else(|| Some(set("HOME")?.join(".cache").join("memtransfer")))
            .map(Self::at)
            .ok_or(NoCacheFolder)
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
