//! Embedding views, cold: how many a second, beside ONNX Runtime from Python with the same model on as many threads; and
//! whether the precision that makes it fast leaves what is retrieved as it is.
//!
//! Ours is everything from a frame's bytes to an embedding; the baseline is given tensors that are ready. Retrieval is
//! compared over everything that can be asked in the unchanged world: from every pose, the nearest of each case's
//! demonstration views, of all of its demonstrations together and of each alone.

use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use domain::Pose;
use memory_proc::demonstrations::selected;
use memory_proc::embedding::{Embedding, distance};
use memory_proc::encoder::{Encoder, EncoderFacts, Image, ModelFile, Open, Picture, Prepared};
use memory_proc::manifest::{Manifest, Precision};
use memory_proc::paths::Cache;
use serde_json::json;
use shm_types::attach::FrameSize;
use sim_proc::control::every_pose;
use sim_proc::renderer::{Destination, RenderJob, RenderSettings, Renderer, View};
use warehouse::{CaseSet, Demonstrations, Variant, Warehouse};

use crate::Bench;
use crate::baselines::Baseline;
use crate::figure::{Better, Bound, Figure};
use crate::search::threads;
use crate::session::Session;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "embed",
    about: "embedding views beside ONNX Runtime from Python, and whether what is retrieved stays as it is",
    run,
};

/// Images that either side embeds a round.
const IMAGES: usize = 128;

/// A frame's pixels.
#[derive(Clone)]
pub(crate) struct Frame(Arc<[u8]>);

impl Picture for Frame {
    fn image(&self) -> Image<'_> {
        let FrameSize { width, height } = FrameSize::DEFAULT;
        Image { width, height, rgba: &self.0 }
    }
}

fn run(session: &mut Session<'_>) -> Result<Vec<Figure>> {
    let warehouse = Warehouse::shipped();
    let libraries = libraries(&warehouse, session.size.pick(1, usize::MAX))?;
    let poses: Vec<Pose> = match session.size.pick(Some(4), None) {
        Some(few) => libraries.iter().flatten().copied().take(few).collect(),
        None => every_pose(&warehouse.layout).collect(),
    };
    session.say(format_args!("drawing {} views", poses.len()));
    let frames = drawn(&warehouse, &poses)?;
    // Spread over the hall.
    let apart = (frames.len() / IMAGES).max(1);
    let some: Vec<Frame> = frames.iter().step_by(apart).take(IMAGES).cloned().collect();

    let (mut own, mut exact) = (open(None)?, open(Some(Precision::F32))?);
    let (mut fast, mut slow, mut theirs) = (Vec::new(), Vec::new(), Vec::new());
    let mut baseline = match session.baselines {
        Some(baselines) => Some(Baseline::start(baselines, "onnx_runtime.py", session.scratch())?),
        None => None,
    };
    let opened = match &mut baseline {
        Some(baseline) => {
            let model = default_model()?.path;
            baseline.ask(&json!({"do": "open", "model": model, "threads": threads()}))?
        }
        None => json!({}),
    };
    for round in 1..=session.rounds() {
        session.say(format_args!("round {round}"));
        fast.push(rate(&mut own, &some)?);
        if let Some(baseline) = &mut baseline {
            let request = json!({"do": "time", "images": IMAGES});
            theirs.push(baseline.ask_number(&request, "images_per_second")?);
        }
        slow.push(rate(&mut exact, &some)?);
    }
    drop(baseline);

    let rates = |id: &str, what: &str, values: Vec<f64>, facts: &EncoderFacts| {
        let figure = Figure::new(id, what, "images/s", Better::Higher)
            .ours(values)
            .parameter("encoder", &facts.model)
            .parameter("precision", facts.precision.word())
            .parameter("threads", facts.threads)
            .note("ours from a frame's bytes on; the baseline is given tensors that are ready");
        let said = |key: &str| opened[key].as_str().unwrap_or_default();
        if theirs.is_empty() {
            return figure;
        }
        figure
            .baseline("ONNX Runtime from Python", said("version"), theirs.clone())
            .parameter("baseline's setting", said("setting"))
    };
    let mut figures = vec![
        rates("embed.cold", "embedding, cold", fast, own.facts()).target(Bound::Ratio(2.0), "2 x"),
        rates("embed.cold-f32", "embedding, cold, at f32", slow, exact.facts()),
    ];
    if own.facts().precision != Precision::F32 {
        session.say("embedding every view at both precisions");
        let nearly = own.embed_all(frames.iter().cloned())?;
        let exactly = exact.embed_all(frames)?;
        let retrieved = retrieval(&places(&libraries, &poses), &nearly, &exactly);
        figures.push(retrieved.parameter("precision", own.facts().precision.word()));
    }
    Ok(figures)
}

/// What an encoder of the default model is made from.
fn default_model() -> Result<ModelFile> {
    let manifest = Manifest::shipped()?;
    let model = manifest.model(&manifest.default)?;
    Ok(ModelFile::read(model, None, &Cache::from_environment()?)?)
}

