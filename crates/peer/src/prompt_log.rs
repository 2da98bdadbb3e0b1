//! Writes the prompt log ([`domain::prompt_log`]): requests and answers, views and long texts once.
//!
//! Nothing here decides what happens when the disk is full: the serve loop does.

use std::collections::HashSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use domain::prompt_log::{
    Asked, Entry, Hash, Part, Past, Retrieved, Seen, Supplied, entries_file, hex, image_file,
    text_file, trajectories_file,
};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde::Serialize;
use shm_types::Attach;

use crate::{FrameView, Request};

/// Texts of more bytes than these are stored once.
const LONG_TEXT: usize = 1024;

/// What could not be written, and why.
#[derive(Debug, thiserror::Error)]
#[error("cannot keep the prompt log: {}: {source}", path.display())]
pub(super) struct LogError {
    path: PathBuf,
    source: io::Error,
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> LogError + '_ {
    move |source| LogError { path: path.to_owned(), source }
}

/// An open prompt log.
pub(super) struct PromptLog {
    /// The folder of all sessions.
    prompts: PathBuf,
    path: PathBuf,
    file: File,
    /// Images and texts that are known to be there.
    kept: HashSet<PathBuf>,
}

impl PromptLog {
    /// The log that the run asks for, if it does.
    pub(super) fn open(attach: &Attach) -> Result<Option<Self>, LogError> {
        let Some(session) = &attach.prompts else { return Ok(None) };
        let prompts = session.parent().unwrap_or(session).to_owned();
        for folder in [session.clone(), prompts.join("images"), prompts.join("documents")] {
            fs::create_dir_all(&folder).map_err(at(&folder))?;
        }
        let path = entries_file(session, attach.generation);
        let file = open_lines(&path).map_err(at(&path))?;
        Ok(Some(Self { prompts, path, file, kept: HashSet::new() }))
    }

    /// Keeps what a request shows, and says what to write of it.
    pub(super) fn asked(&mut self, request: &Request<'_>) -> Result<Asked, LogError> {
        let mut window = Vec::with_capacity(request.window.len());
        for past in request.window {
            window.push(Past {
                frame: self.view(&past.frame)?,
                action: past.action.map(|action| action.words().to_owned()),
                feedback: past.feedback.words().to_owned(),
            });
        }
        let segment = match request.segment {
            None => None,
            Some(segment) => {
                let steps = segment.steps.iter().map(|step| (Some(step.frame), step.action));
                Some(Retrieved { distance: segment.distance, steps: self.seen(steps)? })
            }
        };
        let mut documents = Vec::with_capacity(request.documents.len());
        for document in request.documents {
            let kind = document.kind.word().to_owned();
            documents.push(Supplied { kind, text: self.text(document.text)? });
        }
        let mut trajectories = Vec::with_capacity(request.trajectories.len());
        for trajectory in request.trajectories {
            let steps = trajectory.steps.iter().map(|step| (step.frame, step.action));
            trajectories.push(self.seen(steps)?);
        }
        Ok(Asked {
            repeat: request.repeat,
            seed: request.episode_seed,
            instruction: request.instruction.to_owned(),
            pose: request.pose,
            feedback: request.feedback.words().to_owned(),
            frame: self.view(&request.frame)?,
            starts_as_demonstrated: request.starts_as_demonstrated,
            window,
            segment,
            documents,
            trajectories: match &trajectories[..] {
                [] => None,
                trajectories => Some(self.trajectories(trajectories)?),
            },
        })
    }

    /// Adds an entry. Its long texts go into files of their own.
    pub(super) fn write(&mut self, mut entry: Entry) -> Result<(), LogError> {
        let messages = entry.exchange.iter_mut().flat_map(|exchange| &mut exchange.messages);
        for part in messages.flat_map(|message| &mut message.parts) {
            if let Part::Text(text) = part
                && text.len() > LONG_TEXT
            {
                *part = Part::Stored(self.text(text)?);
            }
        }
        let mut line = json(&entry, &self.path)?;
        line.push(b'\n');
        // One write: a kill leaves a line whole, absent or torn, never mixed with another.
        self.file.write_all(&line).map_err(at(&self.path))
    }

    fn seen<'a>(
        &mut self,
        steps: impl Iterator<Item = (Option<FrameView<'a>>, Option<domain::Action>)>,
    ) -> Result<Vec<Seen>, LogError> {
        let mut seen = Vec::new();
        for (frame, action) in steps {
            let frame = frame.map(|frame| self.view(&frame)).transpose()?;
            seen.push(Seen { frame, action: action.map(|action| action.words().to_owned()) });
        }
        Ok(seen)
    }

    fn view(&mut self, view: &FrameView<'_>) -> Result<Hash, LogError> {
        let hash = hex(view.content_hash);
        let path = image_file(&self.prompts, &hash);
        self.keep(path, || {
            let mut png = Vec::new();
            // The views have no transparent pixels, but they are kept as they are.
            PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
                .write_image(view.pixels, view.width, view.height, ExtendedColorType::Rgba8)
                .map_err(io::Error::other)?;
            Ok(png)
        })?;
        Ok(hash)
    }

    fn text(&mut self, text: &str) -> Result<Hash, LogError> {
        let hash = hash_of(text.as_bytes());
        self.keep(text_file(&self.prompts, &hash), || Ok(text.as_bytes().to_vec()))?;
        Ok(hash)
    }

    fn trajectories(&mut self, trajectories: &[Vec<Seen>]) -> Result<Hash, LogError> {
        let text = json(&trajectories, &self.path)?;
        let hash = hash_of(&text);
        self.keep(trajectories_file(&self.prompts, &hash), || Ok(text))?;
        Ok(hash)
    }

    /// Writes a file whose name says its content, unless it is there: whole or not at all.
    fn keep(
        &mut self,
        path: PathBuf,
        content: impl FnOnce() -> io::Result<Vec<u8>>,
    ) -> Result<(), LogError> {
        if self.kept.contains(&path) {
            return Ok(());
        }
        if !path.exists() {
            let draft = path.with_extension(format!("new-{}", std::process::id()));
            content()
                .and_then(|content| fs::write(&draft, content))
                .and_then(|()| fs::rename(&draft, &path))
                .map_err(at(&path))?;
        }
        self.kept.insert(path);
        Ok(())
    }
}

/// The name of a text.
fn hash_of(bytes: &[u8]) -> Hash {
    let hash = blake3::hash(bytes);
    hex(hash.as_bytes().first_chunk().copied().unwrap_or_default())
}

fn json(value: &impl Serialize, path: &Path) -> Result<Vec<u8>, LogError> {
    serde_json::to_vec(value).map_err(io::Error::other).map_err(at(path))
}

/// Opens a file of lines to add to: a line that was never finished is cut off.
fn open_lines(path: &Path) -> io::Result<File> {
    let mut file =
        OpenOptions::new().create(true).truncate(false).read(true).write(true).open(path)?;
    let mut text = Vec::new();
    file.read_to_end(&mut text)?;
    let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    if whole < text.len() {
        file.set_len(whole as u64)?;
    }
    file.seek(SeekFrom::Start(whole as u64))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_being_written_is_cut_off() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("generation-1.jsonl");
        for (found, kept) in [("", ""), ("{}\n{\"ep", "{}\n"), ("{}\n", "{}\n"), ("{", "")] {
            fs::write(&path, found).unwrap();
            open_lines(&path).unwrap().write_all(b"x\n").unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), format!("{kept}x\n"));
        }
    }
}
