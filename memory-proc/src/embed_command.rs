//! `memory-proc embed`: what an encoder makes of pictures, for people who try one out.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;

use crate::embedding::distance;
use crate::encoder::{Image, Open, Picture};
use crate::manifest::Manifest;
use crate::serve::EncoderSettings;

/// A picture that was read from a file.
#[derive(Debug)]
struct PngFile(image::RgbaImage);

impl Picture for Arc<PngFile> {
    fn image(&self) -> Image<'_> {
        let PngFile(picture) = &**self;
        Image { width: picture.width(), height: picture.height(), rgba: picture.as_raw() }
    }
}

/// Embeds PNG files, all of them `repeat` times, and prints a JSON object: the encoder, the files, the cosine
/// distance of each to each, and how many images a second it took.
///
/// # Errors
/// When a file is no PNG, or the encoder cannot be used.
pub fn run(
    files: &[PathBuf],
    repeat: NonZeroUsize,
    manifest: &Manifest,
    settings: &EncoderSettings,
) -> anyhow::Result<()> {
    let read = |file: &PathBuf| {
        let picture =
            image::open(file).with_context(|| format!("cannot read {}", file.display()))?;
        Ok(Arc::new(PngFile(picture.into_rgba8())))
    };
    let pictures = files.iter().map(read).collect::<anyhow::Result<Vec<_>>>()?;
    let mut encoder = settings.prepare(manifest)?.start(Open::AtOnce, || {});
    // How long sessions take to open is no matter of images a second.
    encoder.embed_all(pictures.iter().take(1).cloned())?;
    let begun = Instant::now();
    let mut embeddings = Vec::new();
    for _ in 0..repeat.get() {
        embeddings = encoder.embed_all(pictures.iter().cloned())?;
    }
    let images = pictures.len() * repeat.get();
    let rate = images as f64 / begun.elapsed().as_secs_f64();
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
        "provider": facts.provider,
        "precision": facts.precision.word(),
        "threads": facts.threads,
        "dimension": facts.dimension,
        "images_per_second": (rate * 10.0).round() / 10.0,
        "files": files,
        "distances": distances,
    });
    println!("{report:#}");
    Ok(())
}
