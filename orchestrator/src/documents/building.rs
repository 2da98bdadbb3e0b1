//! Builds documents: starts `memory-proc build` and follows its progress.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use case_book::{BookFile, DEMONSTRATIONS_FILE};
use documents::{DocumentFolder, DocumentName, Recipe};
use domain::SecretHeader;
use run_log::ELSEWHERE_FILE;
use shm_types::message::Role;
use supervise::{Group, Launch};

use super::{BuildStage, DocumentRequest};
use crate::scratch::ScratchFolder;

/// The ids of the cases of another world, for the process.
const CASE_IDS_FILE: &str = "case-ids.json";

/// How often signals are looked for.
const TICK: Duration = Duration::from_millis(50);

/// Builds documents in `folder`. Returns false when stopped.
///
/// # Errors
/// When the process cannot be started, or fails.
pub(super) fn build(
    request: &DocumentRequest,
    recipe: &Recipe,
    folder: &DocumentFolder,
    names: &[DocumentName],
    stop: &AtomicBool,
    report: &mut dyn FnMut(BuildStage),
) -> Result<bool> {
    report(BuildStage::Starting);
    let scratch = ScratchFolder::new().context("cannot create a temporary folder")?;
    let Launch { program, args, env, .. } =
        launch(request, recipe, folder.path(), names, scratch.path())?;
    let logs = folder.path().join("logs");
    let log = logs.join("memory.log");
    let created = fs::create_dir_all(&logs).and_then(|()| File::create(&log));
    let errors = created.with_context(|| format!("cannot create {}", log.display()))?;
    let mut command = Command::new(&program);
    if matches!(recipe, Recipe::Extractive) {
        supervise::without_keys(&mut command);
    }
    command
        .args(args)
        .envs(env)
        .envs([SecretHeader::variable(&request.server.headers)])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(errors);
    // With the process that draws views for it.
    let mut group = Group::start_watched(&mut command)
        .with_context(|| format!("cannot start {}", program.display()))?;
    let output = BufReader::new(group.take_stdout().context("a child process without output")?);
    let (sender, lines) = mpsc::channel();
    let read = move || output.lines().map_while(Result::ok).try_for_each(|line| sender.send(line));
    let reading = thread::Builder::new().spawn(read).context("cannot start a thread");
    let is_stopped = reading.is_err()
        || loop {
            match lines.recv_timeout(TICK) {
                Ok(line) => stage_of(&line).into_iter().for_each(&mut *report),
                Err(RecvTimeoutError::Disconnected) if !group.is_alive() => break false,
                Err(RecvTimeoutError::Disconnected) => thread::sleep(TICK),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if stop.load(Ordering::Relaxed) {
                break true;
            }
        };
    let status = group.end().context("cannot wait for memory-proc")?;
    reading?;
    if !is_stopped && !status.success() {
        let messages = durable::input::read_text(&log).unwrap_or_default();
        let last =
            messages.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no message");
        bail!("memory-proc ended ({status}): {last}\nIts log: {}", log.display());
    }
    Ok(!is_stopped)
}

/// The stage that a line of the process's output tells.
fn stage_of(line: &str) -> Option<BuildStage> {
    let mut words = line.split(' ');
    let (stage, done, total) = (words.next()?, words.next()?.parse(), words.next()?.parse());
    let writing = BuildStage::Writing(done.ok()?, total.ok()?);
    (stage == "parts").then_some(writing)
}

/// The process, with its files in the folder `files`.
fn launch(
    request: &DocumentRequest,
    recipe: &Recipe,
    folder: &Path,
    names: &[DocumentName],
    files: &Path,
) -> Result<Launch> {
    let write = |name: &str, text: &str| {
        let path = files.join(name);
        fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        Ok::<_, anyhow::Error>(path.display().to_string())
    };
    let DocumentRequest { sources, assets, elsewhere, own_world, .. } = request;
    let book = BookFile::new(sources.book())?;
    let elsewhere = elsewhere.as_ref().map(|text| write(ELSEWHERE_FILE, text)).transpose()?;
    let case_ids = own_world.as_ref().map(|world| serde_json::to_string(&world.case_ids));
    let case_ids = case_ids.transpose()?.map(|ids| write(CASE_IDS_FILE, &ids)).transpose()?;
    let names: Vec<String> = names.iter().map(DocumentName::to_string).collect();
    let flags = [
        ("--demonstrations", Some(write(DEMONSTRATIONS_FILE, &book.text)?)),
        ("--assets", assets.as_ref().map(|path| path.display().to_string())),
        ("--elsewhere", elsewhere),
        ("--case-ids", case_ids),
        ("--world-cmd", own_world.as_ref().and_then(|world| world.command.clone())),
        ("--frame-size", Some(sources.frame_size().to_string())),
        ("--documents", Some(folder.display().to_string())),
        ("--wanted", Some(names.join(","))),
    ];
    let appearance = sources.appearance().flags().map(|(flag, value)| (flag, Some(value)));
    let launch = Launch::sibling(Role::Memory, "memory-proc", vec!["build".into()])?;
    Ok(launch.with_flags(flags).with_flags(appearance).with_flags(request.builder_flags(recipe)))
}
