//! What the prompt log of a run has about a step: the request, the exchange with the model and the answer.

mod words;

pub use words::{facts, planned, title};

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use domain::prompt_log::{
    Hash, PromptLogEntry, RecordedItem, RecordedPart, RecordedView, entries_file, image_file,
    is_hash, line_key, session_folder, text_file, trajectory_file,
};
use durable::input::INPUT_LIMIT;
use durable::open_beneath;
use serde::Serialize;

use crate::{EpisodeRecord, EpisodeTimings, PROMPTS_FOLDER, RunLog};

/// The prompt log's entry about a step, with everything that it refers to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedPrompt {
    /// The entry.
    #[serde(flatten)]
    pub entry: PromptLogEntry,
    /// The demonstrations that memory supplied whole, by their hash.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub trajectories: BTreeMap<Hash, Vec<RecordedView>>,
    /// The texts that the entry names, by their hash.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub texts: BTreeMap<Hash, String>,
    /// The files of the images that the entry names, by their hash.
    pub images: BTreeMap<Hash, PathBuf>,
}

impl RecordedPrompt {
    /// The text with this hash.
    pub fn text(&self, hash: &str) -> &str {
        self.texts.get(hash).map_or("", String::as_str)
    }

    /// The demonstration with this hash.
    pub fn trajectory(&self, hash: &str) -> &[RecordedView] {
        self.trajectories.get(hash).map_or(&[], Vec::as_slice)
    }
}

/// What the prompt log has about step `step` of the episode of `record`; `None` where there is nothing.
///
/// # Errors
/// When the episode has no such step, or a file of the prompt log cannot be used.
pub fn look_up(log: &RunLog, record: &EpisodeRecord, step: u32) -> Result<Option<RecordedPrompt>> {
    ensure!(
        step < record.steps,
        "{} has {} steps, so its steps are 0 to {}: there is no step {step}",
        record.key,
        record.steps,
        record.steps.saturating_sub(1)
    );
    let timings = log.timings.iter().find(|timings| timings.key == record.key);
    timings.map_or(Ok(None), |timings| PromptLog::of(log).entry(timings, step))
}

/// The prompt log of a run. Each of its files is searched once, and after that only what was added to it.
#[derive(Debug)]
pub struct PromptLog {
    /// The run's folder.
    run: PathBuf,
    folder: PathBuf,
    files: BTreeMap<PathBuf, FileIndex>,
}

/// Where the entries of a prompt log's file are.
#[derive(Debug, Default)]
struct FileIndex {
    /// The file's number in its file system: another one is another file.
    inode: u64,
    /// The length of the whole lines that were searched.
    searched: u64,
    /// Offset and length of the line, by episode id and step.
    lines: BTreeMap<(u64, u32), (u64, usize)>,
}

impl PromptLog {
    /// The prompt log of `log`, which may have none.
    pub fn of(log: &RunLog) -> Self {
        Self::in_run(&log.dir)
    }

    fn in_run(run: &Path) -> Self {
        Self { run: run.to_owned(), folder: run.join(PROMPTS_FOLDER), files: BTreeMap::new() }
    }

    /// Whether the run has one.
    pub fn exists(&self) -> bool {
        self.folder.exists()
    }

    /// The entry about a step of the episode of `timings`, with everything that it refers to; `None` if there is none.
    ///
    /// # Errors
    /// When a file cannot be used.
    pub fn entry(&mut self, timings: &EpisodeTimings, step: u32) -> Result<Option<RecordedPrompt>> {
        let file = entries_file(&session_folder(&self.folder, timings.session), timings.generation);
        if !file.exists() {
            return Ok(None);
        }
        let line = self.line(&file, (timings.episode, step));
        let Some(line) = line.with_context(|| format!("cannot read {}", file.display()))? else {
            return Ok(None);
        };
        let entry = serde_json::from_slice(&line).with_context(|| {
            format!(
                "step {step} in {} cannot be read: another version of MemTransfer wrote it",
                file.display()
            )
        })?;
        resolve(&self.run, entry).map(Some)
    }

    /// The line of `file` about an episode's step, if there is one.
    fn line(&mut self, file: &Path, key: (u64, u32)) -> io::Result<Option<Vec<u8>>> {
        let mut opened = open_beneath(&self.run, file)?;
        let index = self.files.entry(file.to_owned()).or_default();
        index.search(&mut opened)?;
        let Some(&(offset, length)) = index.lines.get(&key) else { return Ok(None) };
        let mut line = vec![0; length];
        opened.seek(SeekFrom::Start(offset))?;
        opened.read_exact(&mut line)?;
        Ok(Some(line))
    }
}

