//! The model builder: asks a model to write documents.
//!
//! - A summary is built sequentially: the summary so far and as many further demonstrations as fit into a prompt become
//!   a new summary, until no demonstrations are left.
//! - A semantic document is built in three stages: notes are *extracted* from groups of demonstrations, *consolidated*
//!   until one set is left, and *refined* to a document.
//!
//! Every reply is stored when it arrives, so an interrupted build continues where it was. The crate `llm` sends the
//! requests.

mod narration;
mod prompt;
mod steps;

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use case_book::{Demonstration, WorldDeclaration};
use documents::{BuildAccount, ModelRecipe, PROMPT_VERSION};
use domain::DocumentKind;
use llm::{ChatClient, ChatReply, ReplyContent};

pub use self::prompt::DocumentPrompt;

use self::prompt::PromptStage;
use self::steps::StepFolder;
use super::{BuiltText, DocumentBuilder};

/// Minimum number of characters in a token. Coordinates and digits make short tokens.
const CHARS_PER_TOKEN: usize = 2;

/// Maximum size of a document: a larger one leaves no room in a prompt beside its images.
const MAX_DOCUMENT_BYTES: usize = 256 << 10;

/// How often progress is reported while a reply is awaited.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(1);

/// Sends prompts to a model. The second argument is called about once a second until the reply arrives.
pub trait AskModel: FnMut(&DocumentPrompt, &mut dyn FnMut()) -> anyhow::Result<ChatReply> {}

impl<F: FnMut(&DocumentPrompt, &mut dyn FnMut()) -> anyhow::Result<ChatReply>> AskModel for F {}

/// Sends prompts through a chat client.
pub fn ask_through(client: ChatClient) -> impl AskModel {
    move |prompt: &DocumentPrompt, waiting: &mut dyn FnMut()| {
        let (sender, replies) = mpsc::channel();
        client.submit(prompt.request(), 0, move |result| {
            // The build may have been given up.
            drop(sender.send(result));
        });
        loop {
            match replies.recv_timeout(PROGRESS_INTERVAL) {
                Ok(answered) => return Ok(answered?.reply),
                Err(RecvTimeoutError::Timeout) => waiting(),
                Err(RecvTimeoutError::Disconnected) => bail!("the chat client dropped a request"),
            }
        }
    }
}

/// Builds documents by asking a model.
#[derive(Debug)]
pub struct ModelBuilder<A> {
    ask: A,
    recipe: ModelRecipe,
}

impl<A: AskModel> ModelBuilder<A> {
    /// Creates a builder that follows `recipe` and sends its prompts with `ask`.
    pub fn new(ask: A, recipe: ModelRecipe) -> Self {
        Self { ask, recipe }
    }
}

impl<A: AskModel> DocumentBuilder for ModelBuilder<A> {
    fn build(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<BuiltText> {
        let narrated: Vec<String> = (1..)
            .zip(demonstrations)
            .map(|(number, of)| narration::narrate(number, world, of))
            .collect();
        let mut draft = Draft {
            ask: &mut self.ask,
            recipe: &self.recipe,
            steps: StepFolder::open(steps, &self.recipe.model)?,
            models: Vec::new(),
            account: BuildAccount {
                model: None,
                prompt_version: Some(PROMPT_VERSION),
                requests: Some(0),
                cut_off: None,
                prompt_tokens: Some(0),
                completion_tokens: Some(0),
            },
        };
        let text = match kind {
            DocumentKind::Summary => draft.summary(&narrated, progress)?,
            DocumentKind::Semantic => draft.semantic(&narrated, progress)?,
            DocumentKind::Trajectories | DocumentKind::Note => {
                bail!("a document of kind {} is not built", kind.word())
            }
        };
        ensure!(
            text.len() <= MAX_DOCUMENT_BYTES,
            "the model's document has {} bytes; at most {MAX_DOCUMENT_BYTES} fit into a prompt: lower --max-tokens",
            text.len()
        );
        draft.steps.finish()?;
        let model = (!draft.models.is_empty()).then(|| draft.models.join(", "));
        Ok(BuiltText { text: text + "\n", account: BuildAccount { model, ..draft.account } })
    }
}

/// A document that is being written.
struct Draft<'a> {
    ask: &'a mut dyn AskModel,
    recipe: &'a ModelRecipe,
    steps: StepFolder,
    /// The models that have answered, each once.
    models: Vec<String>,
    account: BuildAccount,
}

