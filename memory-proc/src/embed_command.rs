//! `memory-proc embed` embeds images and prints their distances, to try an encoder. `memory-proc embeddings` writes those that
//! are known to a file, for other machines.

use std::io::{BufWriter, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, bail};

use png_file::RgbaImage;
use search::distance;

use crate::embedding_cache::EmbeddingCache;
use crate::encoder::{Image, ImageSource, SessionOpening};
use crate::manifest::EncoderManifest;
use crate::serve::EncoderSettings;

impl ImageSource for Arc<RgbaImage> {
    fn image(&self) -> Image<'_> {
        Image { width: self.width(), height: self.height(), rgba: self.as_bytes() }
    }
}

/// Embeds PNG files `repeat` times, and prints a JSON object: the encoder, the files, their pairwise cosine distances
/// and the number of images embedded per second.
///
/// # Errors
/// When a file is not a PNG image, or the encoder cannot be used.
pub fn run(
    files: &[PathBuf],
    repeat: NonZeroUsize,
    manifest: &EncoderManifest,
    settings: &EncoderSettings,
) -> anyhow::Result<()> {
    let read = |file: &PathBuf| match RgbaImage::read(file) {
        Ok(image) => Ok(Arc::new(image)),
        // The error names the file.
        Err(error) => bail!("cannot read {error}"),
    };
    let images = files.iter().map(read).collect::<anyhow::Result<Vec<_>>>()?;
    let mut encoder = settings.prepare(manifest)?.start(SessionOpening::Eagerly, || {})?;
    // Opening the sessions is not measured.
    encoder.embed_all(images.iter().take(1).cloned())?;
    let begun = Instant::now();
    let mut embeddings = Vec::new();
    for _ in 0..repeat.get() {
        embeddings = encoder.embed_all(images.iter().cloned())?;
    }
    let count = images.len() * repeat.get();
    let rate = count as f64 / begun.elapsed().as_secs_f64();
    let distances: Vec<Vec<f32>> = embeddings
        .iter()
        .map(|a| embeddings.iter().map(|b| distance(a.as_slice(), b.as_slice())).collect())
        .collect();
    let facts = encoder.facts();
    let report = serde_json::json!({
        "encoder": facts.model,
        "trained": facts.trained,
        "sha256": facts.sha256,
        "onnxruntime": facts.runtime,
        "provider": facts.provider.word(),
        "threads": facts.threads,
        "dimension": facts.dimension,
        "images_per_second": (rate * 10.0).round() / 10.0,
        "files": files,
        "distances": distances,
    });
    writeln!(std::io::stdout(), "{report:#}").context("cannot write to standard output")?;
    Ok(())
}

/// Writes the known embeddings of the encoder to the file `out`, and prints the encoder's files as a JSON list.
///
/// # Errors
/// When the encoder or its cache cannot be used, or `out` not be written.
pub fn ship(
    out: &Path,
    manifest: &EncoderManifest,
    settings: &EncoderSettings,
) -> anyhow::Result<()> {
    let encoder = settings.prepare(manifest)?;
    let facts = encoder.facts();
    let folder = settings.cache.embeddings();
    let cache = EmbeddingCache::open(&folder, &facts.fingerprint, facts.dimension)?;
    let write = || {
        let mut file = BufWriter::new(durable::output::create(out)?);
        cache.ship(&facts.model_fingerprint, &mut file)
    };
    write().with_context(|| format!("cannot write {}", out.display()))?;
    let files = serde_json::to_string(&encoder.files())?;
    writeln!(std::io::stdout(), "{files}").context("cannot write to standard output")?;
    Ok(())
}
