//! The model builder: asks a chat endpoint to write the documents.
//!
//! - Summary by sequential summarisation: the summary so far and as many further demonstrations as fit become a
//!   new summary, until there are no more.
//! - Semantic in three stages: notes are *extracted* from groups of demonstrations, *consolidated* until one
//!   set is left, and *refined* to a document.
//!
//! Every request and its reply are kept as they come, so a build that was stopped goes on where it was. What is
//! not here: HTTP, which is `policy-proc`'s.

mod chat;
mod pipe;
mod prompt;
mod steps;
mod telling;

use std::path::Path;

use anyhow::{Context, bail, ensure};
use domain::DocumentKind;

pub use chat::{Chat, ChatError, Message, Outcome, Reply, Request, Speaker};
pub use pipe::{Ask, Pipe};
pub use prompt::PROMPT_VERSION;

use self::prompt::Stage;
use self::steps::Steps;
use super::{Account, Builder, Built, Transcript};

/// Characters to a token, at the least: coordinates and digits make short tokens.
const CHARS_PER_TOKEN: usize = 2;

/// Most bytes of a document: more than this no prompt has room for beside its images.
const LARGEST_DOCUMENT: usize = 256 << 10;

/// What decides, besides the demonstrations and the prompts, what a document says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// Most characters of a prompt.
    pub context_chars: usize,
    /// Most tokens of an answer, and so of the document.
    pub max_tokens: u32,
}

impl Settings {
    /// Most characters of a prompt where nobody says otherwise: some 40,000 tokens.
    pub const CONTEXT_CHARS: usize = 100_000;
    /// Most tokens of an answer where nobody says otherwise: the paper's summaries have about 13,000.
    pub const MAX_TOKENS: u32 = 16_000;
}

/// Writes documents with a model's help.
#[derive(Debug)]
pub struct ModelBuilder<C> {
    chat: C,
    settings: Settings,
}

impl<C: Chat> ModelBuilder<C> {
    /// One that asks by `chat`.
    pub fn new(chat: C, settings: Settings) -> Self {
        Self { chat, settings }
    }
}

impl<C: Chat> Builder for ModelBuilder<C> {
    fn name(&self) -> &str {
        "model"
    }

    fn version(&self) -> String {
        let Settings { model, context_chars, max_tokens } = &self.settings;
        format!(
            "prompts {PROMPT_VERSION}, model {model}, {context_chars} characters to {max_tokens} tokens"
        )
    }

    fn build(
        &mut self,
        kind: DocumentKind,
        transcripts: &[Transcript],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<Built> {
        let told: Vec<String> =
            (1..).zip(transcripts).map(|(number, one)| telling::tell(number, one)).collect();
        let mut work = Work {
            chat: &mut self.chat,
            settings: &self.settings,
            steps: Steps::open(steps, &self.settings.model)?,
            account: Ledger::default(),
        };
        let text = match kind {
            DocumentKind::Summary => work.summary(&told, progress)?,
            DocumentKind::Semantic => work.semantic(&told, progress)?,
            DocumentKind::Trajectories => bail!("{} are no text to be written", kind.word()),
        };
        ensure!(
            text.len() <= LARGEST_DOCUMENT,
            "the model's document has {} bytes, and {LARGEST_DOCUMENT} is the most that can be supplied: lower \
             the tokens of an answer",
            text.len()
        );
        work.steps.finish()?;
        Ok(Built { text: text + "\n", account: work.account.account() })
    }
}

/// A document in the making.
struct Work<'a> {
    chat: &'a mut dyn Chat,
    settings: &'a Settings,
    steps: Steps,
    account: Ledger,
}

