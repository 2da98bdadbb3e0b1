//! Writes the prompt log ([`domain::prompt_log`]). Images and long texts are stored once.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use case_book::WorldDeclaration;
use domain::prompt_log::{
    Hash, PromptLogEntry, RecordedActions, RecordedItem, RecordedPart, RecordedPast,
    RecordedRequest, RecordedView, entries_file, image_file, text_file, trajectory_file,
};
use domain::{ActionCode, create_private_folder, hex};
use png_file::{Channels, encode};
use serde::Serialize;
use shm_types::Attach;

use super::{CaptionedView, FrameView, Item, PlannedActions, Request, StepView, TextView};

/// Longer texts, in bytes, have a file of their own.
const LONG_TEXT: usize = 1024;

/// A file of the prompt log cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the prompt log: {}: {source}", path.display())]
pub(super) struct PromptLogError {
    path: PathBuf,
    source: io::Error,
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> PromptLogError + '_ {
    move |source| PromptLogError { path: path.to_owned(), source }
}

/// An open prompt log.
pub(super) struct PromptLogWriter {
    /// The folder of all sessions.
    prompts: PathBuf,
    path: PathBuf,
    file: File,
    /// Files of images and texts that exist.
    stored: HashSet<PathBuf>,
}

impl PromptLogWriter {
    /// Opens the log if the run asks for one.
    pub(super) fn open(attach: &Attach) -> Result<Option<Self>, PromptLogError> {
        let Some(session) = &attach.prompts else { return Ok(None) };
        let prompts = session.parent().unwrap_or(session).to_owned();
        for folder in [session.clone(), prompts.join("images"), prompts.join("documents")] {
            create_private_folder(&folder).map_err(at(&folder))?;
        }
        let path = entries_file(session, attach.generation);
        let file = open_lines(&path).map_err(at(&path))?;
        Ok(Some(Self { prompts, path, file, stored: HashSet::new() }))
    }

    /// Stores the images and texts of a request, and returns its record.
    pub(super) fn request(
        &mut self,
        request: &Request<'_>,
    ) -> Result<RecordedRequest, PromptLogError> {
        let world = request.world;
        let mut window = Vec::with_capacity(request.window.len());
        for past in request.window {
            window.push(RecordedPast {
                frame: self.view(&past.frame)?,
                action: past.action.map(|action| world.action_words(action).to_owned()),
                feedback: world.feedback_sentence(past.feedback).to_owned(),
            });
        }
        let items = request.items.iter().map(|item| self.item(world, item));
        let items = items.collect::<Result<_, _>>()?;
        Ok(RecordedRequest {
            repeat: request.repeat,
            seed: request.episode_seed,
            instruction: request.instruction.to_owned(),
            state: request.state,
            feedback: world.feedback_sentence(request.feedback).to_owned(),
            frame: self.view(&request.frame)?,
            starts_as_demonstrated: request.starts_as_demonstrated,
            demonstrated_elsewhere: request.demonstrated_elsewhere,
            window,
            items,
        })
    }

    /// Appends an entry. Its images and long texts go into files of their own.
    pub(super) fn write(&mut self, mut entry: PromptLogEntry) -> Result<(), PromptLogError> {
        let messages = entry.exchange.iter_mut().flat_map(|exchange| &mut exchange.messages);
        for part in messages.flat_map(|message| &mut message.parts) {
            match part {
                RecordedPart::Text(text) if text.len() > LONG_TEXT => {
                    *part = RecordedPart::Stored(self.text(text)?);
                }
                RecordedPart::Png(png) => {
                    let hash = hash_of(png);
                    self.store(image_file(&self.prompts, &hash), || Ok(std::mem::take(png)))?;
                    *part = RecordedPart::Image(hash);
                }
                RecordedPart::Text(_) | RecordedPart::Stored(_) | RecordedPart::Image(_) => {}
            }
        }
        let mut line = json(&entry, &self.path)?;
        line.push(b'\n');
        // A single write: if the process is killed, the line is complete, cut off or absent.
        self.file.write_all(&line).map_err(at(&self.path))
    }

