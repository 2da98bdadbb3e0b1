//! One step of a finished episode.
//!
//! Pose, feedback, retrieval and action come from the run's log; the request, the exchange with the model and the
//! answer from its prompt log, where it has one.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use domain::prompt_log::{
    Hash, PromptLogEntry, RecordedItem, RecordedPart, RecordedView, entries_file, image_file,
    line_start, session_folder, text_file, trajectory_file,
};
use domain::{Action, Pose};
use serde::Serialize;

use crate::log::{EpisodeRecord, EpisodeTimings, RunFolder, RunLog};

/// One step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepView {
    /// The episode's key.
    pub key: String,
    /// Steps taken before.
    pub step: u32,
    /// Steps of the whole episode.
    pub steps: u32,
    /// The agent's pose.
    pub pose: Pose,
    /// The feedback on the last action.
    pub feedback: &'static str,
    /// The action; absent where the answer could not be read.
    pub action: Option<&'static str>,
    /// The retrieval, as the log writes it: `o12`, `t03-07:o4`, `-`. Absent where nothing is retrieved.
    pub retrieved: Option<String>,
    /// The entry of the prompt log; absent where there is none.
    pub prompt: Option<RecordedPrompt>,
}

/// The prompt log's entry about a step, with everything that it refers to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedPrompt {
    /// The entry.
    #[serde(flatten)]
    pub entry: PromptLogEntry,
    /// The demonstrations that memory supplied whole, by their hash.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub trajectories: BTreeMap<Hash, Vec<RecordedView>>,
    /// The texts that the entry names, by their hash.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub texts: BTreeMap<Hash, String>,
    /// The files of the images that the entry names, by their hash.
    pub images: BTreeMap<Hash, PathBuf>,
}

impl RecordedPrompt {
    /// The text with this hash.
    pub fn text(&self, hash: &str) -> &str {
        self.texts.get(hash).map_or("", String::as_str)
    }

    /// The demonstration with this hash.
    pub fn trajectory(&self, hash: &str) -> &[RecordedView] {
        self.trajectories.get(hash).map_or(&[], Vec::as_slice)
    }
}

/// Returns step `step` of the episode of `record`.
///
/// # Errors
/// When the episode has no such step, or a file of the prompt log cannot be used.
pub fn look_up(log: &RunLog, record: &EpisodeRecord, step: u32) -> Result<StepView> {
    if step >= record.steps {
        bail!(
            "{} has {} steps, so its steps are 0 to {}: there is no step {step}",
            record.key,
            record.steps,
            record.steps.saturating_sub(1)
        );
    }
    let (pose, feedback) = record.replay()[step as usize];
    let timings = log.timings.iter().find(|timings| timings.key == record.key);
    let retrieved = record.retrieved.as_deref();
    Ok(StepView {
        key: record.key.clone(),
        step,
        steps: record.steps,
        pose,
        feedback: feedback.words(),
        action: action_at(record, step).map(Action::words),
        retrieved: retrieved
            .and_then(|words| words.split_whitespace().nth(step as usize))
            .map(str::to_owned),
        prompt: timings.map(|timings| prompt(log, timings, step)).transpose()?.flatten(),
    })
}

fn action_at(record: &EpisodeRecord, step: u32) -> Option<Action> {
    Action::from_letter(record.actions.chars().nth(step as usize)?)
}

/// Reads the prompt log's entry about a step of the episode of `timings`.
fn prompt(log: &RunLog, timings: &EpisodeTimings, step: u32) -> Result<Option<RecordedPrompt>> {
    let folder = RunFolder::prompts_of(&log.dir);
    let file = entries_file(&session_folder(&folder, timings.session), timings.generation);
    if !file.exists() {
        return Ok(None);
    }
    let unreadable = || format!("cannot read {}", file.display());
    let start = line_start(timings.episode, step);
    let mut found = None;
    for line in BufReader::new(File::open(&file).with_context(unreadable)?).lines() {
        let line = line.with_context(unreadable)?;
        if line.starts_with(&start) {
            found = Some(line);
        }
    }
    let Some(line) = found else { return Ok(None) };
    let entry: PromptLogEntry = serde_json::from_str(&line).with_context(|| {
        format!(
            "step {step} in {} cannot be read: another version of MemTransfer wrote it",
            file.display()
        )
    })?;
    let read = |path: PathBuf| {
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let request = &entry.request;
    let mut trajectories: BTreeMap<Hash, Vec<RecordedView>> = BTreeMap::new();
    let (mut texts, mut images) = (Vec::new(), vec![&request.frame]);
    images.extend(request.window.iter().map(|past| &past.frame));
    for item in &request.items {
        match item {
            RecordedItem::Text { text, .. } => texts.push(text),
            RecordedItem::Segment { steps, .. } => {
                images.extend(steps.iter().filter_map(|step| step.frame.as_ref()));
            }
            RecordedItem::Trajectory(hash) => {
                let steps = serde_json::from_str(&read(trajectory_file(&folder, hash))?)?;
                trajectories.insert(hash.clone(), steps);
            }
            RecordedItem::Frame { frame, caption } => {
                images.push(frame);
                texts.push(caption);
            }
        }
    }
    let messages = entry.exchange.iter().flat_map(|exchange| &exchange.messages);
    for part in messages.flat_map(|message| &message.parts) {
        match part {
            RecordedPart::Stored(hash) => texts.push(hash),
            RecordedPart::Image(hash) => images.push(hash),
            RecordedPart::Text(_) | RecordedPart::Png(_) => {}
        }
    }
    let keyframes = trajectories.values().flatten().filter_map(|step| step.frame.as_ref());
    let images = images.into_iter().chain(keyframes);
    let images = images.map(|hash| (hash.clone(), image_file(&folder, hash))).collect();
    let read_text = |hash: &Hash| Ok((hash.clone(), read(text_file(&folder, hash))?));
    let texts = texts.into_iter().map(read_text).collect::<Result<_>>()?;
    Ok(Some(RecordedPrompt { entry, trajectories, texts, images }))
}
