//! The model builder: asks a model to write documents.
//!
//! - A summary is built sequentially: the summary so far and as many further demonstrations as fit into a prompt become
//!   a new summary, until no demonstrations are left.
//! - A semantic document is built in three stages: notes are *extracted* from groups of demonstrations, *consolidated*
//!   until one set is left, and *refined* to a document.
//!
//! Every reply is stored when it arrives, so an interrupted build continues where it was. What is asked is in
//! [`documents::asking`]; the crate `llm` sends the requests.

mod steps;

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use case_book::{Demonstration, WorldDeclaration};
use documents::asking::{
    DocumentPrompt, Narration, PartSize, PromptPart, PromptStage, PromptTexts, narrations,
};
use documents::{BuildAccount, ModelRecipe, PROMPT_VERSION};
use domain::DocumentKind;
use llm::{
    ChatClient, ChatMessage, ChatReply, ChatRequest, ChatRole, ContentPart, MessageContent,
    ReplyContent,
};

use self::steps::StepFolder;
use super::views::{DrawViews, DrawnView};
use super::{BuiltText, DocumentBuilder};

/// Maximum size of a document: a larger one leaves no room in a prompt beside its images.
const MAX_DOCUMENT_BYTES: usize = 256 << 10;

/// How often progress is reported while a reply is awaited.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(1);

/// Sends prompts to a model. The second argument is called about once a second until the reply arrives.
pub trait AskModel:
    FnMut(&DocumentPrompt<DrawnView>, &mut dyn FnMut()) -> anyhow::Result<ChatReply>
{
}

impl<F> AskModel for F where
    F: FnMut(&DocumentPrompt<DrawnView>, &mut dyn FnMut()) -> anyhow::Result<ChatReply>
{
}