impl Draft<'_> {
    fn summary(
        &mut self,
        narrated: &[String],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        let mut summary = "(There is none yet.)".to_owned();
        let mut done = 0;
        while done < narrated.len() {
            progress(done, narrated.len());
            let room = self.room(PromptStage::Summary, &summary);
            let next = fitting(&narrated[done..], room);
            ensure!(
                next > 0,
                "demonstration {} has {} characters, and beside a summary of {} there is room for {room} of the {} in \
                 a prompt: raise --context-chars or lower --max-tokens",
                done + 1,
                chars(&narrated[done]),
                chars(&summary),
                self.recipe.context_chars
            );
            let demonstrations = narrated[done..done + next].join("\n");
            let values = [("so_far", &*summary), ("demonstrations", &demonstrations)];
            summary =
                self.ask(PromptStage::Summary, &values, &mut || progress(done, narrated.len()))?;
            done += next;
        }
        progress(done, narrated.len());
        ensure!(done > 0, "there are no demonstrations to summarise");
        Ok(summary)
    }

    fn semantic(
        &mut self,
        narrated: &[String],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        // Consolidation and refinement count as one part each.
        let parts = narrated.len() + 2;
        let mut notes = Vec::new();
        let mut done = 0;
        for demonstrations in self.groups(PromptStage::Extract, narrated)? {
            progress(done, parts);
            let joined = demonstrations.join("\n");
            let values = [("demonstrations", &*joined)];
            notes.push(self.ask(PromptStage::Extract, &values, &mut || progress(done, parts))?);
            done += demonstrations.len();
        }
        ensure!(!notes.is_empty(), "there are no demonstrations to learn from");
        progress(parts - 2, parts);
        loop {
            let groups = self.groups(PromptStage::Consolidate, &notes)?;
            ensure!(
                groups.len() == 1 || groups.len() < notes.len(),
                "no two of {} sets of notes fit into a prompt of {} characters: raise --context-chars or lower \
                 --max-tokens",
                notes.len(),
                self.recipe.context_chars
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
                fewer.push(self.ask(PromptStage::Consolidate, &values, waiting)?);
            }
            notes = fewer;
            if notes.len() == 1 {
                break;
            }
        }
        progress(parts - 1, parts);
        let waiting = &mut || progress(parts - 1, parts);
        let document = self.ask(PromptStage::Refine, &[("notes", &notes[0])], waiting)?;
        progress(parts, parts);
        Ok(document)
    }

    /// Splits `texts` into consecutive groups that fit into a prompt of `stage`.
    fn groups<'t>(
        &self,
        stage: PromptStage,
        texts: &'t [String],
    ) -> anyhow::Result<Vec<&'t [String]>> {
        let room = self.room(stage, "");
        let mut groups = Vec::new();
        let mut rest = texts;
        while !rest.is_empty() {
            let count = fitting(rest, room);
            ensure!(
                count > 0,
                "a text of {} characters for the stage `{}` does not fit: a prompt of {} has room for {room}; raise \
                 --context-chars",
                chars(&rest[0]),
                stage.name(),
                self.recipe.context_chars
            );
            let (group, after) = rest.split_at(count);
            groups.push(group);
            rest = after;
        }
        Ok(groups)
    }

    /// Characters that fit into a prompt of `stage` beside its own words and `other`.
    fn room(&self, stage: PromptStage, other: &str) -> usize {
        let own = self.prompt(stage, &[]).chars();
        self.recipe.context_chars.saturating_sub(own + chars(other))
    }

    fn prompt(&self, stage: PromptStage, values: &[(&str, &str)]) -> DocumentPrompt {
        let max_tokens = self.recipe.max_tokens;
        let limit = (max_tokens as usize * CHARS_PER_TOKEN).to_string();
        let values: Vec<_> = values.iter().copied().chain([("limit", &*limit)]).collect();
        stage.prompt(max_tokens, &values)
    }

    /// The model's answer at a stage, without a fence around it; never empty.
    fn ask(
        &mut self,
        stage: PromptStage,
        values: &[(&str, &str)],
        waiting: &mut dyn FnMut(),
    ) -> anyhow::Result<String> {
        let prompt = self.prompt(stage, values);
        let ask = &mut *self.ask;
        let failed = || format!("the stage `{}` of the document failed", stage.name());
        let reply = self
            .steps
            .next(stage, &prompt, usable, || ask(&prompt, waiting))
            .with_context(failed)?;
        count(&mut self.account, &reply);
        let known = |model: &&String| self.models.contains(model);
        self.models.extend(reply.model.as_ref().filter(|model| !known(model)).cloned());
        text_of(&reply).map(str::to_owned).with_context(failed)
    }
}

