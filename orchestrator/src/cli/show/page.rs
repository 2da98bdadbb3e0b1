//! A step as one HTML page that needs nothing else: images are in it, scripts there are none.

use std::collections::BTreeMap;
use std::fs;

use anyhow::{Context, Result};
use askama::Template;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use domain::prompt_log::{RecordedPart, RecordedView};

use super::text;
use results::step_view::{Prompt, Shown};

#[derive(Template)]
#[template(path = "show.html")]
struct Page<'a> {
    shown: &'a Shown,
    instruction: &'a str,
    hinted: bool,
    now: Picture,
    window: Vec<Picture>,
    memory: Vec<Strip>,
    documents: Vec<(String, &'a str)>,
    messages: Vec<Message<'a>>,
    reply: Option<&'a str>,
    unread: Option<&'a str>,
    facts: Vec<(&'static str, String)>,
    style: &'static str,
}

/// An image with what is said below it.
struct Picture {
    /// The image, as a URL that holds it; none for a step without a view.
    url: Option<String>,
    lines: Vec<String>,
}

/// A row of images.
struct Strip {
    title: String,
    pictures: Vec<Picture>,
}

struct Message<'a> {
    role: &'a str,
    parts: Vec<Piece<'a>>,
}

enum Piece<'a> {
    Text(&'a str),
    Image(String),
}

/// The page.
///
/// # Errors
/// When an image cannot be read.
pub(super) fn render(shown: &Shown, prompt: &Prompt) -> Result<String> {
    let mut urls = BTreeMap::new();
    for (hash, path) in &prompt.images {
        let png = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        urls.insert(hash, format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png)));
    }
    let url = |hash: &String| urls.get(hash).cloned();
    let request = &prompt.entry.request;
    let window = request.window.iter().map(|past| {
        let action = past.action.as_deref().unwrap_or("not understood").to_owned();
        Picture { url: url(&past.frame), lines: vec![action, past.feedback.clone()] }
    });
    let picture = |(index, seen): (usize, &RecordedView)| {
        let action = seen.action.clone().unwrap_or_default();
        let lines = vec![format!("{index}. {action}").trim_end().to_owned()];
        Picture { url: seen.frame.as_ref().and_then(url), lines }
    };
    let strip = |title: String, steps: &[RecordedView]| {
        let pictures = steps.iter().enumerate().map(picture).collect();
        Strip { title, pictures }
    };
    let retrieved = request.segment.iter().map(|segment| {
        strip(format!("Retrieved, at distance {:.4}", segment.distance), &segment.steps)
    });
    let whole = (1..).zip(&prompt.demonstrations);
    let whole = whole.map(|(number, steps)| strip(format!("Demonstration {number}"), steps));
    let text = |hash: &String| prompt.texts.get(hash).map_or("", String::as_str);
    let exchange = prompt.entry.exchange.as_ref();
    let messages = exchange.iter().flat_map(|exchange| &exchange.messages).map(|message| Message {
        role: &message.role,
        parts: message
            .parts
            .iter()
            .filter_map(|part| match part {
                RecordedPart::Text(text) => Some(Piece::Text(text)),
                RecordedPart::Stored(hash) => Some(Piece::Text(text(hash))),
                RecordedPart::Image(hash) => url(hash).map(Piece::Image),
                // Never in a log.
                RecordedPart::Png(_) => None,
            })
            .collect(),
    });
    let page = Page {
        shown,
        instruction: &request.instruction,
        hinted: request.starts_as_demonstrated,
        now: Picture { url: url(&request.frame), lines: Vec::new() },
        window: window.collect(),
        memory: retrieved.chain(whole).collect(),
        documents: request
            .documents
            .iter()
            .map(|document| (document.kind.clone(), text(&document.text)))
            .collect(),
        messages: messages.collect(),
        reply: exchange.and_then(|exchange| exchange.reply.as_deref()),
        unread: exchange.and_then(|exchange| exchange.unread.as_deref()),
        facts: text::facts(prompt),
        style: include_str!("../../../templates/show.css"),
    };
    Ok(page.render()?)
}
