//! The prompts of an episode: what its policy received and answered, word for word.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Result;
use domain::prompt_log::{Hash, RecordedItem, RecordedPart, RecordedView};
use results::log::EpisodeTimings;
use results::step_view::{PromptLog, RecordedPrompt, facts, title};
use serde::Serialize;

/// The prompt of one step.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct PromptData {
    step: u32,
    hinted: bool,
    view: Image,
    window: Vec<Image>,
    items: Vec<Item>,
    messages: Vec<Message>,
    reply: Option<String>,
    unread: Option<String>,
    facts: Vec<(&'static str, String)>,
    /// The files of its images.
    #[serde(skip)]
    files: BTreeMap<Hash, PathBuf>,
}

/// An image by its hash, with a caption.
#[derive(Debug, Serialize)]
struct Image {
    image: Option<Hash>,
    caption: String,
}

#[derive(Debug, Serialize)]
struct Item {
    title: String,
    text: Option<String>,
    images: Vec<Image>,
}

#[derive(Debug, Serialize)]
struct Message {
    role: String,
    parts: Vec<Part>,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "lowercase")]
enum Part {
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
        Image { image: Some(past.frame.clone()), caption }
    });
    let message = |message: &domain::prompt_log::RecordedMessage| Message {
        role: message.role.clone(),
        parts: message
            .parts
            .iter()
            .filter_map(|part| match part {
                RecordedPart::Text(text) => Some(Part::Text(text.clone())),
                RecordedPart::Stored(hash) => Some(Part::Text(prompt.text(hash).to_owned())),
                RecordedPart::Image(hash) => Some(Part::Image(hash.clone())),
                // Never in a log: images are stored as files.
                RecordedPart::Png(_) => None,
            })
            .collect(),
    };
    PromptData {
        step,
        hinted: request.starts_as_demonstrated,
        view: Image { image: Some(request.frame.clone()), caption: String::new() },
        window: window.collect(),
        items: request.items.iter().map(|item| item_data(item, &prompt)).collect(),
        messages: exchange.iter().flat_map(|one| &one.messages).map(message).collect(),
        reply: exchange.and_then(|exchange| exchange.reply.clone()),
        unread: exchange.and_then(|exchange| exchange.unread.clone()),
        facts: facts(&prompt),
        files: prompt.images.clone(),
    }
}

fn item_data(item: &RecordedItem, prompt: &RecordedPrompt) -> Item {
    let image = |(index, seen): (usize, &RecordedView)| {
        let action = seen.action.as_deref().unwrap_or_default();
        let caption = format!("{index}. {action}").trim_end().to_owned();
        Image { image: seen.frame.clone(), caption }
    };
    let row = |steps: &[RecordedView]| steps.iter().enumerate().map(image).collect();
    let (text, images) = match item {
        RecordedItem::Text { text, .. } => (Some(prompt.text(text).to_owned()), Vec::new()),
        RecordedItem::Segment { steps, .. } => (None, row(steps)),
        RecordedItem::Trajectory(hash) => (None, row(prompt.trajectory(hash))),
        RecordedItem::Frame { frame, caption } => {
            let caption = prompt.text(caption).to_owned();
            (None, vec![Image { image: Some(frame.clone()), caption }])
        }
    };
    Item { title: title(item, prompt), text, images }
}