/// Refuses a reply without a whole text, so that neither it nor a document made of it is stored: a document without its end
/// would be scored as if it were the representation.
fn usable(reply: ChatReply) -> anyhow::Result<ChatReply> {
    let problem = match (&reply.content, text_of(&reply)) {
        (ReplyContent::Empty, _) => "the model's answer is empty".to_owned(),
        (ReplyContent::Refusal(text), _) => format!("the model refused to answer: {text:?}"),
        (ReplyContent::Text(_), Some(_)) => return Ok(reply),
        (ReplyContent::Text(_), None) => "the model's answer has no text in it".to_owned(),
        (ReplyContent::Length(_), _) => {
            let tokens = match reply.completion_tokens {
                Some(tokens) => format!(" after {tokens} tokens"),
                None => String::new(),
            };
            let reasoning = if reply.reasoned {
                ", some of them for reasoning, which can be turned off at the server"
            } else {
                ""
            };
            bail!(
                "the model's answer was cut off{tokens}{reasoning}, and nothing of it is stored: raise --max-tokens"
            );
        }
    };
    bail!("{problem}; give the same command again, or ask another model")
}

/// The text of a reply, without a fence around it. `None` when nothing is left.
fn text_of(reply: &ChatReply) -> Option<&str> {
    let mut text = reply.text().trim();
    if let Some(inside) = text.strip_prefix("```") {
        // The rest of the first line names a language.
        (_, text) = inside.split_once('\n')?;
        text = text.trim_end().strip_suffix("```").unwrap_or(text);
    }
    Some(text.trim()).filter(|text| !text.is_empty())
}

/// The number of leading `texts` that fit into `room` characters, each on lines of its own.
fn fitting(texts: &[String], room: usize) -> usize {
    let mut used = 0;
    let fits = |text: &&String| {
        // Texts are joined by a line break, and notes have a heading.
        used += chars(text) + "## Notes 1234\n\n\n".len();
        used <= room
    };
    texts.iter().take_while(fits).count()
}

fn chars(text: &str) -> usize {
    text.chars().count()
}

/// Adds `part` to a sum that is absent when one of its parts is.
fn add(sum: &mut Option<u64>, part: Option<u64>) {
    *sum = sum.zip(part).and_then(|(sum, part)| sum.checked_add(part));
}

/// Counts a reply.
fn count(account: &mut BuildAccount, reply: &ChatReply) {
    add(&mut account.requests, Some(1));
    add(&mut account.prompt_tokens, reply.prompt_tokens);
    add(&mut account.completion_tokens, reply.completion_tokens);
}

#[cfg(test)]
#[path = "model/tests.rs"]
mod tests;