impl Work<'_> {
    fn summary(
        &mut self,
        told: &[String],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        let mut summary = "(There is none yet.)".to_owned();
        let mut done = 0;
        while done < told.len() {
            progress(done, told.len());
            let room = self.room(Stage::Summary, &summary);
            let next = fitting(&told[done..], room);
            ensure!(
                next > 0,
                "demonstration {} has {} characters, and beside a summary of {} only {room} of the {} of a \
                 prompt are left: let a prompt have more, or an answer fewer tokens",
                done + 1,
                chars(&told[done]),
                chars(&summary),
                self.settings.context_chars
            );
            let demonstrations = told[done..done + next].join("\n");
            let values = [("so_far", &*summary), ("demonstrations", &demonstrations)];
            summary = self.ask(Stage::Summary, &values, &mut || progress(done, told.len()))?;
            done += next;
        }
        progress(done, told.len());
        ensure!(done > 0, "there are no demonstrations to summarise");
        Ok(summary)
    }

    fn semantic(
        &mut self,
        told: &[String],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        // Consolidating and refining count as a part each.
        let parts = told.len() + 2;
        let mut notes = Vec::new();
        let mut done = 0;
        for demonstrations in self.groups(Stage::Extract, told)? {
            progress(done, parts);
            let joined = demonstrations.join("\n");
            let values = [("demonstrations", &*joined)];
            notes.push(self.ask(Stage::Extract, &values, &mut || progress(done, parts))?);
            done += demonstrations.len();
        }
        ensure!(!notes.is_empty(), "there are no demonstrations to learn from");
        progress(parts - 2, parts);
        loop {
            let groups = self.groups(Stage::Consolidate, &notes)?;
            ensure!(
                groups.len() == 1 || groups.len() < notes.len(),
                "no two of {} sets of notes fit into a prompt of {} characters: let a prompt have more, or an \
                 answer fewer tokens",
                notes.len(),
                self.settings.context_chars
            );
            let mut fewer = Vec::new();
            for group in groups {
                let joined = (1..)
                    .zip(group)
                    .map(|(number, notes): (u32, _)| format!("## Notes {number}\n{notes}\n"))
                    .collect::<Vec<_>>()
                    .join("\n");
                let values = [("notes", &*joined)];
                let waiting = &mut || progress(parts - 2, parts);
                fewer.push(self.ask(Stage::Consolidate, &values, waiting)?);
            }
            notes = fewer;
            if notes.len() == 1 {
                break;
            }
        }
        progress(parts - 1, parts);
        let waiting = &mut || progress(parts - 1, parts);
        let document = self.ask(Stage::Refine, &[("notes", &notes[0])], waiting)?;
        progress(parts, parts);
        Ok(document)
    }

    /// `texts` in groups, in order, each of which fits into a prompt of `stage`.
    fn groups<'t>(&self, stage: Stage, texts: &'t [String]) -> anyhow::Result<Vec<&'t [String]>> {
        let room = self.room(stage, "");
        let mut groups = Vec::new();
        let mut rest = texts;
        while !rest.is_empty() {
            let count = fitting(rest, room);
            ensure!(
                count > 0,
                "a text of {} characters for the stage `{}` does not fit into the {room} that are left of the {} \
                 of a prompt: let a prompt have more",
                chars(&rest[0]),
                stage.name(),
                self.settings.context_chars
            );
            let (group, after) = rest.split_at(count);
            groups.push(group);
            rest = after;
        }
        Ok(groups)
    }

    /// Characters that a prompt of `stage` has room for, beside its own words and `other`.
    fn room(&self, stage: Stage, other: &str) -> usize {
        let Request { messages, .. } = self.request(stage, &[]);
        let own: usize = messages.iter().map(|message| chars(&message.content)).sum();
        self.settings.context_chars.saturating_sub(own + chars(other))
    }

    fn request(&self, stage: Stage, values: &[(&str, &str)]) -> Request {
        let max_tokens = self.settings.max_tokens;
        let limit = (max_tokens as usize * CHARS_PER_TOKEN).to_string();
        let values: Vec<_> = values.iter().copied().chain([("limit", &*limit)]).collect();
        stage.request(max_tokens, &values)
    }

    /// The model's answer at a stage, without what models wrap around an answer; never empty.
    fn ask(
        &mut self,
        stage: Stage,
        values: &[(&str, &str)],
        waiting: &mut dyn FnMut(),
    ) -> anyhow::Result<String> {
        let request = self.request(stage, values);
        let chat = &mut *self.chat;
        let doing = || format!("the stage `{}` of the document failed", stage.name());
        let reply = self
            .steps
            .next(stage, &request, || Ok(usable(chat.ask(&request, waiting)?)?))
            .with_context(doing)?;
        self.account.add(&reply);
        if reply.outcome == Outcome::Length {
            tracing::warn!(
                "an answer at the stage `{}` reached its {} tokens; the end of it is left out",
                stage.name(),
                request.max_tokens
            );
        }
        text_of(&reply).map(str::to_owned).with_context(doing)
    }
}

