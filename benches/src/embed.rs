//! Embedding views that are not cached: images per second, beside ONNX Runtime from Python with the same model on as
//! many threads. Ours starts from a frame's bytes; the baseline gets prepared tensors.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use domain::Pose;
use memory_proc::encoder::{
    Encoder, Image, ImageSource, ModelFile, PreparedEncoder, SessionOpening,
};
use memory_proc::manifest::EncoderManifest;
use memory_proc::paths::{CacheFolder, RuntimeLibrary};
use serde_json::json;
use shm_types::attach::FrameSize;
use sim_proc::renderer::{RenderSettings, Renderer, ViewSpec};
use warehouse::every_pose;
use warehouse::{Variant, Warehouse};

use crate::session::threads;
use crate::{Baseline, Bench, BenchSession, Measurement, Target};

/// The bench.
pub const BENCH: Bench =
    Bench { name: "embed", about: "embedding views beside ONNX Runtime from Python", run };

/// Images that either side embeds per round.
const IMAGES: usize = 128;

/// A frame's pixels.
#[derive(Clone)]
struct FramePixels(Arc<[u8]>);

impl ImageSource for FramePixels {
    fn image(&self) -> Image<'_> {
        let FrameSize { width, height } = FrameSize::DEFAULT;
        Image { width, height, rgba: &self.0 }
    }
}

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    let warehouse = Warehouse::shipped();
    let all: Vec<Pose> = every_pose(&warehouse.layout).collect();
    // Spread over the hall.
    let count = session.size.pick(4, IMAGES);
    let poses: Vec<Pose> =
        all.iter().step_by((all.len() / count).max(1)).take(count).copied().collect();
    session.progress(format_args!("rendering {} views", poses.len()));
    let frames = drawn(session, &warehouse, &poses)?;
    let mut encoder = open(session)?;
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    let mut baseline = match session.python {
        Some(python) => Some(Baseline::start(python, "onnx_runtime.py", session.scratch())?),
        None => None,
    };
    let opened = match &mut baseline {
        Some(baseline) => {
            let model = default_model()?.path;
            let provider = session.hardware.provider.word();
            baseline.ask(&json!({
                "do": "open", "model": model, "threads": threads(), "provider": provider,
            }))?
        }
        None => json!({}),
    };
    for round in 1..=session.rounds {
        session.progress(format_args!("round {round}"));
        ours.push(rate(&mut encoder, &frames)?);
        if let Some(baseline) = &mut baseline {
            let request = json!({"do": "time", "images": IMAGES});
            theirs.push(baseline.ask_number(&request, "images_per_second")?);
        }
    }
    drop(baseline);

    let (facts, version) = (encoder.facts(), opened["version"].as_str().unwrap_or_default());
    let mut measurement = Measurement::new("embed.cold", "embedding images", "images/s", ours)
        .beside(format!("ONNX Runtime {version} from Python"), theirs)
        .target(Target::RatioAtLeast(1.0))
        .parameter("encoder", &facts.model)
        .parameter("provider", facts.provider.word())
        .parameter("threads", facts.threads);
    if let Some(setting) = opened["setting"].as_str() {
        measurement = measurement.parameter("baseline's setting", setting);
    }
    Ok(vec![measurement])
}

/// The file of the default model.
fn default_model() -> Result<ModelFile> {
    let manifest = EncoderManifest::shipped()?;
    let model = manifest.model(&manifest.default)?;
    ModelFile::read(model, None, &CacheFolder::from_environment()?)
}

/// The default encoder, with a worker for each core; its sessions are open.
fn open(session: &BenchSession<'_>) -> Result<Encoder> {
    let threads = NonZeroUsize::new(threads()).context("no thread")?;
    let runtime = RuntimeLibrary::from_environment(&CacheFolder::from_environment()?);
    let provider = session.hardware.provider;
    let prepared = PreparedEncoder::new(default_model()?, &runtime, threads, provider)?;
    let mut encoder = prepared.start(SessionOpening::Eagerly, || {})?;
    let black = FramePixels(vec![0; FrameSize::DEFAULT.bytes()].into());
    // One per worker, so that every worker opens its session.
    encoder.embed_all(std::iter::repeat_n(black, threads.get()))?;
    Ok(encoder)
}

/// Images per second while all of these are embedded.
fn rate(encoder: &mut Encoder, frames: &[FramePixels]) -> Result<f64> {
    let began = Instant::now();
    encoder.embed_all(frames.iter().cloned())?;
    Ok(frames.len() as f64 / began.elapsed().as_secs_f64())
}

/// Views of the unchanged world, rendered with the settings of a run.
fn drawn(
    session: &BenchSession<'_>,
    warehouse: &Warehouse,
    poses: &[Pose],
) -> Result<Vec<FramePixels>> {
    let backend = Some(session.hardware.backend);
    let settings = RenderSettings { backend, ..RenderSettings::default() };
    let mut renderer = Renderer::new(warehouse, settings)?;
    let unchanged = Variant::UNCHANGED;
    let draw = |&pose: &Pose| {
        let image = renderer.render_image(ViewSpec { pose, variant: &unchanged, stock: 0 })?;
        Ok(FramePixels(image.as_bytes().into()))
    };
    poses.iter().map(draw).collect()
}
