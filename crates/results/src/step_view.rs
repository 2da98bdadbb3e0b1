//! One step of a finished episode: what the policy was given and what it answered.
//!
//! The run's log alone knows where the agent was, what it was told, what was retrieved and what it did. What the
//! policy was shown, said to a model and heard back is in the prompt log, where the run kept one.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use domain::prompt_log::{
    Hash, PromptLogEntry, RecordedPart, RecordedView, entries_file, image_file, line_start,
    session_folder, text_file, trajectories_file,
};
use domain::{Action, Pose};
use serde::Serialize;

use crate::log::{EpisodeRecord, EpisodeTimings, RunFolder, RunLog};

/// A step, as it is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Shown {
    /// The episode's key.
    pub key: String,
    /// Steps taken before.
    pub step: u32,
    /// Steps of the whole episode.
    pub steps: u32,
    /// Where the agent was.
    pub pose: Pose,
    /// What the world had said to the last action.
    pub feedback: &'static str,
    /// What was done; absent where the answer could not be read.
    pub action: Option<&'static str>,
    /// What memory retrieved, as the log writes it: `o12`, `t03-07:o4`, `-`. Absent where nothing is retrieved.
    pub retrieved: Option<String>,
    /// What the prompt log has; absent where it has nothing.
    pub prompt: Option<Prompt>,
}

/// What the prompt log has of a step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prompt {
    /// The entry.
    #[serde(flatten)]
    pub entry: PromptLogEntry,
    /// The demonstrations that memory supplied whole.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub demonstrations: Vec<Vec<RecordedView>>,
    /// The texts that the entry names, by their hash.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub texts: BTreeMap<Hash, String>,
    /// The images that the entry names, by their hash: where they are.
    pub images: BTreeMap<Hash, PathBuf>,
}

/// What step `step` of the episode of `record` was.
///
/// # Errors
/// When the episode has no such step, or a file of the prompt log cannot be used.
pub fn look_up(log: &RunLog, record: &EpisodeRecord, step: u32) -> Result<Shown> {
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
    Ok(Shown {
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

/// What the prompt log has of a step of the episode that `timings` are of.
fn prompt(log: &RunLog, timings: &EpisodeTimings, step: u32) -> Result<Option<Prompt>> {
    let folder = RunFolder::prompts_of(&log.dir);
    let file = entries_file(&session_folder(&folder, timings.session), timings.generation);
    if !file.exists() {
        return Ok(None);
    }
    let unreadable = || format!("cannot read {}", file.display());
    let start = line_start(timings.ticket, step);
    let mut found = None;
    for line in BufReader::new(File::open(&file).with_context(unreadable)?).lines() {
        let line = line.with_context(unreadable)?;
        if line.starts_with(&start) {
            found = Some(line);
        }
    }
    let Some(line) = found else { return Ok(None) };
    let entry: PromptLogEntry = serde_json::from_str(&line)
        .with_context(|| format!("step {step} in {}", file.display()))?;
    let read = |path: PathBuf| {
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let demonstrations: Vec<Vec<RecordedView>> = match &entry.request.trajectories {
        None => Vec::new(),
        Some(hash) => serde_json::from_str(&read(trajectories_file(&folder, hash))?)?,
    };
    let parts = || {
        let messages = entry.exchange.iter().flat_map(|exchange| &exchange.messages);
        messages.flat_map(|message| &message.parts)
    };
    let mut texts = BTreeMap::new();
    let documents = entry.request.documents.iter().map(|document| &document.text);
    let stored = parts().filter_map(|part| match part {
        RecordedPart::Stored(hash) => Some(hash),
        RecordedPart::Text(_) | RecordedPart::Image(_) | RecordedPart::Png(_) => None,
    });
    for hash in documents.chain(stored) {
        texts.insert(hash.clone(), read(text_file(&folder, hash))?);
    }
    let request = &entry.request;
    let window = request.window.iter().map(|past| &past.frame);
    let segment = request.segment.iter().flat_map(|segment| &segment.steps);
    let remembered = segment.chain(demonstrations.iter().flatten());
    let sent = parts().filter_map(|part| match part {
        RecordedPart::Image(hash) => Some(hash),
        RecordedPart::Text(_) | RecordedPart::Stored(_) | RecordedPart::Png(_) => None,
    });
    let images = std::iter::once(&request.frame)
        .chain(window)
        .chain(remembered.filter_map(|seen| seen.frame.as_ref()))
        .chain(sent)
        .map(|hash| (hash.clone(), image_file(&folder, hash)))
        .collect();
    Ok(Some(Prompt { entry, demonstrations, texts, images }))
}
