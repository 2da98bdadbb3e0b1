//! The prompt: what a vision-language model is told about one request (SPEC sections 1, 2 and 5).
//!
//! One template for all representations, [`version`], whose every word stands in `prompt/v1.toml`. One system
//! message, always the same; one user message, with what changes least first, so that a server that keeps
//! prefixes computes it once: memory, task, recent steps, now. `docs/prompt.md` shows one in full.
//!
//! - [`Prompt::new`] renders a [`Request`] and nothing else, within an image budget (`budget`);
//! - [`answer`] reads the action in what the model writes back.
//!
//! What is not here: pixels and servers. An image in a prompt is the [`FrameView`] it shows; whoever sends the
//! prompt encodes it.

pub mod answer;
mod budget;
mod render;
mod template;

use std::sync::Arc;

use crate::chat::{Content, ImageUrl, Message, Part, Speaker};
use crate::{FrameView, Request};

/// Version of the template, as its file says it: `prompt/1`.
pub fn version() -> &'static str {
    &template::template().version
}

/// SHA-256 of the template's file, in hexadecimal: differs whenever any of its texts does.
pub fn template_sha256() -> String {
    template::sha256()
}

/// What a part of a prompt is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Section {
    /// How the world and the actions work, and how to answer: the system message.
    Rules,
    /// What memory supplies. The parts that differ between representations, and no others.
    Memory,
    /// What is asked for.
    Task,
    /// The last steps.
    Window,
    /// Where the agent is, what it sees, and what the world said last.
    Now,
}

impl Section {
    /// All five, in the order in which a prompt has them.
    pub const ALL: [Self; 5] = [Self::Rules, Self::Memory, Self::Task, Self::Window, Self::Now];

    /// The word in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rules => "rules",
            Self::Memory => "memory",
            Self::Task => "task",
            Self::Window => "window",
            Self::Now => "now",
        }
    }
}

/// Text or an image.
#[derive(Debug, Clone)]
pub enum PartContent<'a> {
    /// Text, never empty.
    Text(String),
    /// The image of a view.
    View(FrameView<'a>),
}

/// A piece of the user message.
#[derive(Debug, Clone)]
pub struct PromptPart<'a> {
    /// What it is about.
    pub section: Section,
    /// What it is.
    pub content: PartContent<'a>,
}

/// What a model is told for one step.
#[derive(Debug, Clone)]
pub struct Prompt<'a> {
    /// The system message.
    pub system: &'static str,
    /// The user message, in reading order. Texts that follow each other in one section are one part.
    pub parts: Vec<PromptPart<'a>>,
    /// Images that the request has. Those beyond the budget are not among the parts.
    pub images_asked: u32,
}

impl<'a> Prompt<'a> {
    /// The prompt for `request`, with at most `image_budget` images.
    ///
    /// What does not fit is left out in this order: keyframes of demonstrations, of which evenly spread ones
    /// stay; retrieved views, from the last; views of the window, from the oldest; the current view. A short
    /// text stands where an image was left out.
    pub fn new(request: &Request<'a>, image_budget: u32) -> Self {
        render::prompt(template::template(), request, image_budget)
    }

    /// The views whose images are sent, in reading order; one that is shown twice comes twice.
    pub fn views(&self) -> impl Iterator<Item = &FrameView<'a>> {
        self.parts.iter().filter_map(|part| match &part.content {
            PartContent::View(view) => Some(view),
            PartContent::Text(_) => None,
        })
    }

    /// Images that are sent.
    pub fn images_sent(&self) -> u32 {
        self.views().count() as u32
    }

    /// Images of `section` that are sent.
    pub fn images(&self, section: Section) -> u32 {
        let views = self
            .parts
            .iter()
            .filter(|part| part.section == section && matches!(part.content, PartContent::View(_)));
        views.count() as u32
    }

    /// Characters (Unicode scalar values) of text in `section`.
    pub fn characters(&self, section: Section) -> usize {
        let texts = self.parts.iter().filter(|part| part.section == section);
        let characters = texts.map(|part| match &part.content {
            PartContent::Text(text) => text.chars().count(),
            PartContent::View(_) => 0,
        });
        let parts: usize = characters.sum();
        if section == Section::Rules { parts + self.system.chars().count() } else { parts }
    }

    /// The two messages, with `url` for each image that is sent. Without an image the user message is one plain
    /// text, which servers of models that cannot see take too.
    pub fn messages(&self, mut url: impl FnMut(&FrameView<'a>) -> Arc<str>) -> [Message; 2] {
        let content = if self.images_sent() == 0 {
            let texts = self.parts.iter().filter_map(|part| match &part.content {
                PartContent::Text(text) => Some(text.as_str()),
                PartContent::View(_) => None,
            });
            Content::Text(texts.collect())
        } else {
            let parts = self.parts.iter().map(|part| match &part.content {
                PartContent::Text(text) => Part::Text { text: text.clone() },
                PartContent::View(view) => {
                    Part::ImageUrl { image_url: ImageUrl { url: url(view) } }
                }
            });
            Content::Parts(parts.collect())
        };
        [Message::text(Speaker::System, self.system), Message { role: Speaker::User, content }]
    }
}

/// How an image is named where it does not stand itself, in logs and golden files: `image:` and the
/// hexadecimal digits of its pixels' hash.
pub fn image_name(view: &FrameView<'_>) -> Arc<str> {
    let digits = view.content_hash.iter().map(|byte| format!("{byte:02x}"));
    digits.fold("image:".to_owned(), |name, digits| name + &digits).into()
}