impl FileIndex {
    /// Enters the lines of `file` that were added since the last search. Of several lines about the same step, the last
    /// counts.
    fn search(&mut self, file: &mut File) -> io::Result<()> {
        let metadata = file.metadata()?;
        if metadata.ino() != self.inode || metadata.len() < self.searched {
            *self = Self { inode: metadata.ino(), ..Self::default() };
        }
        if metadata.len() == self.searched {
            return Ok(());
        }
        file.seek(SeekFrom::Start(self.searched))?;
        let (mut lines, mut line) = (BufReader::new(file), Vec::new());
        // A last line without an end is still being written.
        while lines.read_until(b'\n', &mut line)? > 0 && line.ends_with(b"\n") {
            let start = String::from_utf8_lossy(&line[..line.len().min(64)]);
            if let Some(key) = line_key(&start) {
                self.lines.insert(key, (self.searched, line.len()));
            }
            self.searched += line.len() as u64;
            line.clear();
        }
        Ok(())
    }
}

/// The hash, if it is one. A run may come from elsewhere, and must not name files outside of its folder.
fn checked(hash: &Hash) -> Result<&Hash> {
    ensure!(is_hash(hash), "the prompt log names {hash:?}, which is no hash: it is damaged");
    Ok(hash)
}

/// Reads the file `path` of a prompt log in the run folder `run`, which may come from elsewhere: no link is followed.
///
/// # Errors
/// When it cannot be read.
pub fn read_logged(run: &Path, path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_beneath(run, path)?.take(INPUT_LIMIT).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Whether a file of a prompt log may hold `content` under the name `hash`.
pub fn is_named(content: &[u8], hash: &str) -> bool {
    let found = blake3::hash(content).to_hex();
    found.get(..32).is_some_and(|found| found.eq_ignore_ascii_case(hash))
}

/// Reads what `entry` of the prompt log of the run in the folder `run` refers to.
fn resolve(run: &Path, entry: PromptLogEntry) -> Result<RecordedPrompt> {
    let folder = &run.join(PROMPTS_FOLDER);
    let read = |file: fn(&Path, &str) -> PathBuf, hash: &Hash| {
        let path = file(folder, checked(hash)?);
        let unreadable = || format!("cannot read {}", path.display());
        let content = read_logged(run, &path).with_context(unreadable)?;
        ensure!(
            is_named(&content, hash),
            "{} was changed after it was written: its content does not have the hash that is its name",
            path.display()
        );
        String::from_utf8(content).with_context(unreadable)
    };
    let request = &entry.request;
    let mut trajectories: BTreeMap<Hash, Vec<RecordedView>> = BTreeMap::new();
    let (mut texts, mut images) = (Vec::new(), vec![&request.frame]);
    images.extend(request.window.iter().map(|past| &past.frame));
    for item in &request.items {
        match item {
            RecordedItem::Text { text, .. } => texts.push(text),
            RecordedItem::Segment { steps, .. } => {
                images.extend(steps.iter().filter_map(|step| step.frame.as_ref()));
            }
            RecordedItem::Trajectory { steps: hash, .. } => {
                let steps = serde_json::from_str(&read(trajectory_file, hash)?)?;
                trajectories.insert(hash.clone(), steps);
            }
            RecordedItem::Frame { frame, caption, .. } => {
                images.push(frame);
                texts.push(caption);
            }
            RecordedItem::Plan { .. } => {}
        }
    }
    let messages = entry.exchange.iter().flat_map(|exchange| &exchange.messages);
    for part in messages.flat_map(|message| &message.parts) {
        match part {
            RecordedPart::Stored(hash) => texts.push(hash),
            RecordedPart::Image(hash) => images.push(hash),
            RecordedPart::Text(_) | RecordedPart::Png(_) => {}
        }
    }
    let keyframes = trajectories.values().flatten().filter_map(|step| step.frame.as_ref());
    let images = images.into_iter().chain(keyframes);
    let image = |hash: &Hash| Ok((hash.clone(), image_file(folder, checked(hash)?)));
    let images = images.map(image).collect::<Result<_>>()?;
    let read_text = |hash: &Hash| Ok((hash.clone(), read(text_file, hash)?));
    let texts = texts.into_iter().map(read_text).collect::<Result<_>>()?;
    Ok(RecordedPrompt { entry, trajectories, texts, images })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_file_is_searched_once_and_then_only_what_was_added() {
        let run = tempfile::tempdir().unwrap();
        let file = run.path().join("entries.jsonl");
        let mut log = PromptLog::in_run(run.path());
        let mut found = |step| {
            let line = log.line(&file, (7, step)).unwrap()?;
            Some(String::from_utf8(line).unwrap())
        };
        let line = |step: u32, word: &str| {
            format!("{{\"episode\":7,\"step\":{step},\"word\":\"{word}\"}}\n")
        };
        std::fs::write(&file, line(0, "a") + &line(1, "b") + &line(2, "c")[..30]).unwrap();
        assert_eq!(found(1), Some(line(1, "b")));
        assert_eq!(found(2), None, "half a line");
        // What was searched is not searched again: step 4 in place of step 0 is not noticed, step 2 at the end is.
        std::fs::write(&file, line(4, "a") + &line(1, "b") + &line(2, "c") + &line(1, "d"))
            .unwrap();
        assert_eq!((found(2), found(1)), (Some(line(2, "c")), Some(line(1, "d"))));
        assert_eq!(found(4), None);
        // Another file, or one that was begun again, is searched from its start.
        std::fs::write(&file, line(4, "e")).unwrap();
        assert_eq!((found(4), found(1)), (Some(line(4, "e")), None));
        let other = run.path().join("other.jsonl");
        std::fs::write(&other, line(5, "f") + &line(6, "g")).unwrap();
        std::fs::rename(&other, &file).unwrap();
        assert_eq!((found(5), found(4)), (Some(line(5, "f")), None));
    }

    #[test]
    fn a_prompt_log_names_no_file_outside_of_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let prompts = folder.path().join("prompts");
        std::fs::create_dir_all(prompts.join("documents")).unwrap();
        std::fs::write(folder.path().join("secret.txt"), "secret").unwrap();
        std::fs::write(folder.path().join("secret.json"), "[]").unwrap();
        let name = |content: &str| blake3::hash(content.as_bytes()).to_hex()[..32].to_owned();
        let (inside, outside) = (name("note"), "../../secret".to_owned());
        std::fs::write(text_file(&prompts, &inside), "note").unwrap();
        let (linked, changed) = (name("secret"), name("text"));
        std::os::unix::fs::symlink("../../secret.txt", text_file(&prompts, &linked)).unwrap();
        std::fs::write(text_file(&prompts, &changed), "another text").unwrap();
        let read = |frame: &str, item: serde_json::Value| {
            let request = json!({
                "repeat": 1, "seed": 5, "instruction": "Find a cone.", "state": [3, 5, 0], "feedback": "",
                "frame": frame, "starts_as_demonstrated": false, "window": [], "items": [item],
            });
            let timing =
                serde_json::to_value(domain::prompt_log::RecordedTiming::default()).unwrap();
            let entry = json!({
                "episode": 1, "step": 0, "lane": 0, "request": request, "timing": timing,
            });
            resolve(folder.path(), serde_json::from_value(entry).unwrap())
        };
        let text = |hash: &str| json!({"text": {"kind": "note", "text": hash}});
        assert_eq!(read(&inside, text(&inside)).unwrap().text(&inside), "note");
        for (frame, item) in [
            (&inside, text(&outside)),
            (&outside, text(&inside)),
            (&inside, json!({"trajectory": {"instruction": "Find a cone.", "steps": outside}})),
            (&inside, json!({"frame": {"instruction": "", "frame": outside, "caption": inside}})),
        ] {
            let error = read(frame, item).unwrap_err().to_string();
            assert!(error.contains("../../secret\", which is no hash"), "{error}");
        }
        let error = format!("{:#}", read(&inside, text(&linked)).unwrap_err());
        assert!(error.contains("it is a symbolic link"), "{error}");
        let error = read(&inside, text(&changed)).unwrap_err().to_string();
        assert!(error.contains("was changed after it was written"), "{error}");
        std::fs::remove_dir_all(&prompts).unwrap();
        let elsewhere = folder.path().join("elsewhere");
        std::fs::create_dir_all(elsewhere.join("documents")).unwrap();
        std::fs::write(text_file(&elsewhere, &inside), "note").unwrap();
        std::os::unix::fs::symlink("elsewhere", &prompts).unwrap();
        let error = format!("{:#}", read(&inside, text(&inside)).unwrap_err());
        assert!(error.contains("it is a symbolic link"), "{error}");
    }
}
