//! `memtransfer top`: the live status of a run in progress.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use domain::names::UnknownName;
use domain::{MemoryKind, Representation, shell_word};
use orchestrator::pipeline::Participant;
use orchestrator::status::{LiveStatus, MemoryStatus, StageLatency};
use report::table::table;
use run_log::latency::LatencySummary;
use shm_types::message::{MAX_WORLDS, Role};

use super::{Exit, print, print_json};

/// Time between two drawings of the screen.
const INTERVAL: Duration = Duration::from_millis(500);

/// Clears the terminal and moves to its corner.
const CLEAR: &str = "\x1b[2J\x1b[H";

/// The size of a terminal that does not report it.
const DEFAULT_SIZE: (usize, usize) = (100, 40);

#[derive(Debug, Args)]
#[command(after_help = "\
The process that most lanes wait for limits the run: many lanes waiting for `memory` while images
wait there means that embedding takes the time. Latencies are those of the last half second; a stage
includes waiting for a process that is busy with other lanes.

Examples:
  memtransfer top                       the run in progress in ./runs
  memtransfer top runs/paper-grounded
  memtransfer top --memory episodic     every stage of the steps with episodic memory
  memtransfer top --once --json | jq .steps_per_s")]
pub(super) struct TopArgs {
    /// A run's folder, or a folder of run folders
    #[arg(default_value = "runs", value_name = "DIR")]
    dir: PathBuf,
    /// Show every stage of the steps with this memory
    #[arg(long, value_name = "NAME")]
    memory: Option<String>,
    /// Print the status once, and stop
    #[arg(long)]
    once: bool,
    /// Print the status once, as JSON, with the stages of every memory
    #[arg(long, conflicts_with = "memory")]
    json: bool,
}

pub(super) fn run(args: &TopArgs) -> Result<Exit> {
    let (run, mut status) = running(&args.dir)?;
    if args.json {
        print_json(&status)?;
        return Ok(Exit::Complete);
    }
    let memory = args.memory.as_deref().map(|name| shown_memory(name, &status)).transpose()?;
    let is_screen = program::is_screen(&std::io::stdout()) && !args.once;
    loop {
        let text = page(&run, &status, memory);
        if !is_screen {
            print(&text)?;
            return Ok(Exit::Complete);
        }
        let size = terminal_size::terminal_size();
        let size = size.map_or(DEFAULT_SIZE, |(w, h)| (usize::from(w.0), usize::from(h.0)));
        let screen = fit(&format!("{text}\n\nCtrl-C ends this view, not the run."), size);
        let mut stdout = std::io::stdout().lock();
        write!(stdout, "{CLEAR}{screen}").and_then(|()| stdout.flush())?;
        thread::sleep(INTERVAL);
        let Some(next) = LiveStatus::read(&run)? else {
            print(&format!("\nThe run in {} has ended.", run.display()))?;
            return Ok(Exit::Complete);
        };
        status = next;
    }
}

/// The run in progress in `dir`, or in a folder in it.
fn running(dir: &Path) -> Result<(PathBuf, LiveStatus)> {
    if let Some(status) = LiveStatus::read(dir)? {
        return Ok((dir.to_owned(), status));
    }
    let mut found = Vec::new();
    if dir.is_dir() {
        let entries = dir.read_dir().with_context(|| format!("cannot list {}", dir.display()))?;
        for entry in entries {
            let run = entry?.path();
            if run.is_dir()
                && let Some(status) = LiveStatus::read(&run)?
            {
                found.push((run, status));
            }
        }
    }
    if found.len() > 1 {
        let names = found.iter().map(|(run, _)| format!("  memtransfer top {}", shell_word(run)));
        bail!(
            "several runs are in progress; choose one:\n{}",
            names.collect::<Vec<_>>().join("\n")
        );
    }
    found.pop().with_context(|| {
        format!(
            "no run is in progress in {}: start one with `memtransfer run`, or give the folder of one (its --out)",
            dir.display()
        )
    })
}

/// The memory called `name`: a built-in one, or one that the run has.
fn shown_memory(name: &str, status: &LiveStatus) -> Result<MemoryKind, UnknownName> {
    let built_in = Representation::ALL.iter().copied().map(MemoryKind::BuiltIn);
    let of_run = status.stages.iter().map(|stage| stage.memory);
    let known: BTreeSet<MemoryKind> = built_in.chain(of_run).collect();
    let found = known.iter().find(|memory| memory.name() == name).copied();
    found.ok_or_else(|| UnknownName::new("memory", name, known.iter().map(MemoryKind::name)))
}

/// The first lines of `text` that fit, each cut to the width.
fn fit(text: &str, (width, height): (usize, usize)) -> String {
    let lines: Vec<String> = text.lines().map(|line| line.chars().take(width).collect()).collect();
    lines[..lines.len().min(height.max(1))].join("\n")
}

