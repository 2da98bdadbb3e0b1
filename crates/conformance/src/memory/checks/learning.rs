//! Checks of a memory that learns: what it saves, loads and answers then.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use shm_types::MemoryDescription;
use shm_types::message::{ExternalEpisode, ExternalQuery, Learning, NOT_MEASURED};

use super::episodes::end;
use super::{INSTRUCTION, MemoryKit, ordinary};
use crate::checks::clear_away;
use crate::memory::answers::{Supplied, difference};
use crate::memory::pose;
use crate::messages::{external_episode, last_query};
use crate::subject::{CheckResult, next, wrong};

/// What the checks of learning say of a memory that does not.
const NO_LEARNING: &str = "it does not learn, as it says";

/// The views of an episode that is learned from.
const LEARNED: [u64; 4] = [3, 4, 71, 72];

/// Plays an episode that the memory of `bank` learns from, and has it saved into a new folder.
fn learn(kit: &mut MemoryKit<'_>, bank: u64, success: bool) -> CheckResult<PathBuf> {
    let subject = kit.subject()?;
    let learning = Learning::Learns as u32;
    let begun = ExternalEpisode { learning, ..external_episode(0, 0, bank, INSTRUCTION) };
    let mut id = subject.begin_with(begun)?;
    for seed in LEARNED {
        subject.ask_and_wait(id, seed)?;
        id = next(id);
    }
    subject.expect_none(id);
    let demonstration = subject.add_experience(bank, id.step + 1);
    let last = ExternalQuery {
        outcome: 1 + u8::from(success),
        demonstration,
        sub_goals_len: NOT_MEASURED,
        ..last_query(id, pose(0))
    };
    subject.neighbours.queries.send(&last)?;
    save(kit, bank)
}

/// Has the memory of `bank` saved into a new folder.
fn save(kit: &mut MemoryKit<'_>, bank: u64) -> CheckResult<PathBuf> {
    let root = kit.attach.root.clone();
    let mut folders = (0..).map(|number| root.join(format!("snapshot-{number}")));
    let folder = folders.find(|folder| !folder.exists()).unwrap_or(root);
    fs::create_dir(&folder).map_err(anyhow::Error::from)?;
    kit.subject()?.store(bank, &folder, false)?;
    Ok(folder)
}

/// What the memory of `bank` supplies in an episode that reads only.
fn evaluated(kit: &mut MemoryKit<'_>, bank: u64) -> CheckResult<Vec<Vec<Supplied>>> {
    let subject = kit.subject()?;
    let learning = Learning::ReadsOnly as u32;
    let begun = ExternalEpisode { learning, ..external_episode(1, 0, bank, INSTRUCTION) };
    let mut id = subject.begin_with(begun)?;
    let mut supplied = Vec::new();
    for seed in [12, 71, 80] {
        supplied.push(subject.ask_and_wait(id, seed)?.1);
        id = next(id);
    }
    end(subject, id)?;
    Ok(supplied)
}

/// The files below `folder`, by path.
fn files(folder: &Path) -> CheckResult<BTreeMap<PathBuf, Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).map_err(anyhow::Error::from)? {
            let path = entry.map_err(anyhow::Error::from)?.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = fs::read(&path).map_err(anyhow::Error::from)?;
                found.insert(path.strip_prefix(folder).unwrap_or(&path).to_owned(), bytes);
            }
        }
    }
    Ok(found)
}

/// Checks that two snapshots are equal.
fn compare_files(one: &Path, other: &Path, when: &str) -> CheckResult<()> {
    let (one, other) = (files(one)?, files(other)?);
    let all: BTreeSet<&PathBuf> = one.keys().chain(other.keys()).collect();
    let differs: Vec<String> = all
        .into_iter()
        .filter(|path| one.get(*path) != other.get(*path))
        .map(|path| path.display().to_string())
        .collect();
    if differs.is_empty() {
        return Ok(());
    }
    wrong(format_args!("it saves other bytes {when}: {}", differs.join(", ")))
}

/// Checks that two evaluations had the same answers.
fn compare_answers(one: &[Vec<Supplied>], other: &[Vec<Supplied>], when: &str) -> CheckResult<()> {
    match one.iter().zip(other).find(|(one, other)| one != other) {
        None => Ok(()),
        Some((one, other)) => {
            let differs = difference(one, other);
            wrong(format_args!("its answers to the same query differ {when}: {differs}"))
        }
    }
}

pub(super) fn learns_and_saves(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    if !subject.role.description.learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    for success in [true, false] {
        learn(kit, bank, success)?;
        evaluated(kit, bank)?;
    }
    clear_away(kit.subject()?)
}

pub(super) fn loads_what_it_has_saved(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let MemoryDescription { learns, deterministic, .. } = subject.role.description;
    if !learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    let saved = learn(kit, bank, true)?;
    let before = evaluated(kit, bank)?;
    kit.kill_subject();
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    subject.store(bank, &saved, true)?;
    subject.add_experience(bank, LEARNED.len() as u32 + 1);
    let after = evaluated(kit, bank)?;
    let again = save(kit, bank)?;
    clear_away(kit.subject()?)?;
    if !deterministic {
        return Ok("it does not call itself deterministic: not compared".to_owned());
    }
    let when = "after it was loaded";
    compare_answers(&before, &after, when)?;
    compare_files(&saved, &again, when)?;
    Ok(String::new())
}

pub(super) fn evaluates_without_learning(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let MemoryDescription { learns, deterministic, .. } = subject.role.description;
    if !learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    let saved = learn(kit, bank, true)?;
    let [before, after] = [evaluated(kit, bank)?, evaluated(kit, bank)?];
    let again = save(kit, bank)?;
    clear_away(kit.subject()?)?;
    let when = "after an episode that reads only";
    compare_files(&saved, &again, when)?;
    if deterministic {
        compare_answers(&before, &after, when)?;
    }
    Ok(String::new())
}