/// `reply`, when a document can be made of it: only such replies are kept.
fn usable(reply: Reply) -> Result<Reply, ChatError> {
    let problem = match (reply.outcome, text_of(&reply)) {
        (Outcome::Empty, _) => "the model answered with nothing".to_owned(),
        (Outcome::Refusal, _) => format!("the model refused to answer: {:?}", reply.text),
        (Outcome::Text | Outcome::Length, Some(_)) => return Ok(reply),
        (Outcome::Text, None) => "the model's answer has no text in it".to_owned(),
        (Outcome::Length, None) => {
            "the model's answer was cut off before its first sentence ended: let it have more tokens"
                .to_owned()
        }
    };
    Err(ChatError::NoReply(format!("{problem}; start again, or ask another model")))
}

/// What a reply says: without a fence around it, and of one that was cut off its whole lines, or, when it has but
/// one, its whole sentences. `None` when nothing is left.
fn text_of(reply: &Reply) -> Option<&str> {
    let mut text = reply.text.trim();
    if reply.outcome == Outcome::Length {
        let end = text.rfind('\n').or_else(|| Some(text.rfind(". ")? + 1))?;
        text = &text[..end];
    }
    if let Some(inside) = text.strip_prefix("```") {
        // The rest of the first line names a language.
        (_, text) = inside.split_once('\n')?;
        text = text.trim_end().strip_suffix("```").unwrap_or(text);
    }
    Some(text.trim()).filter(|text| !text.is_empty())
}

/// How many of `texts`, from the first, fit into `room` characters, each on lines of its own.
fn fitting(texts: &[String], room: usize) -> usize {
    let mut used = 0;
    let fits = |text: &&String| {
        // What joins texts: a line's end, and a headline over notes.
        used += chars(text) + "## Notes 1234\n\n\n".len();
        used <= room
    };
    texts.iter().take_while(fits).count()
}

fn chars(text: &str) -> usize {
    text.chars().count()
}

/// What the replies of a document came to.
#[derive(Debug, Default)]
struct Ledger {
    requests: u64,
    cut_off: u64,
    models: Vec<String>,
    prompt_tokens: Sum,
    completion_tokens: Sum,
}

/// A sum that is absent when a part of it is.
#[derive(Debug, Clone, Copy)]
struct Sum(Option<u64>);

impl Default for Sum {
    fn default() -> Self {
        Self(Some(0))
    }
}

impl Sum {
    fn add(&mut self, part: Option<u64>) {
        let Self(sum) = self;
        *sum = sum.zip(part).and_then(|(sum, part)| sum.checked_add(part));
    }
}

impl Ledger {
    fn add(&mut self, reply: &Reply) {
        self.requests += 1;
        self.cut_off += u64::from(reply.outcome == Outcome::Length);
        if let Some(model) = &reply.model
            && !self.models.contains(model)
        {
            self.models.push(model.clone());
        }
        self.prompt_tokens.add(reply.prompt_tokens);
        self.completion_tokens.add(reply.completion_tokens);
    }

    fn account(self) -> Account {
        let Self { requests, cut_off, models, prompt_tokens, completion_tokens } = self;
        Account {
            model: (!models.is_empty()).then(|| models.join(", ")),
            prompt_version: Some(PROMPT_VERSION),
            requests: Some(requests),
            cut_off: Some(cut_off),
            prompt_tokens: prompt_tokens.0,
            completion_tokens: completion_tokens.0,
        }
    }
}

#[cfg(test)]
#[path = "model/tests.rs"]
mod tests;
