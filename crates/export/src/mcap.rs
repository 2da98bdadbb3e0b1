//! Episodes as MCAP, with channels that Foxglove and Rerun show without set-up.
//!
//! | topic | message |
//! |---|---|
//! | `/camera` | `foxglove.CompressedImage`: the view that the policy was shown, as JPEG |
//! | `/tf` | `foxglove.FrameTransform`: `warehouse` to `agent` to `camera` |
//! | `/pose` | `foxglove.PoseInFrame`: the agent in the warehouse |
//! | `/events` | `foxglove.Log`: sub-goals, blocked moves, unreadable answers, why it failed |
//! | `/step` | `memtransfer.Step`, JSON: pose, in another world the state in words, feedback, action, what memory supplied |
//! | `/episode` | `memtransfer.Episode`, JSON: instruction, condition, outcome; once |
//!
//! One metre is one cell, x points east, y north, z up; the origin is the centre of cell 0,0. Steps have no duration, so the
//! time line is logical: it begins at 0, a step takes the same time everywhere, and episodes follow each other with a gap of
//! one step.

mod file;
mod foxglove;
mod protobuf;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result};
use domain::camera::CameraSetup;
use domain::{Cell, Pose};
use run_log::RunLog;
use run_log::source::{SourceStep, sources};
use serde::Serialize;
use serde_json::{Value, json};

use crate::moments::{EpisodeSink, Moments, Timing};
use file::{ChannelId, McapFile};

/// Nanoseconds in a second.
const SECOND: u64 = 1_000_000_000;

/// An MCAP file of episodes.
pub(crate) struct McapRecording {
    file: McapFile<BufWriter<File>>,
    channels: McapChannels,
    /// Whether states are poses: in the warehouse.
    has_poses: bool,
    step_ns: u64,
    /// When the next episode begins.
    begins_ns: u64,
}

struct McapChannels {
    camera: ChannelId,
    transforms: ChannelId,
    pose: ChannelId,
    events: ChannelId,
    step: ChannelId,
    episode: ChannelId,
}

#[derive(Serialize)]
struct McapStep<'a> {
    episode: &'a str,
    step: u32,
    #[serde(flatten)]
    state: McapState<'a>,
    feedback: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    action: Option<&'a str>,
    sub_goals_met: usize,
    sub_goals: u32,
    sources: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<&'a str>,
}

/// A pose, or the state in another world.
#[derive(Serialize)]
#[serde(untagged)]
enum McapState<'a> {
    Pose { x: u8, y: u8, heading: char },
    Words { state: &'a str },
}

#[derive(Serialize)]
struct McapEpisode<'a> {
    key: &'a str,
    instruction: &'a str,
    condition: String,
    case: &'a str,
    run: u32,
    success: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    failure: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    failure_step: Option<u32>,
    steps: u32,
    reference: u32,
}

impl McapRecording {
    /// A file at `path` of episodes of `log`.
    pub(crate) fn create(path: &Path, log: &RunLog, timing: Timing) -> Result<Self> {
        let file = durable::output::create(path)
            .with_context(|| format!("cannot write {}", path.display()))?;
        let mut file = McapFile::new(BufWriter::new(file))?;
        let mut foxglove = |topic: &str, message: &str| {
            let schema = foxglove::descriptor_set();
            file.channel(topic, &format!("foxglove.{message}"), "protobuf", &schema, "protobuf")
        };
        let channels = McapChannels {
            camera: foxglove("/camera", "CompressedImage")?,
            transforms: foxglove("/tf", "FrameTransform")?,
            pose: foxglove("/pose", "PoseInFrame")?,
            events: foxglove("/events", "Log")?,
            step: json_channel(&mut file, "/step", "Step", &step_schema())?,
            episode: json_channel(&mut file, "/episode", "Episode", &episode_schema())?,
        };
        let settings = &log.manifest.settings;
        file.metadata(
            "memtransfer",
            &[
                ("run", &log.name),
                ("version", &log.manifest.version),
                ("suite", settings.suite.word()),
                ("frames", &settings.frames.to_string()),
                ("policy", &log.manifest.policy_label().to_string()),
                ("seed", &settings.seed.to_string()),
                ("steps_per_second", &timing.steps_per_s.to_string()),
            ],
        )?;
        let step_ns = SECOND / u64::from(timing.steps_per_s.max(1));
        let has_poses = settings.own_world().is_none();
        Ok(Self { file, channels, has_poses, step_ns, begins_ns: 0 })
    }

