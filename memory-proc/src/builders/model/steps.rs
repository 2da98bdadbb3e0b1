//! The prompts and replies of a document, stored in a folder beside it so that an interrupted build can continue.
//!
//! A file holds one prompt and its reply, and is reused only for the same prompt to the same model. A prompt without a
//! usable reply leaves no file. Of images only hashes are stored.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use documents::asking::{DocumentPrompt, PromptStage};
use domain::create_private_folder;
use domain::hex;
use llm::ChatReply;

use crate::builders::views::DrawnView;

/// A stored step.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StepFile {
    /// SHA-256 of the model's name and the prompt.
    request_sha256: String,
    /// The prompt, with the SHA-256 of its images' pixels.
    prompt: DocumentPrompt<String>,
    reply: ChatReply,
}

/// The steps of one document, in order.
#[derive(Debug)]
pub(super) struct StepFolder {
    folder: PathBuf,
    /// The model's name.
    model: String,
    /// Files of this build.
    used: BTreeSet<OsString>,
}

impl StepFolder {
    /// Opens the folder of a document built by `model`. Creates the folder if it is missing.
    pub(super) fn open(folder: &Path, model: &str) -> anyhow::Result<Self> {
        create_private_folder(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        Ok(Self { folder: folder.to_owned(), model: model.to_owned(), used: BTreeSet::new() })
    }

    /// The reply to the next prompt: the stored one, else the result of `ask`, which is then stored. Both have to be `usable`: an
    /// earlier version may have stored a reply that is not, and the model is asked again.
    pub(super) fn next(
        &mut self,
        stage: PromptStage,
        prompt: &DocumentPrompt<DrawnView>,
        usable: impl Fn(ChatReply) -> anyhow::Result<ChatReply>,
        ask: impl FnOnce() -> anyhow::Result<ChatReply>,
    ) -> anyhow::Result<ChatReply> {
        let name = format!("{:03}-{}.json", self.used.len() + 1, stage.name());
        let path = self.folder.join(&name);
        self.used.insert(name.into());
        let hash = |view: &DrawnView| Ok::<_, anyhow::Error>(view.sha256.clone());
        let prompt = prompt.try_map(hash)?;
        let request_sha256 = self.sha256(&prompt)?;
        if let Some(step) = load(&path)?.filter(|step| step.request_sha256 == request_sha256) {
            match step.reply.judged().map_err(anyhow::Error::msg).and_then(&usable) {
                Ok(reply) => return Ok(reply),
                Err(problem) => tracing::warn!(
                    "{} is not used ({problem:#}): the model is asked again",
                    path.display()
                ),
            }
        }
        let reply = usable(ask()?)?;
        let step = StepFile { request_sha256, prompt, reply };
        save(&path, &step).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(step.reply)
    }

    /// Deletes stored steps that this build did not use.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        let stale = || -> io::Result<()> {
            for entry in fs::read_dir(&self.folder)? {
                let entry = entry?;
                if !self.used.contains(&entry.file_name()) && is_step(&entry.path()) {
                    fs::remove_file(entry.path())?;
                }
            }
            Ok(())
        };
        stale().with_context(|| format!("cannot clear {}", self.folder.display()))
    }

    fn sha256(&self, prompt: &DocumentPrompt<String>) -> anyhow::Result<String> {
        let mut hasher = Sha256::new();
        hasher.update((self.model.len() as u64).to_le_bytes());
        hasher.update(&self.model);
        hasher.update(serde_json::to_vec(prompt)?);
        Ok(hex(&hasher.finalize()))
    }
}

/// Whether a file is named like a step, complete or not.
fn is_step(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let numbered = name.split_once('-').is_some_and(|(number, _)| {
        number.len() >= 3 && number.bytes().all(|digit| digit.is_ascii_digit())
    });
    numbered && (name.ends_with(".json") || name.ends_with(".json.new"))
}

/// The step at `path`, if there is one. A broken file is reported and counts as none.
fn load(path: &Path) -> anyhow::Result<Option<StepFile>> {
    let bytes = match durable::input::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", path.display())),
    };
    match serde_json::from_slice(&bytes) {
        Ok(step) => Ok(Some(step)),
        Err(error) => {
            tracing::warn!("{} is broken ({error}): the model is asked again", path.display());
            Ok(None)
        }
    }
}

