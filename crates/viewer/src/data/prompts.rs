//! The prompts of an episode: what its policy received and answered, word for word.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Result;
use domain::prompt_log::{Hash, RecordedItem, RecordedPart, RecordedView};
use run_log::EpisodeTimings;
use run_log::step_view::{PromptLog, RecordedPrompt, facts, planned, title};
use serde::Serialize;

/// The prompt of one step.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct PromptData {
    step: u32,
    hinted: bool,
    view: ImageData,
    window: Vec<ImageData>,
    items: Vec<ItemData>,
    messages: Vec<MessageData>,
    reply: Option<String>,
    unread: Option<String>,
    facts: Vec<(&'static str, String)>,
    /// The files of its images.
    #[serde(skip)]
    files: BTreeMap<Hash, PathBuf>,
}

/// An image by its hash, with a caption.
#[derive(Debug, Serialize)]
struct ImageData {
    image: Option<Hash>,
    caption: String,
}

#[derive(Debug, Serialize)]
struct ItemData {
    title: String,
    text: Option<String>,
    images: Vec<ImageData>,
}

#[derive(Debug, Serialize)]
struct MessageData {
    role: String,
    parts: Vec<PartData>,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "lowercase")]
enum PartData {
    Text(String),
    Image(Hash),
}

/// The logged prompts of the episode of `timings`, which took `steps` steps.
///
/// # Errors
/// When a file of the prompt log cannot be used.
pub fn prompts(
    log: &mut PromptLog,
    timings: &EpisodeTimings,
    steps: u32,
) -> Result<Vec<PromptData>> {
    let mut found = Vec::new();
    for step in 0..steps {
        found.extend(log.entry(timings, step)?.map(|prompt| prompt_data(step, prompt)));
    }
    Ok(found)
}

/// The images of `prompts`, each with its PNG file.
pub fn image_hashes(prompts: &[PromptData]) -> BTreeMap<Hash, PathBuf> {
    let files = prompts.iter().flat_map(|prompt| &prompt.files);
    files.map(|(hash, path)| (hash.clone(), path.clone())).collect()
}

fn prompt_data(step: u32, prompt: RecordedPrompt) -> PromptData {
    let request = &prompt.entry.request;
    let exchange = prompt.entry.exchange.as_ref();
    let window = request.window.iter().map(|past| {
        let action = past.action.as_deref().unwrap_or("not understood");
        let caption = format!("{action}: {}", past.feedback);
        ImageData { image: Some(past.frame.clone()), caption }
    });
    let message = |message: &domain::prompt_log::RecordedMessage| MessageData {
        role: message.role.clone(),
        parts: message
            .parts
            .iter()
            .filter_map(|part| match part {
                RecordedPart::Text(text) => Some(PartData::Text(text.clone())),
                RecordedPart::Stored(hash) => Some(PartData::Text(prompt.text(hash).to_owned())),
                RecordedPart::Image(hash) => Some(PartData::Image(hash.clone())),
                // Never in a log: images are stored as files.
                RecordedPart::Png(_) => None,
            })
            .collect(),
    };
    PromptData {
        step,
        hinted: request.starts_as_demonstrated,
        view: ImageData { image: Some(request.frame.clone()), caption: String::new() },
        window: window.collect(),
        items: request.items.iter().map(|item| item_data(item, &prompt)).collect(),
        messages: exchange.iter().flat_map(|one| &one.messages).map(message).collect(),
        reply: exchange.and_then(|exchange| exchange.reply.clone()),
        unread: exchange.and_then(|exchange| exchange.unread.clone()),
        facts: facts(&prompt),
        files: prompt.images.clone(),
    }
}

fn item_data(item: &RecordedItem, prompt: &RecordedPrompt) -> ItemData {
    let image = |(index, seen): (usize, &RecordedView)| {
        let action = seen.action.as_deref().unwrap_or_default();
        let caption = format!("{index}. {action}").trim_end().to_owned();
        ImageData { image: seen.frame.clone(), caption }
    };
    let row = |steps: &[RecordedView]| steps.iter().enumerate().map(image).collect();
    let (text, images) = match item {
        RecordedItem::Text { text, .. } => (Some(prompt.text(text).to_owned()), Vec::new()),
        RecordedItem::Segment { steps, .. } => (None, row(steps)),
        RecordedItem::Trajectory { steps, .. } => (None, row(prompt.trajectory(steps))),
        RecordedItem::Frame { frame, caption, .. } => {
            let caption = prompt.text(caption).to_owned();
            (None, vec![ImageData { image: Some(frame.clone()), caption }])
        }
        RecordedItem::Plan { parts } => {
            let lines: Vec<String> = parts.iter().map(planned).collect();
            (Some(lines.join("\n")), Vec::new())
        }
    };
    ItemData { title: title(item, prompt), text, images }
}
