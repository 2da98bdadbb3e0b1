//! `memtransfer top`: what a running run is at.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::json;
use shm_types::message::Role;

use super::{Exit, print, print_json};
use crate::status::Status;
use results::table::table;

/// How often the screen is drawn anew.
const INTERVAL: Duration = Duration::from_millis(500);

/// Clears the terminal and goes to its corner.
const CLEAR: &str = "\x1b[2J\x1b[H";

#[derive(Debug, Args)]
#[command(after_help = "\
Where lanes pile up is what limits the run: many waiting for `memory` while images wait there means
that embedding is what takes time. Times are of the last half second; a stage includes waiting for a
process that is busy with others.

Examples:
  memtransfer top                       the run that is going on in ./runs
  memtransfer top runs/paper-grounded
  memtransfer top --once --json | jq .steps_per_s")]
pub(super) struct TopArgs {
    /// A run's folder, or a folder of run folders
    #[arg(default_value = "runs", value_name = "DIR")]
    dir: PathBuf,
    /// Print it once, and stop
    #[arg(long)]
    once: bool,
    /// Print JSON, once
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &TopArgs) -> Result<Exit> {
    let (run, mut status) = running(&args.dir)?;
    if args.json {
        print_json(&json!(status))?;
        return Ok(Exit::Complete);
    }
    let screen = std::io::stdout().is_terminal() && !args.once;
    loop {
        let text = shown(&run, &status);
        if !screen {
            print(&text)?;
            return Ok(Exit::Complete);
        }
        print!("{CLEAR}{text}\n\nEnds with the run; Ctrl-C leaves it alone.\n");
        std::io::stdout().flush()?;
        thread::sleep(INTERVAL);
        let Some(next) = Status::read(&run)? else {
            print(&format!("The run in {} is over.", run.display()))?;
            return Ok(Exit::Complete);
        };
        status = next;
    }
}

/// The run in `dir`, or in a folder of it, that is going on.
fn running(dir: &Path) -> Result<(PathBuf, Status)> {
    if let Some(status) = Status::read(dir)? {
        return Ok((dir.to_owned(), status));
    }
    let mut found = Vec::new();
    if dir.is_dir() {
        for entry in
            dir.read_dir().with_context(|| format!("cannot look into {}", dir.display()))?
        {
            let run = entry?.path();
            if run.is_dir()
                && let Some(status) = Status::read(&run)?
            {
                found.push((run, status));
            }
        }
    }
    match found.len() {
        0 => bail!(
            "no run is going on in {}: start one with `memtransfer run`, or name its folder \
             (--out of that run)",
            dir.display()
        ),
        1 => found.pop().context("one was found"),
        _ => {
            let names: Vec<String> = found
                .iter()
                .map(|(run, _)| format!("  memtransfer top {}", run.display()))
                .collect();
            bail!("several runs are going on; say which:\n{}", names.join("\n"))
        }
    }
}

fn shown(run: &Path, status: &Status) -> String {
    let (total, done) = status.episodes;
    let mut text = format!(
        "{}: {done}/{total} episodes, {:.0} steps/s now, {} steps in {:.0} s\n\n",
        run.display(),
        status.steps_per_s,
        status.steps,
        status.elapsed_s
    );

    let waiting = |role: Role| status.waiting.get(role.word()).copied().unwrap_or(0);
    let busy: u32 = status.waiting.values().sum();
    let mut processes =
        table(&["process", "lanes wait", "does", "a second", "waiting", "frames", "room"], 1);
    for (role, does) in [
        (Role::Sim, "draws views"),
        (Role::Memory, "embeds images"),
        (Role::Policy, "answers requests"),
    ] {
        let told = status.processes.get(role.word());
        let cell = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        processes.add_row([
            role.word().to_owned(),
            waiting(role).to_string(),
            does.to_owned(),
            cell(told.map(|told| format!("{:.0}", told.done_per_s))),
            cell(told.map(|told| told.waiting.to_string())),
            cell(told.map(|told| told.held.to_string())),
            cell(told.filter(|told| told.room > 0).map(|told| told.room.to_string())),
        ]);
    }
    text += &format!("{processes}\n{busy} of {} lanes are busy.\n\n", status.lanes);

    let mut stages = table(&["memory", "stage", "steps", "mean us", "p50", "p99", "max"], 2);
    let us = |us: f64| format!("{us:.1}");
    for stage in &status.stages {
        let summary = &stage.summary;
        stages.add_row([
            stage.memory.to_string(),
            stage.stage.clone(),
            summary.count.to_string(),
            us(summary.mean_us),
            us(summary.p50_us),
            us(summary.p99_us),
            us(summary.max_us),
        ]);
    }
    text + &stages.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_run_is_an_error_that_says_what_to_do() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("notes"), "no run").unwrap();
        let error = running(dir.path()).unwrap_err().to_string();
        assert!(error.contains("no run is going on") && error.contains("memtransfer run"));
        assert!(running(&dir.path().join("none")).is_err());
    }
}