/// The default encoder, with a worker for each core; its sessions are open.
pub(crate) fn open(precision: Option<Precision>) -> Result<Encoder> {
    let threads = NonZeroUsize::new(threads()).context("no thread")?;
    let runtime = Cache::from_environment()?.runtime();
    let prepared = Prepared::new(default_model()?, &runtime, threads, precision)?;
    let mut encoder = prepared.start(Open::AtOnce, || {});
    let black = Frame(vec![0; FrameSize::DEFAULT.bytes()].into());
    // One for each worker: who is at one does not take another.
    encoder.embed_all(std::iter::repeat_n(black, threads.get()))?;
    Ok(encoder)
}

/// Images a second when all of these are embedded.
pub(crate) fn rate(encoder: &mut Encoder, frames: &[Frame]) -> Result<f64> {
    let began = Instant::now();
    encoder.embed_all(frames.iter().cloned())?;
    Ok(frames.len() as f64 / began.elapsed().as_secs_f64())
}

/// Views of the unchanged world, as a run sees them.
pub(crate) fn drawn(warehouse: &Warehouse, poses: &[Pose]) -> Result<Vec<Frame>> {
    let mut renderer = Renderer::new(warehouse, RenderSettings::default())?;
    let unchanged = Variant::UNCHANGED;
    let mut draw = |&pose: &Pose| {
        let mut rgba = vec![0; renderer.frame_bytes()];
        let view = View { pose, variant: &unchanged };
        renderer.render(&mut [RenderJob { view, destination: Destination::Memory(&mut rgba) }])?;
        Ok(Frame(rgba.into()))
    };
    poses.iter().map(&mut draw).collect()
}

/// The demonstration views among which the nearest is looked for: of the first `most` cases, all that a case has and
/// those of each of its demonstrations.
fn libraries(warehouse: &Warehouse, most: usize) -> Result<Vec<BTreeSet<Pose>>> {
    let cases = CaseSet::shipped();
    let mut libraries = Vec::new();
    for case in 0..cases.cases.len().min(most) {
        let walks = selected(warehouse, &cases, case as u32, Demonstrations::ALL.bits())
            .with_context(|| format!("there is no case {case}"))?;
        let each = walks.iter().map(|walk| walk.poses.iter().copied().collect());
        let all = walks.iter().flat_map(|walk| &walk.poses).copied().collect();
        libraries.extend(each.chain([all]));
    }
    Ok(libraries)
}

/// Each library by the places of its poses among `poses`.
fn places(libraries: &[BTreeSet<Pose>], poses: &[Pose]) -> Vec<Vec<usize>> {
    let places = |library: &BTreeSet<Pose>| {
        let known = poses.iter().enumerate().filter(|(_, pose)| library.contains(pose));
        known.map(|(place, _)| place).collect()
    };
    libraries.iter().map(places).collect()
}

/// How often the nearest view is the same with both embeddings of the same views: asked from every view, of every
/// library.
fn retrieval(libraries: &[Vec<usize>], nearly: &[Embedding], exactly: &[Embedding]) -> Figure {
    let (mut questions, mut same, mut gaps) = (0_u32, 0_u32, Vec::new());
    for asked in 0..exactly.len() {
        let from = |all: &[Embedding]| -> Vec<f32> {
            all.iter().map(|to| distance(all[asked].as_slice(), to.as_slice())).collect()
        };
        let (near, exact) = (from(nearly), from(exactly));
        for library in libraries {
            let nearest =
                |far: &[f32]| library.iter().copied().min_by(|&a, &b| far[a].total_cmp(&far[b]));
            let (Some(found), Some(right)) = (nearest(&near), nearest(&exact)) else { continue };
            questions += 1;
            // Views that look the same to the exact encoder are one answer.
            if exact[found] == exact[right] {
                same += 1;
            } else {
                gaps.push((exact[found] - exact[right]) / exact[found]);
            }
        }
    }
    let share = 100.0 * f64::from(same) / f64::from(questions.max(1));
    let widest = gaps.iter().copied().fold(0.0, f32::max);
    let what = "questions whose nearest demonstration view is the one that f32 finds";
    Figure::new("embed.same-top-1", what, "%", Better::Higher)
        .ours([share])
        .baseline("the same encoder at f32", "", [100.0])
        .target(Bound::Value(100.0), "unchanged")
        .parameter("questions", questions)
        .parameter("views", exactly.len())
        .note(format!(
            "{} changed; at f32 the found view is farther than the nearest by {widest:.1e} of its distance at most",
            gaps.len()
        ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_another_view_at_another_distance_is_a_change() {
        let at = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Embedding::normalised(&[cos, sin]).unwrap()
        };
        let exactly = [at(0.0), at(10.0), at(20.0)];
        let nearly = [at(0.0), at(20.0), at(10.0)];
        let figure = |libraries: &[Vec<usize>]| retrieval(libraries, &nearly, &exactly).ours[0];
        // From the first view the nearest of the other two is another; from either of them it is itself.
        assert!((figure(&[vec![1, 2]]) - 200.0 / 3.0).abs() < 1e-9);
        assert_eq!(figure(&[vec![0], vec![]]), 100.0);
    }
}