    fn item(
        &mut self,
        world: &WorldDeclaration,
        item: &Item<'_>,
    ) -> Result<RecordedItem, PromptLogError> {
        Ok(match item {
            Item::Text(TextView { kind, text, .. }) => {
                RecordedItem::Text { kind: kind.word().to_owned(), text: self.text(text)? }
            }
            Item::Steps(supplied) => {
                let instruction = supplied.instruction.to_owned();
                let steps = self.views(world, supplied.steps)?;
                if supplied.is_trajectory() {
                    RecordedItem::Trajectory { instruction, steps: self.trajectory(&steps)? }
                } else {
                    RecordedItem::Segment { distance: supplied.distance, instruction, steps }
                }
            }
            Item::Frame(CaptionedView { frame, caption, instruction }) => RecordedItem::Frame {
                instruction: (*instruction).to_owned(),
                frame: self.view(frame)?,
                caption: self.text(caption)?,
            },
            Item::Plan(plan) => {
                let words = |action: &ActionCode| world.action_words(*action).to_owned();
                let part = |part: &PlannedActions<'_>| RecordedActions {
                    instruction: part.instruction.map(str::to_owned),
                    actions: part.actions.iter().map(words).collect(),
                };
                RecordedItem::Plan { parts: plan.parts.iter().map(part).collect() }
            }
        })
    }

    fn views(
        &mut self,
        world: &WorldDeclaration,
        steps: &[StepView<'_>],
    ) -> Result<Vec<RecordedView>, PromptLogError> {
        let view = |step: &StepView<'_>| {
            let frame = step.frame.map(|frame| self.view(&frame)).transpose()?;
            let action = step.action.map(|action| world.action_words(action).to_owned());
            Ok(RecordedView { frame, action })
        };
        steps.iter().map(view).collect()
    }

    fn view(&mut self, view: &FrameView<'_>) -> Result<Hash, PromptLogError> {
        let hash = hex(&view.content_hash);
        let path = image_file(&self.prompts, &hash);
        self.store(path, || {
            encode(view.width, view.height, Channels::Rgba, view.pixels).map_err(io::Error::other)
        })?;
        Ok(hash)
    }

    fn text(&mut self, text: &str) -> Result<Hash, PromptLogError> {
        let hash = hash_of(text.as_bytes());
        self.store(text_file(&self.prompts, &hash), || Ok(text.as_bytes().to_vec()))?;
        Ok(hash)
    }

    fn trajectory(&mut self, steps: &[RecordedView]) -> Result<Hash, PromptLogError> {
        let text = json(&steps, &self.path)?;
        let hash = hash_of(&text);
        self.store(trajectory_file(&self.prompts, &hash), || Ok(text))?;
        Ok(hash)
    }

    /// Writes a file that is named by its content's hash, atomically, unless it exists.
    fn store(
        &mut self,
        path: PathBuf,
        content: impl FnOnce() -> io::Result<Vec<u8>>,
    ) -> Result<(), PromptLogError> {
        if self.stored.contains(&path) {
            return Ok(());
        }
        if !path.exists() {
            let draft = path.with_extension(format!("new-{}", std::process::id()));
            let write = || {
                let mut file = durable::create(&draft)?;
                file.write_all(&content()?)?;
                // What has its name is never written again: it must be whole after a crash of the machine, too.
                file.sync_data()?;
                fs::rename(&draft, &path)
            };
            write().map_err(at(&path))?;
        }
        self.stored.insert(path);
        Ok(())
    }
}

/// The hash that names a file with these bytes.
fn hash_of(bytes: &[u8]) -> Hash {
    let hash = blake3::hash(bytes);
    hex(&hash.as_bytes()[..16])
}

fn json(value: &impl Serialize, path: &Path) -> Result<Vec<u8>, PromptLogError> {
    serde_json::to_vec(value).map_err(io::Error::other).map_err(at(path))
}

/// Opens a file of lines for appending, and removes an incomplete last line.
fn open_lines(path: &Path) -> io::Result<File> {
    let file = durable::append(path)?;
    let text = durable::read(path)?;
    let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    if whole < text.len() {
        file.set_len(whole as u64)?;
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_incomplete_last_line_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("generation-1.jsonl");
        for (found, kept) in [("", ""), ("{}\n{\"ep", "{}\n"), ("{}\n", "{}\n"), ("{", "")] {
            fs::write(&path, found).unwrap();
            open_lines(&path).unwrap().write_all(b"x\n").unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), format!("{kept}x\n"));
        }
    }
}
