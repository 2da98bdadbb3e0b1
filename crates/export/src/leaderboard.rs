//! A leaderboard of runs: an entry for each run, a page and a table of many.
//!
//! An entry holds what a comparison needs, and nothing of the episodes. Entries are comparable where they have the same
//! [protocol](results::log::Manifest::protocol); a page has a section for each protocol and says in what they differ.

mod board;
mod entry;
mod page;

pub use board::{Board, BoardSection, BoardTable};
pub use entry::{Entry, EntryFigure, EntryPolicy, Score};

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use durable::input::read_text;
use results::log::RunLog;

use crate::files::{is_file, write_text};

/// Entries that were read.
#[derive(Debug, Default)]
pub struct Found {
    /// The entries, in the order of their files.
    pub entries: Vec<Entry>,
    /// Files that are left out, and why.
    pub left_out: Vec<String>,
    /// Damaged lines of run folders, whose content is missing in the entries.
    pub damaged: Vec<String>,
}

/// Writes the entry of `log` to the file `out`, or into the folder `out` under the name of the run. Returns the file.
///
/// # Errors
/// When the file is the entry of another run, or the system refuses.
pub fn write_entry(log: &RunLog, out: &Path) -> Result<PathBuf> {
    let path = match is_file(out, "json") {
        true => out.to_owned(),
        false => out.join(format!("{}.json", log.name)),
    };
    let entry = Entry::of(log)?;
    let before = read_text(&path).ok().and_then(|text| Entry::parse(&text).ok());
    let is_another = |one: &Entry| (&one.date, &one.policy) != (&entry.date, &entry.policy);
    if let Some(other) = before.filter(is_another) {
        bail!(
            "{} is the entry of another run, of {} by {}: give --out another name that ends in .json",
            path.display(),
            other.date.as_deref().unwrap_or("an unknown date"),
            other.policy.name
        );
    }
    let mut text = serde_json::to_string_pretty(&entry)?;
    text.push('\n');
    write_text(&path, &text)?;
    Ok(path)
}

/// Writes the page of `board`.
///
/// # Errors
/// When the system refuses.
pub fn write_page(board: &Board, path: &Path) -> Result<()> {
    write_text(path, &page::render(board)?)
}

/// Reads the entries that `paths` name: files of entries, run folders, and folders that hold either. The same entry twice
/// counts once.
///
/// # Errors
/// When a path does not exist, or names a file that is no entry.
pub fn read(paths: &[PathBuf]) -> Result<Found> {
    let mut found = Found::default();
    for path in paths {
        if path.is_dir() && !is_run(path) {
            found.folder(path)?;
        } else {
            let entry = found.entry_at(path)?;
            found.add(entry, path);
        }
    }
    Ok(found)
}

fn is_run(path: &Path) -> bool {
    path.join("manifest.json").is_file()
}

impl Found {
    fn entry_at(&mut self, path: &Path) -> Result<Entry> {
        if path.is_dir() {
            let log = RunLog::read(path)?;
            self.damaged.extend(log.damaged.iter().map(|line| format!("{}: {line}", log.name)));
            return Entry::of(&log);
        }
        let text = read_text(path).with_context(|| format!("cannot read {}", path.display()))?;
        Entry::parse(&text).with_context(|| path.display().to_string())
    }

    /// Adds the entry at `path`. Where another run has the same name, the folder that holds it stands before it.
    fn add(&mut self, mut entry: Entry, path: &Path) {
        if self.entries.iter().any(|known| known.is_of_same_run(&entry)) {
            return;
        }
        if entry.scores.is_empty() {
            return self.left_out.push(format!("{}: no episode is finished", path.display()));
        }
        if self.entries.iter().any(|known| known.run == entry.run) {
            let path = path.canonicalize().unwrap_or(path.to_owned());
            let folder = path.parent().and_then(Path::file_name).unwrap_or_default();
            entry.run = format!("{}/{}", folder.to_string_lossy(), entry.run);
        }
        self.entries.push(entry);
    }

    fn folder(&mut self, folder: &Path) -> Result<()> {
        let cannot = || format!("cannot list {}", folder.display());
        let listed = fs::read_dir(folder).with_context(cannot)?;
        let paths = listed.map(|entry| entry.map(|entry| entry.path()));
        let mut paths = paths.collect::<Result<Vec<_>, _>>().with_context(cannot)?;
        paths.sort();
        for path in paths {
            let is_entry = path.is_file() && is_file(&path, "json");
            if !is_entry && !is_run(&path) {
                continue;
            }
            match self.entry_at(&path) {
                Ok(entry) => self.add(entry, &path),
                Err(error) => self.left_out.push(format!("{}: {error:#}", path.display())),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use results::conditions::PolicyKind;
    use results::log::testing::{log, record};

    use super::*;

    #[test]
    fn runs_of_one_name_are_told_apart_and_do_not_replace_each_other() {
        let dir = tempfile::tempdir().unwrap();
        let folders = ["one", "two"].map(|name| dir.path().join(name));
        let one = log(vec![record("t01-01", true)]);
        let mut two = log(vec![record("t01-01", false)]);
        two.manifest.settings.policy = PolicyKind::Random;
        let first = write_entry(&one, &folders[0]).unwrap();
        assert_eq!(write_entry(&one, &folders[0]).unwrap(), first, "the same run again");
        let error = write_entry(&two, &folders[0]).unwrap_err().to_string();
        assert!(error.contains("is the entry of another run"), "{error}");
        write_entry(&two, &folders[1]).unwrap();
        let found = read(&folders).unwrap();
        let names: Vec<&str> = found.entries.iter().map(|entry| entry.run.as_str()).collect();
        assert_eq!(names, ["run", "two/run"]);
        let nothing = dir.path().join("nothing.json");
        write_entry(&log(vec![]), &nothing).unwrap();
        assert!(read(&[nothing]).unwrap().left_out[0].ends_with("no episode is finished"));
    }

    #[test]
    fn entries_are_read_from_files_and_folders_each_once() {
        let dir = tempfile::tempdir().unwrap();
        let one = log(vec![record("t01-01", true)]);
        let first = write_entry(&one, &dir.path().join("a.json")).unwrap();
        let second = write_entry(&one, dir.path()).unwrap();
        assert!(second.ends_with("run.json"), "{}", second.display());
        fs::write(dir.path().join("notes.json"), "{}").unwrap();
        fs::write(dir.path().join("notes.txt"), "").unwrap();
        let found = read(&[dir.path().to_owned(), first]).unwrap();
        assert_eq!(found.entries.len(), 1);
        assert_eq!(found.left_out.len(), 1, "{:?}", found.left_out);
        assert!(found.left_out[0].contains("no entry of a leaderboard"), "{:?}", found.left_out);
        assert!(read(&[dir.path().join("nothing")]).is_err());
        let leftovers = fs::read_dir(dir.path()).unwrap();
        assert!(leftovers.flatten().all(|one| !one.path().ends_with(".part")));
    }
}