    /// The time of a step, in nanoseconds from the beginning of the file.
    fn instant(&self, step: u32) -> u64 {
        self.begins_ns + u64::from(step) * self.step_ns
    }
}

fn json_channel(
    file: &mut McapFile<BufWriter<File>>,
    topic: &str,
    name: &str,
    schema: &Value,
) -> Result<ChannelId> {
    let schema = serde_json::to_vec(schema)?;
    Ok(file.channel(topic, &format!("memtransfer.{name}"), "jsonschema", &schema, "json")?)
}

/// The schema of a message, with the names of its properties by their type.
fn schema(title: &str, properties: &[(&str, &[&str])]) -> Value {
    let properties = properties.iter().flat_map(|(kind, names)| {
        let value = match *kind {
            "strings" => json!({ "type": "array", "items": { "type": "string" } }),
            kind => json!({ "type": kind }),
        };
        names.iter().map(move |name| ((*name).to_owned(), value.clone()))
    });
    let properties: serde_json::Map<String, Value> = properties.collect();
    json!({ "title": format!("memtransfer.{title}"), "type": "object", "properties": properties })
}

fn step_schema() -> Value {
    schema(
        "Step",
        &[
            ("string", &["episode", "heading", "state", "feedback", "action", "distances"]),
            ("integer", &["step", "x", "y", "sub_goals_met", "sub_goals"]),
            ("strings", &["sources"]),
        ],
    )
}

fn episode_schema() -> Value {
    schema(
        "Episode",
        &[
            ("string", &["key", "instruction", "condition", "case", "failure"]),
            ("integer", &["run", "failure_step", "steps", "reference"]),
            ("boolean", &["success"]),
        ],
    )
}

impl EpisodeSink for McapRecording {
    fn episode(&mut self, moments: &Moments<'_>) -> Result<()> {
        let timeline = &moments.timeline;
        let record = timeline.record;
        let failure = timeline.failure.as_ref();
        let about = McapEpisode {
            key: &record.key,
            instruction: &timeline.instruction,
            condition: record.condition().to_string(),
            case: &record.case,
            run: record.run,
            success: record.is_success(),
            failure: failure.map(|failure| failure.kind.as_str()),
            failure_step: failure.map(|failure| failure.step),
            steps: record.steps,
            reference: record.reference,
        };
        let begins = self.instant(0);
        self.file.message(self.channels.episode, begins, &serde_json::to_vec(&about)?);
        if self.has_poses {
            let mount = foxglove::camera_mount(begins, CameraSetup::of(record.mismatch));
            self.file.message(self.channels.transforms, begins, &mount);
        }
        let mut events = timeline.events.iter().peekable();
        for moment in &timeline.steps {
            let step = moment.step;
            let pose = self.has_poses.then(|| Pose::try_from(moment.state)).transpose()?;
            let at = self.instant(step);
            let image = moments.images.get(&moment.view).context("a view was not rendered")?;
            self.file.message(self.channels.camera, at, &foxglove::image(at, image));
            if let Some(pose) = pose {
                self.file.message(self.channels.transforms, at, &foxglove::agent(at, pose));
                self.file.message(self.channels.pose, at, &foxglove::pose(at, pose));
            }
            let supplied = sources(moment.retrieved.unwrap_or_default());
            let data = McapStep {
                episode: &record.key,
                step,
                state: match pose {
                    Some(Pose { cell: Cell { x, y }, heading }) => {
                        McapState::Pose { x, y, heading: heading.letter() }
                    }
                    None => McapState::Words { state: &moment.state_text },
                },
                feedback: &moment.feedback,
                action: moment.action.as_deref(),
                sub_goals_met: moment.sub_goals,
                sub_goals: record.required,
                sources: supplied.iter().map(SourceStep::in_words).collect(),
                distances: moment.distances,
            };
            self.file.message(self.channels.step, at, &serde_json::to_vec(&data)?);
            while let Some(event) = events.next_if(|event| event.step <= step) {
                let words = format!("step {step}: {}", event.words);
                let message = foxglove::log(at, event.level, &words, &record.key);
                self.file.message(self.channels.events, at, &message);
            }
        }
        self.begins_ns = self.instant(timeline.steps.len() as u32);
        self.file.end_chunk()?;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.file.finish().context("cannot finish the MCAP file")
    }
}