fn page(run: &Path, status: &LiveStatus, memory: Option<MemoryKind>) -> String {
    let mut text = format!("{}: {}\n", run.display(), status.line());
    let busy: u32 = status.waiting.values().sum();
    text += &format!(
        "{:.0} steps/s now, {} steps in {:.0} s, {busy} of {} lanes are busy\n\n",
        status.steps_per_s, status.steps, status.elapsed_s, status.lanes
    );
    let header = ["process", "lanes waiting", "work", "per second", "queued", "frames", "limit"];
    let mut processes = table(&header, 1);
    let worlds = (0..MAX_WORLDS as u8).map(Participant::world);
    let worlds = worlds
        .filter(|one| one.world == 0 || status.processes.contains_key(&one.to_string()))
        .map(|one| (one, "views rendered"));
    let fixed =
        [(Role::Memory.into(), "images embedded"), (Role::Policy.into(), "requests answered")];
    let external = status.memories.iter().map(|memory| (memory.name.into(), "requests answered"));
    let names = worlds.chain(fixed).chain(external);
    for (name, work) in names.map(|(one, work): (Participant, _)| (one.to_string(), work)) {
        let process = status.processes.get(&name);
        let cell = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        processes.add_row([
            name.clone(),
            status.waiting.get(&name).copied().unwrap_or(0).to_string(),
            work.to_owned(),
            cell(process.map(|process| format!("{:.0}", process.done_per_s))),
            cell(process.map(|process| process.waiting.to_string())),
            cell(process.map(|process| process.held.to_string())),
            cell(
                process.filter(|process| process.room > 0).map(|process| process.room.to_string()),
            ),
        ]);
    }
    text += &format!("{processes}\n\n");
    if !status.memories.is_empty() {
        text += &format!("{}\n\n", external_memories(status));
    }
    text + &match memory {
        Some(memory) => stages(status, memory),
        None => steps(status),
    }
}

/// A row for each external memory: whether it takes part, and how fast it answers.
fn external_memories(status: &LiveStatus) -> String {
    let header =
        ["external memory", "state", "recalls", "p50 us", "p99 us", "method p50", "wire p50"];
    let mut memories = table(&header, 2);
    for MemoryStatus { name, state, recall, method, wire } in &status.memories {
        let us = |times: &Option<LatencySummary>, of: fn(&LatencySummary) -> f64| {
            times.as_ref().map_or_else(|| "-".to_owned(), |times| format!("{:.0}", of(times)))
        };
        memories.add_row([
            name.to_string(),
            state.clone(),
            us(recall, |times| times.count as f64),
            us(recall, |times| times.p50_us),
            us(recall, |times| times.p99_us),
            us(method, |times| times.p50_us),
            us(wire, |times| times.p50_us),
        ]);
    }
    memories.to_string()
}

/// A row for each memory: its steps, and the stages that take most of their time.
fn steps(status: &LiveStatus) -> String {
    let mut steps = table(&["memory", "steps", "p50 us", "p99 us", "max us", "most time in"], 1);
    for whole in status.stages.iter().filter(|stage| stage.stage == "step") {
        let mut of_memory: Vec<&StageLatency> = status
            .stages
            .iter()
            .filter(|stage| stage.memory == whole.memory && stage.stage != "step")
            .collect();
        of_memory.sort_by(|a, b| b.summary.mean_us.total_cmp(&a.summary.mean_us));
        let mean = whole.summary.mean_us.max(f64::MIN_POSITIVE);
        let share = |stage: &&StageLatency| {
            format!("{} {:.0} %", stage.stage, 100.0 * stage.summary.mean_us / mean)
        };
        let shares: Vec<String> = of_memory.iter().take(3).map(share).collect();
        steps.add_row([
            whole.memory.to_string(),
            whole.summary.count.to_string(),
            format!("{:.0}", whole.summary.p50_us),
            format!("{:.0}", whole.summary.p99_us),
            format!("{:.0}", whole.summary.max_us),
            shares.join(", "),
        ]);
    }
    steps.to_string()
}

/// A row for each stage of the steps with `memory`.
fn stages(status: &LiveStatus, memory: MemoryKind) -> String {
    let mut stages = table(&["stage", "steps", "mean us", "p50", "p90", "p99", "max"], 1);
    for StageLatency { stage, summary, .. } in
        status.stages.iter().filter(|stage| stage.memory == memory)
    {
        let us = |us: f64| format!("{us:.1}");
        let times =
            [summary.mean_us, summary.p50_us, summary.p90_us, summary.p99_us, summary.max_us];
        let mut row = vec![stage.clone(), summary.count.to_string()];
        row.extend(times.map(us));
        stages.add_row(row);
    }
    stages.to_string()
}

