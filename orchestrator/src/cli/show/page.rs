//! One step as an HTML page, images inside, without scripts.

use std::collections::BTreeMap;
use std::fs;

use anyhow::{Context, Result};
use askama::Template;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use domain::prompt_log::{RecordedItem, RecordedPart, RecordedView};

use super::text;
use results::step_view::{RecordedPrompt, StepView};

#[derive(Template)]
#[template(path = "show.html")]
struct StepPage<'a> {
    shown: &'a StepView,
    instruction: &'a str,
    hinted: bool,
    elsewhere: bool,
    now: ImageFigure,
    window: Vec<ImageFigure>,
    memory: Vec<MemoryItem<'a>>,
    /// Where the items come from, in words.
    sources: Option<String>,
    messages: Vec<PromptMessage<'a>>,
    reply: Option<&'a str>,
    unread: Option<&'a str>,
    facts: Vec<(&'static str, String)>,
    style: &'static str,
}

/// An image with a caption.
struct ImageFigure {
    /// The image as a data URL; none for a step without a view.
    url: Option<String>,
    lines: Vec<String>,
}

/// An item of memory: a text, or a row of images.
struct MemoryItem<'a> {
    title: String,
    text: Option<&'a str>,
    images: Vec<ImageFigure>,
}

struct PromptMessage<'a> {
    role: &'a str,
    parts: Vec<MessagePart<'a>>,
}

enum MessagePart<'a> {
    Text(&'a str),
    Image(String),
}

/// Renders the page.
///
/// # Errors
/// When an image cannot be read.
pub(super) fn render(shown: &StepView, prompt: &RecordedPrompt) -> Result<String> {
    let mut urls = BTreeMap::new();
    for (hash, path) in &prompt.images {
        let png = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        urls.insert(hash, format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png)));
    }
    let url = |hash: &String| urls.get(hash).cloned();
    let request = &prompt.entry.request;
    let window = request.window.iter().map(|past| {
        let action = past.action.as_deref().unwrap_or("not understood").to_owned();
        ImageFigure { url: url(&past.frame), lines: vec![action, past.feedback.clone()] }
    });
    let image = |(index, seen): (usize, &RecordedView)| {
        let action = seen.action.clone().unwrap_or_default();
        let lines = vec![format!("{index}. {action}").trim_end().to_owned()];
        ImageFigure { url: seen.frame.as_ref().and_then(url), lines }
    };
    let row = |steps: &[RecordedView]| steps.iter().enumerate().map(image).collect();
    let memory = request.items.iter().map(|item| {
        let (text, images) = match item {
            RecordedItem::Text { text, .. } => (Some(prompt.text(text)), Vec::new()),
            RecordedItem::Segment { steps, .. } => (None, row(steps)),
            RecordedItem::Trajectory(hash) => (None, row(prompt.trajectory(hash))),
            RecordedItem::Frame { frame, caption } => {
                let lines = vec![prompt.text(caption).to_owned()];
                (None, vec![ImageFigure { url: url(frame), lines }])
            }
        };
        MemoryItem { title: text::title(item, prompt), text, images }
    });
    let exchange = prompt.entry.exchange.as_ref();
    let messages =
        exchange.iter().flat_map(|exchange| &exchange.messages).map(|message| PromptMessage {
            role: &message.role,
            parts: message
                .parts
                .iter()
                .filter_map(|part| match part {
                    RecordedPart::Text(text) => Some(MessagePart::Text(text)),
                    RecordedPart::Stored(hash) => Some(MessagePart::Text(prompt.text(hash))),
                    RecordedPart::Image(hash) => url(hash).map(MessagePart::Image),
                    // Never in a log: images are stored as files.
                    RecordedPart::Png(_) => None,
                })
                .collect(),
        });
    let page = StepPage {
        shown,
        instruction: &request.instruction,
        hinted: request.starts_as_demonstrated,
        elsewhere: request.demonstrated_elsewhere,
        now: ImageFigure { url: url(&request.frame), lines: Vec::new() },
        window: window.collect(),
        memory: memory.collect(),
        sources: shown.retrieved.as_deref().map(text::in_words),
        messages: messages.collect(),
        reply: exchange.and_then(|exchange| exchange.reply.as_deref()),
        unread: exchange.and_then(|exchange| exchange.unread.as_deref()),
        facts: text::facts(prompt),
        style: include_str!("../../../templates/show.css"),
    };
    Ok(page.render()?)
}