/// Writes all of it or nothing, and durably: a reply may have cost money.
fn save(path: &Path, step: &StepFile) -> io::Result<()> {
    let mut bytes = serde_json::to_vec_pretty(step)?;
    bytes.push(b'\n');
    durable::replace(path, &path.with_extension("json.new"), &bytes)
}

#[cfg(test)]
mod tests {
    use anyhow::bail;

    use super::*;
    use documents::asking::PromptPart;
    use domain::ImageFormat;
    use llm::ReplyContent;

    /// A prompt with one image of this colour.
    fn prompt(colour: u8) -> DocumentPrompt<DrawnView> {
        DocumentPrompt {
            system: "System.".to_owned(),
            user: vec![
                PromptPart::Text("Image 1:\n".to_owned()),
                PromptPart::View(
                    DrawnView::of_pixels(1, &[colour, 0, 0, 255], ImageFormat::Png).unwrap(),
                ),
            ],
            max_tokens: 9,
        }
    }

    fn reply(text: &str) -> ChatReply {
        super::super::tests::reply(ReplyContent::Text(text.into()))
    }

    /// As the builder does, takes only a whole text.
    fn whole(reply: ChatReply) -> anyhow::Result<ChatReply> {
        match reply.content {
            ReplyContent::Text(_) => Ok(reply),
            _ => bail!("no whole text"),
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = entries.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_reply_is_reused_for_the_same_request_to_the_same_model_only() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("summary-4.steps");
        let next = |model, colour, answer: Option<&str>| {
            let mut steps = StepFolder::open(&folder, model).unwrap();
            let ask = || match answer {
                Some(text) => Ok(reply(text)),
                None => bail!("no server"),
            };
            steps
                .next(PromptStage::Extract, &prompt(colour), whole, ask)
                .map(|reply| reply.text().to_owned())
        };
        assert!(next("m", 1, None).is_err());
        assert_eq!(names(&folder), [""; 0], "a failure leaves nothing");
        assert_eq!(next("m", 1, Some("a")).unwrap(), "a");
        assert_eq!(names(&folder), ["001-extract.json"]);
        assert_eq!(next("m", 1, None).unwrap(), "a");
        assert!(next("m", 2, None).is_err());
        assert!(next("n", 1, None).is_err());
        assert_eq!(next("n", 1, Some("b")).unwrap(), "b");
        fs::write(folder.join("001-extract.json"), "{").unwrap();
        assert_eq!(next("n", 1, Some("c")).unwrap(), "c");
    }

    #[test]
    fn a_stored_reply_that_is_no_whole_text_is_asked_for_again() {
        let folder = tempfile::tempdir().unwrap();
        let next = |usable: fn(ChatReply) -> anyhow::Result<ChatReply>, content: ReplyContent| {
            let mut steps = StepFolder::open(folder.path(), "m").unwrap();
            let ask = || Ok(super::super::tests::reply(content));
            steps
                .next(PromptStage::Extract, &prompt(1), usable, ask)
                .map(|reply| reply.text().to_owned())
        };
        // As an earlier version stored it.
        next(Ok, ReplyContent::Length("# A\nha".to_owned())).unwrap();
        assert!(next(whole, ReplyContent::Empty).is_err());
        assert_eq!(next(whole, ReplyContent::Text("# A".to_owned())).unwrap(), "# A");
        assert_eq!(next(whole, ReplyContent::Empty).unwrap(), "# A");
    }

    #[test]
    fn finishing_removes_the_steps_of_an_earlier_document_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["002-refine.json", "003-extract.json.new", "notes.txt", "a-b.json"] {
            fs::write(folder.path().join(name), "x").unwrap();
        }
        let mut steps = StepFolder::open(folder.path(), "m").unwrap();
        steps.next(PromptStage::Summary, &prompt(1), whole, || Ok(reply("a"))).unwrap();
        steps.finish().unwrap();
        assert_eq!(names(folder.path()), ["001-summary.json", "a-b.json", "notes.txt"]);
    }
}