/// Sends prompts through a chat client.
pub fn ask_through(client: ChatClient) -> impl AskModel {
    move |prompt: &DocumentPrompt<DrawnView>, waiting: &mut dyn FnMut()| {
        let (sender, replies) = mpsc::channel();
        client.submit(request(prompt), 0, move |result| {
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

/// The request that carries a prompt. Without views, its messages are plain text, as every server takes them.
fn request(prompt: &DocumentPrompt<DrawnView>) -> ChatRequest {
    let user = match &*prompt.user {
        [PromptPart::Text(text)] => MessageContent::Text(text.clone()),
        parts => MessageContent::Parts(parts.iter().map(content).collect()),
    };
    let messages = vec![
        ChatMessage::text(ChatRole::System, &*prompt.system),
        ChatMessage { role: ChatRole::User, content: user },
    ];
    ChatRequest { messages, max_tokens: prompt.max_tokens, choices: Vec::new() }
}

fn content(part: &PromptPart<DrawnView>) -> ContentPart {
    match part {
        PromptPart::Text(text) => ContentPart::Text { text: text.clone() },
        PromptPart::View(view) => ContentPart::ImageUrl { image_url: view.url.clone() },
    }
}

/// Builds documents by asking a model.
#[derive(Debug)]
pub struct ModelBuilder<A, V> {
    ask: A,
    views: V,
    recipe: ModelRecipe,
}

impl<A: AskModel, V: DrawViews> ModelBuilder<A, V> {
    /// Creates a builder that follows `recipe`, sends its prompts with `ask`, and shows what `views` draws.
    pub fn new(ask: A, views: V, recipe: ModelRecipe) -> Self {
        Self { ask, views, recipe }
    }
}

impl<A: AskModel, V: DrawViews> DocumentBuilder for ModelBuilder<A, V> {
    fn build(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<BuiltText> {
        let Self { ask, views, recipe } = self;
        let narrated = narrations(world, demonstrations, recipe.views_each());
        let mut draft = Draft {
            ask,
            views,
            texts: PromptTexts { world, recipe },
            steps: StepFolder::open(steps, &recipe.model)?,
            models: Vec::new(),
            account: BuildAccount {
                model: None,
                prompt_version: Some(PROMPT_VERSION),
                requests: Some(0),
                images: Some(0),
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
    views: &'a mut dyn DrawViews,
    texts: PromptTexts<'a>,
    steps: StepFolder,
    /// The models that have answered, each once.
    models: Vec<String>,
    account: BuildAccount,
}

impl Draft<'_> {
    fn summary(
        &mut self,
        narrated: &[Narration],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        let mut summary = String::new();
        let mut done = 0;
        while done < narrated.len() {
            progress(done, narrated.len());
            let room = self.texts.room(PromptStage::Summary, chars(&summary));
            let next = room.fitting(narrated[done..].iter().map(Narration::size));
            let PartSize { chars: length, .. } = narrated[done].size();
            ensure!(
                next > 0,
                "demonstration {} has {length} characters, and beside a summary of {} there is room for {} of the {} in a \
                 prompt: raise --context-chars or lower --max-tokens",
                done + 1,
                chars(&summary),
                room.chars,
                self.texts.recipe.context_chars
            );
            let prompt = self.texts.summary(&summary, &narrated[done..done + next]);
            let waiting = &mut || progress(done, narrated.len());
            summary = self.ask(PromptStage::Summary, &prompt, waiting)?;
            done += next;
        }
        progress(done, narrated.len());
        ensure!(done > 0, "there are no demonstrations to summarise");
        Ok(summary)
    }

    fn semantic(
        &mut self,
        narrated: &[Narration],
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<String> {
        // Consolidation and refinement count as one part each.
        let parts = narrated.len() + 2;
        let mut notes = Vec::new();
        let mut done = 0;
        for group in self.groups(PromptStage::Extract, narrated, Narration::size)? {
            progress(done, parts);
            let prompt = self.texts.extract(group);
            let waiting = &mut || progress(done, parts);
            notes.push(self.ask(PromptStage::Extract, &prompt, waiting)?);
            done += group.len();
        }
        ensure!(!notes.is_empty(), "there are no demonstrations to learn from");
        progress(parts - 2, parts);
        loop {
            let of_notes = |text: &String| PartSize { chars: chars(text), images: 0 };
            let groups = self.groups(PromptStage::Consolidate, &notes, of_notes)?;
            ensure!(
                groups.len() == 1 || groups.len() < notes.len(),
                "no two of {} sets of notes fit into a prompt of {} characters: raise --context-chars or lower \
                 --max-tokens",
                notes.len(),
                self.texts.recipe.context_chars
            );
            let mut fewer = Vec::new();
            for group in groups {
                let prompt = self.texts.consolidate(group);
                let waiting = &mut || progress(parts - 2, parts);
                fewer.push(self.ask(PromptStage::Consolidate, &prompt, waiting)?);
            }
            notes = fewer;
            if notes.len() == 1 {
                break;
            }
        }
        progress(parts - 1, parts);
        let waiting = &mut || progress(parts - 1, parts);
        let document = self.ask(PromptStage::Refine, &self.texts.refine(&notes[0]), waiting)?;
        progress(parts, parts);
        Ok(document)
    }

    /// Splits `parts` into consecutive groups that fit into a prompt of `stage`.
    fn groups<'t, T>(
        &self,
        stage: PromptStage,
        parts: &'t [T],
        size: impl Fn(&T) -> PartSize,
    ) -> anyhow::Result<Vec<&'t [T]>> {
        let room = self.texts.room(stage, 0);
        let mut groups = Vec::new();
        let mut rest = parts;
        while !rest.is_empty() {
            let count = room.fitting(rest.iter().map(&size));
            ensure!(
                count > 0,
                "a text of {} characters for the stage `{}` does not fit: a prompt of {} has room for {}; raise \
                 --context-chars",
                size(&rest[0]).chars,
                stage.name(),
                self.texts.recipe.context_chars,
                room.chars
            );
            let (group, after) = rest.split_at(count);
            groups.push(group);
            rest = after;
        }
        Ok(groups)
    }

    /// The model's answer at a stage, without a fence around it; never empty.
    fn ask(
        &mut self,
        stage: PromptStage,
        prompt: &DocumentPrompt<u32>,
        waiting: &mut dyn FnMut(),
    ) -> anyhow::Result<String> {
        let failed = || format!("the stage `{}` of the document failed", stage.name());
        let prompt = prompt.try_map(|view| self.views.draw(*view)).with_context(failed)?;
        let ask = &mut *self.ask;
        let asked = || ask(&prompt, waiting);
        let reply = self.steps.next(stage, &prompt, usable, asked).with_context(failed)?;
        count(&mut self.account, &prompt, &reply);
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

fn chars(text: &str) -> usize {
    text.chars().count()
}

/// Adds `part` to a sum that is absent when one of its parts is.
fn add(sum: &mut Option<u64>, part: Option<u64>) {
    *sum = sum.zip(part).and_then(|(sum, part)| sum.checked_add(part));
}

/// Counts a prompt and its reply.
fn count(account: &mut BuildAccount, prompt: &DocumentPrompt<DrawnView>, reply: &ChatReply) {
    add(&mut account.requests, Some(1));
    add(&mut account.images, Some(prompt.views().count() as u64));
    add(&mut account.prompt_tokens, reply.prompt_tokens);
    add(&mut account.completion_tokens, reply.completion_tokens);
}

#[cfg(test)]
#[path = "model/tests.rs"]
mod tests;
