//! The encoder of a run: its settings, opening it with its known embeddings, and what the manifest says of it.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use shm_types::{ErrorReporter, Frame};

use super::{ServeSettings, Wake};
use crate::embedding_cache::EmbeddingCache;
use crate::encoder::{
    Encoder, EncoderFacts, Image, ImageSource, ModelFile, PreparedEncoder, Provider, SessionOpening,
};
use crate::manifest::EncoderManifest;
use crate::paths::{CacheFolder, RuntimeLibrary};

/// How the encoder runs.
#[derive(Debug, Clone)]
pub struct EncoderSettings {
    /// Its name in the manifest; `None`: the manifest's default.
    pub name: Option<String>,
    /// The model's file; `None`: the one that setup fetched.
    pub file: Option<PathBuf>,
    /// Worker threads.
    pub threads: NonZeroUsize,
    /// The hardware that it runs on.
    pub provider: Provider,
    /// The cache folder, with the models, the runtime and known embeddings.
    pub cache: CacheFolder,
}

impl EncoderSettings {
    /// Loads the model file and the runtime.
    ///
    /// # Errors
    /// When there is no such encoder, or something that it needs is missing or broken.
    pub fn prepare(&self, manifest: &EncoderManifest) -> anyhow::Result<PreparedEncoder> {
        let model = manifest.model(self.name.as_ref().unwrap_or(&manifest.default))?;
        let file = ModelFile::read(model, self.file.as_deref(), &self.cache)?;
        let runtime = RuntimeLibrary::from_environment(&self.cache);
        PreparedEncoder::new(file, &runtime, self.threads, self.provider)
    }
}

/// Opens the encoder of `settings`, if there is one, and its known embeddings.
pub(super) fn open_encoder(
    settings: &ServeSettings,
    wake: Wake,
    reporter: &mut ErrorReporter,
) -> anyhow::Result<(Option<Encoder>, EmbeddingCache)> {
    let Some(chosen) = &settings.encoder else { return Ok((None, EmbeddingCache::in_memory())) };
    let assets = settings.assets.as_deref();
    let manifest = assets.map_or_else(EncoderManifest::shipped, EncoderManifest::load)?;
    let encoder = chosen.prepare(&manifest)?;
    let mut embeddings = open_cache(&chosen.cache, encoder.facts(), reporter);
    if let Some(file) = &settings.shipped_embeddings {
        let EncoderFacts { model_fingerprint, dimension, .. } = encoder.facts();
        let shipped = embeddings.add_shipped(file, model_fingerprint, *dimension)?;
        tracing::debug!(shipped, "embeddings of the plan read");
    }
    // Known embeddings may be all that the run needs.
    let open =
        if embeddings.is_empty() { SessionOpening::Eagerly } else { SessionOpening::OnDemand };
    Ok((Some(encoder.start(open, move || wake())?), embeddings))
}

fn open_cache(
    cache: &CacheFolder,
    facts: &EncoderFacts,
    reporter: &mut ErrorReporter,
) -> EmbeddingCache {
    let folder = cache.embeddings();
    match EmbeddingCache::open(&folder, &facts.fingerprint, facts.dimension) {
        Ok(cache) => {
            tracing::debug!(embeddings = cache.len(), "embedding cache read");
            cache
        }
        Err(error) => {
            reporter.report(format_args!("{error}; the run continues without it"));
            EmbeddingCache::in_memory()
        }
    }
}

/// The facts about the encoder for the run's manifest.
pub(super) fn facts(facts: &EncoderFacts) -> Vec<(&'static str, String)> {
    vec![
        ("encoder", facts.model.clone()),
        ("encoder_sha256", facts.sha256.clone()),
        ("encoder_trained", facts.trained.to_string()),
        ("encoder_threads", facts.threads.to_string()),
        ("encoder_provider", facts.provider.word().to_owned()),
        ("onnxruntime", facts.runtime.clone()),
    ]
}

impl ImageSource for Arc<Frame> {
    fn image(&self) -> Image<'_> {
        let size = self.size();
        Image { width: size.width, height: size.height, rgba: self.pixels() }
    }
}