#[cfg(test)]
mod tests {
    use run_log::Stages;

    use super::*;
    use orchestrator::status::{EpisodeCounts, ProcessStatus};

    #[test]
    fn no_run_is_an_error_that_says_what_to_do() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("notes"), "no run").unwrap();
        let error = running(dir.path()).unwrap_err().to_string();
        assert!(error.contains("no run is in progress") && error.contains("memtransfer run"));
        assert!(running(&dir.path().join("none")).is_err());
    }

    fn busy() -> LiveStatus {
        let summary = LatencySummary {
            count: 123_456,
            mean_us: 123_456.7,
            p50_us: 123_456.7,
            p90_us: 1_234_567.8,
            p99_us: 1_234_567.8,
            p999_us: 1_234_567.8,
            max_us: 12_345_678.9,
        };
        let stages = Representation::ALL.iter().flat_map(|&memory| {
            let (memory, summary) = (MemoryKind::BuiltIn(memory), summary.clone());
            Stages::NAMES.into_iter().chain(["step"]).map(move |stage| StageLatency {
                memory,
                stage: stage.to_owned(),
                summary: summary.clone(),
            })
        });
        let process =
            ProcessStatus { done: 1, done_per_s: 12_345.0, waiting: 64, held: 9999, room: 99_999 };
        LiveStatus {
            episodes: EpisodeCounts {
                planned: 17_500,
                finished: (9000, 100),
                ..Default::default()
            },
            steps: 12_345_678,
            running_s: 1e5,
            elapsed_s: 1e5,
            lanes: 64,
            processes: Role::CHILDREN.map(|role| (role.word().to_owned(), process)).into(),
            stages: stages.collect(),
            ..LiveStatus::default()
        }
    }

    #[test]
    fn six_memories_fit_a_terminal() {
        let status = busy();
        for memory in [None, Some(Representation::FullContext.into())] {
            let page = page(Path::new("runs/paper-openai-some-model"), &status, memory);
            let most = if memory.is_none() { 24 } else { 30 };
            assert!(page.lines().count() <= most, "{page}");
            assert!(page.lines().all(|line| line.chars().count() <= 100), "{page}");
        }
        let page = page(Path::new("run"), &status, None);
        assert!(Representation::ALL.iter().all(|memory| page.contains(memory.name())), "{page}");
        assert_eq!(fit("abcdef\nb\nc", (3, 2)), "abc\nb");
    }

    #[test]
    fn external_memories_show_their_state_and_what_they_compute_apart_from_the_wire() {
        let mut status = busy();
        let stage = &status.stages[0];
        let times = Some(LatencySummary { p50_us: 30.0, ..stage.summary.clone() });
        let own = MemoryKind::External("a-memory-of-twenty-four".parse().unwrap());
        let stages = status.stages[..13].iter().cloned();
        let stages: Vec<_> = stages.map(|stage| StageLatency { memory: own, ..stage }).collect();
        status.stages.extend(stages);
        let memory = MemoryStatus {
            name: own.external().unwrap(),
            state: "failed 2 times, started again".to_owned(),
            recall: times.clone(),
            method: times.clone(),
            wire: times,
        };
        let excluded = MemoryStatus {
            name: "bm25".parse().unwrap(),
            state: "left out".to_owned(),
            recall: None,
            method: None,
            wire: None,
        };
        status.memories = vec![memory, excluded];
        status.waiting.insert("external-memory bm25".to_owned(), 7);
        let shown = page(Path::new("run"), &status, None);
        assert!(shown.lines().all(|line| line.chars().count() <= 100), "{shown}");
        let row = |start: &str| shown.lines().find(|line| line.starts_with(start)).unwrap();
        let cells: Vec<&str> = row("external-memory bm25").split_whitespace().collect();
        assert_eq!(cells[2], "7", "{shown}");
        assert!(row("bm25").contains("left out") && row("bm25").ends_with('-'), "{shown}");
        assert!(shown.contains("failed 2 times"), "{shown}");
        assert_eq!(shown_memory("a-memory-of-twenty-four", &status).unwrap(), own);
        let error = shown_memory("bm2", &status).unwrap_err().to_string();
        assert!(error.starts_with("unknown memory `bm2`"), "{error}");
    }

    #[test]
    fn a_run_that_waits_for_the_server_says_so() {
        let waiting_for_server = Some("connection refused".to_owned());
        let status = LiveStatus { waiting_for_server, ..busy() };
        let page = page(Path::new("run"), &status, None);
        assert!(page.contains("waiting for the server: connection refused"), "{page}");
    }
}
