//! The prompt of a vision-language model (specification, sections 1, 2 and 5).
//!
//! One [`Template`] serves all representations; the texts of the built-in one are in `v2.toml`. A prompt is one system
//! message, always the same, and one user message that begins with what changes least, so that a server with a prefix
//! cache reads it once: memory, task, recent steps, now. `docs/prompt.md` shows one in full.
//!
//! - [`Prompt::new`] renders a [`Request`] within an image budget;
//! - [`read_answer`] finds the action in a model's answer;
//! - [`image`] encodes views for a request.
//!
//! Asking a model is left to the `llm` crate.

mod answer;
mod budget;
pub mod image;
mod render;
mod template;
#[cfg(test)]
mod tests;

use peer::{FrameView, Request, WorldDeclaration};
use serde_json::{Value, json};

pub use answer::{UnreadAnswer, read_answer, read_cut_off_answer};
pub use template::{Template, TemplateError};

/// The answers that a model may give, for servers that can restrict it to them.
pub fn answer_choices(world: &WorldDeclaration) -> Vec<&str> {
    world.action_codes().map(|code| world.action_words(code)).collect()
}

/// The settings of the benchmark's requests in a world, in the words of the OpenAI interface.
pub fn request_settings(world: &WorldDeclaration) -> Value {
    json!({
        "temperature": 0.0,
        "max_tokens": ANSWER_TOKENS,
        "image_budget": IMAGE_BUDGET,
        "choices": answer_choices(world),
    })
}

/// Maximum number of tokens of an answer, by default.
pub const ANSWER_TOKENS: u32 = 30;

/// Maximum number of images of a prompt, by default.
pub const IMAGE_BUDGET: u32 = 50;

/// A section of a prompt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PromptSection {
    /// The system message: how the world and the actions work, and how to answer.
    Rules,
    /// What memory supplies. Representations differ here and nowhere else.
    Memory,
    /// The task.
    Task,
    /// The last steps.
    Window,
    /// The current pose, view and feedback.
    Now,
}

impl PromptSection {
    /// All sections, in the order of a prompt.
    pub const ALL: [Self; 5] = [Self::Rules, Self::Memory, Self::Task, Self::Window, Self::Now];

    /// The name in files.
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

/// A part of the user message.
#[derive(Debug, Clone)]
pub struct PromptPart<'a> {
    /// The section that it belongs to.
    pub section: PromptSection,
    /// Its content.
    pub content: PartContent<'a>,
}

/// The prompt for one request.
#[derive(Debug, Clone)]
pub struct Prompt<'a> {
    /// The system message.
    pub system: String,
    /// The user message, in reading order. Adjacent texts of one section are one part.
    pub parts: Vec<PromptPart<'a>>,
    /// Images of the request. Those beyond the budget are not among the parts.
    pub images_asked: u32,
}

impl<'a> Prompt<'a> {
    /// The prompt for `request` in the words of `template`, with at most `image_budget` images.
    ///
    /// Images that do not fit are left out in this order: keyframes of demonstrations, of which evenly spread ones stay;
    /// retrieved views, from the last; views of the window, from the oldest; the current view. A short text replaces each.
    pub fn new(template: &Template, request: &Request<'a>, image_budget: u32) -> Self {
        render::prompt(template.texts(), request, image_budget)
    }

    /// The views whose images are sent, in reading order; one that is shown twice comes twice.
    pub fn views(&self) -> impl Iterator<Item = &FrameView<'a>> {
        self.parts.iter().filter_map(|part| match &part.content {
            PartContent::View(view) => Some(view),
            PartContent::Text(_) => None,
        })
    }

    /// Number of images that are sent.
    pub fn images_sent(&self) -> u32 {
        self.views().count() as u32
    }

    /// Number of images of `section` that are sent.
    pub fn images(&self, section: PromptSection) -> u32 {
        let views = self
            .parts
            .iter()
            .filter(|part| part.section == section && matches!(part.content, PartContent::View(_)));
        views.count() as u32
    }

    /// Characters (Unicode scalar values) of text in `section`.
    pub fn characters(&self, section: PromptSection) -> usize {
        let texts = self.parts.iter().filter(|part| part.section == section);
        let characters = texts.map(|part| match &part.content {
            PartContent::Text(text) => text.chars().count(),
            PartContent::View(_) => 0,
        });
        let parts: usize = characters.sum();
        if section == PromptSection::Rules { parts + self.system.chars().count() } else { parts }
    }
}
