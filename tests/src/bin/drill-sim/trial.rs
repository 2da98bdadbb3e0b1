//! One trial: a run among the faults of a seed, resumed until it ends, and what has to be true afterwards.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;
use case_book::DEMONSTRATIONS_FILE;
use conditions::settings::RunSettings;
use orchestrator::external_memory::StartedMemories;
use orchestrator::frame_budget::Demand;
use orchestrator::invocation::Invocation;
use orchestrator::pipeline::Ending;
use orchestrator::progress::Verbosity;
use orchestrator::run::{self, RunOutcome};
use orchestrator::run_plan::RunPlan;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use run_log::{
    EPISODES_FILE, SNAPSHOTS_FOLDER, SessionEvent, SessionRecord, TIMINGS_FILE, read_journal,
};
use shm_types::RunDir;
use supervise::Children;

use crate::Plant;
use crate::faults::{Plan, Process, Trouble};
use crate::roles::{Files, InProcess};
use crate::scenario::Scenario;
use crate::scheduler::{Account, Ended, Scheduler};

/// Points of the scheduler after which a trial counts as hanging.
const MOST_STEPS: u64 = 3_000_000;

/// Sessions after which a run counts as one that never ends.
const MOST_SESSIONS: usize = 24;

/// Virtual time within which a session ends, unless one of [`THAT_TAKE_TIME`] came. Pauses before a new generation are
/// shorter by far, time limits of answers are longer.
const LONGEST_SESSION: Duration = Duration::from_secs(20);

/// Faults after which processes wait for a time limit.
const THAT_TAKE_TIME: [Trouble; 3] =
    [Trouble::Stall(Process::Orchestrator, 0), Trouble::Jump(0), Trouble::FullQueue];

/// Time in which threads that a session has joined disappear.
const ENDING_TIME: Duration = Duration::from_secs(2);

/// Bytes that a disk writes at once.
const SECTOR: usize = 512;

/// The journal of sessions in a run folder.
const SESSIONS_FILE: &str = "sessions.jsonl";

/// Where trials keep their files.
pub(crate) struct Place {
    /// Run folders.
    pub(crate) folder: PathBuf,
    /// The registry of runs; its path is short.
    pub(crate) registry: PathBuf,
}

impl Place {
    /// The embeddings and views that the sessions of a trial share.
    fn caches(&self) -> PathBuf {
        self.folder.join("caches")
    }

    /// Runs that are registered, and the shared memory of the runs called `names`.
    fn leftovers(&self, names: &[String]) -> Result<Vec<String>> {
        let mut left = memtransfer_tests::shared_memory_of(names);
        for entry in fs::read_dir(&self.registry)? {
            left.push(format!("the run in {} is left", entry?.path().display()));
        }
        Ok(left)
    }
}

/// What came of a trial.
pub(crate) struct Outcome {
    pub(crate) violations: Vec<String>,
    pub(crate) account: Account,
    pub(crate) sessions: usize,
    /// The lines of the episode log, sorted.
    pub(crate) log: Vec<String>,
}

/// Executes the run of `plan`. `expected` is the log of the undisturbed run.
pub(crate) fn execute(
    scenario: &Scenario,
    plan: &Plan,
    (seed, plant): (u64, Option<Plant>),
    place: &Place,
    expected: Option<&[String]>,
) -> Result<Outcome> {
    let out = place.folder.join("run");
    let caches = place.caches();
    for folder in [&out, &caches] {
        if folder.exists() {
            fs::remove_dir_all(folder)?;
        }
    }
    // It is there when the power fails before any process has started.
    fs::create_dir(&caches)?;
    let scheduler = Scheduler::new(seed, plan.preemption, plan.faults.clone(), MOST_STEPS);
    // A stream has one world.
    let worlds = if scenario.settings.stream.is_some() { 1 } else { plan.worlds };
    let settings =
        RunSettings { out: out.clone(), lanes: plan.lanes, worlds, ..scenario.settings.clone() };
    let mut violations = Vec::new();
    let names = RefCell::new(Vec::new());
    let mut sessions = 0;
    let mut is_complete = false;
    while !is_complete && sessions < MOST_SESSIONS && violations.is_empty() {
        sessions += 1;
        let lengths = lengths(&out);
        let resources = Resources::now()?;
        let before = scheduler.account();
        let (ended, left) = scheduler
            .execute(|| session(scenario, &settings, plan, (&scheduler, plant), (place, &names)));
        let after = scheduler.account();
        let fired = after.trace.len() > before.trace.len();
        violations.extend(after.trace.iter().filter(|line| line.starts_with("PANIC")).cloned());
        match ended {
            _ if after.is_hanging => violations.push(format!(
                "the run hangs: {MOST_STEPS} points of the scheduler were passed in session {sessions}"
            )),
            Ended::Returned(Ok(RunOutcome::NothingMissing)) => is_complete = true,
            Ended::Returned(Ok(RunOutcome::Ended(ending))) => {
                let incomplete = why_incomplete(&ending);
                is_complete = incomplete.is_none();
                match incomplete {
                    _ if fired => {}
                    None => violations.extend(problems(&out)?),
                    Some(why) => violations.push(format!(
                        "session {sessions} without a fault left episodes out: {why}"
                    )),
                }
            }
            Ended::Returned(Ok(RunOutcome::OverBudget(why))) => {
                violations.push(format!("session {sessions} has no budget, and stopped: {why}"));
            }
            Ended::Returned(Ok(RunOutcome::Stopped)) => {
                violations.push(format!("session {sessions} stopped unasked"));
            }
            Ended::Returned(Err(error)) if !fired => {
                violations.push(format!("session {sessions} without a fault failed: {error:#}"));
            }
            Ended::Returned(Err(_)) => {}
            Ended::Killed => {
                if scheduler.take_power_failure() {
                    lose_last_lines(&out, &scheduler, lengths, seed)?;
                    damage_files(&caches, &mut ChaCha8Rng::seed_from_u64(seed))?;
                }
            }
            Ended::Panicked(why) => violations.push(format!("the orchestrator panicked: {why}")),
        }
        let took = Duration::from_nanos(after.virtual_ns - before.virtual_ns);
        let took_time = |trouble: &Trouble| {
            let count = |account: &Account| account.fired.get(trouble.class()).copied();
            count(&before) != count(&after)
        };
        if took > LONGEST_SESSION && !THAT_TAKE_TIME.iter().any(took_time) {
            violations.push(format!("session {sessions} took {} s in vain", took.as_secs()));
        }
        if left > 0 {
            violations.push(format!("{left} processes outlive session {sessions}"));
        }
        violations.extend(resources.left_open()?);
        violations.extend(place.leftovers(&names.borrow())?);
    }
    if !is_complete && violations.is_empty() {
        violations.push(format!("the run is not complete after {sessions} sessions"));
    }
    if let (Some(plant), true) = (plant, is_complete) {
        damage(plant, &out)?;
    }
    let log = memtransfer_tests::sorted_log(&out);
    if let (Some(expected), true) = (expected, is_complete) {
        violations.extend(differences(expected, &log));
    }
    Ok(Outcome { violations, account: scheduler.account(), sessions, log })
}

/// One session of the run. Adds the name that it is registered by to `names`.
fn session(
    scenario: &Scenario,
    settings: &RunSettings,
    plan: &Plan,
    (scheduler, plant): (&Arc<Scheduler>, Option<Plant>),
    (place, names): (&Place, &RefCell<Vec<String>>),
) -> Result<RunOutcome> {
    let run = RunDir::create(&place.registry)?;
    names.borrow_mut().push(run.name());
    let books = &scenario.selected.books;
    let memories = scenario.memories.clone();
    let run_plan = RunPlan {
        settings: settings.clone(),
        books: books.clone(),
        episodes: scenario.episodes.clone(),
        unit: None,
        shipped_embeddings: None,
        prices: None,
        prompt: None,
        started: Some(StartedMemories { children: Children::default(), memories, run }),
    };
    let stop = AtomicBool::new(false);
    let invocation = Invocation {
        verbosity: Verbosity::Silent,
        adjust: Box::new(|settings, attach, options| {
            let most = (settings.keyframes, settings.memory_image_budget());
            let cases = (&books.cases.book, &books.demonstrations.book);
            // Decided by all episodes, so that it is the same in every session.
            let demand = Demand::of(attach, cases, &scenario.episodes, most);
            attach.frame_capacity = demand.least(attach.lanes_of_world()) + plan.spare_frames;
            let out = &settings.out;
            options.launcher = Arc::new(InProcess {
                scheduler: scheduler.clone(),
                worlds: scenario.worlds.clone(),
                files: Files {
                    assets: scenario.assets.clone(),
                    demonstrations: out.join(DEMONSTRATIONS_FILE),
                    snapshots: books.streams.as_ref().map(|_| out.join(SNAPSHOTS_FOLDER)),
                    caches: place.caches(),
                },
                plant,
            });
            Ok(())
        }),
        ..Invocation::until(&stop)
    };
    run::execute(run_plan, &invocation)
}

/// Why episodes are missing after a session that ended like this, if any are.
fn why_incomplete(Ending { halted, unfinished, .. }: &Ending) -> Option<String> {
    let unfinished = unfinished.iter().map(|(episode, why)| format!("{}: {why}", episode.key));
    let reasons: Vec<String> = halted.iter().cloned().chain(unfinished).collect();
    (!reasons.is_empty()).then(|| reasons.join("; "))
}

/// What the last session of the run in `out`, which had no fault, reports as one.
fn problems(out: &Path) -> Result<Vec<String>> {
    let records = read_journal::<SessionRecord>(&out.join(SESSIONS_FILE), |_| Ok(()))?.entries;
    let last = records.iter().map(|record| record.session).max();
    let of_last = records.iter().filter(|record| Some(record.session) == last);
    let problem = |record: &SessionRecord| match &record.event {
        SessionEvent::Failed { reason, .. } => {
            Some(format!("a generation without a fault failed: {reason}"))
        }
        SessionEvent::Ended { shutdown_reports, .. } => {
            let errors = |counts: &BTreeMap<String, u64>| counts.get("error_reports") != Some(&0);
            let reported = shutdown_reports.iter().find(|(_, counts)| errors(counts));
            reported.map(|(role, _)| format!("{role} reported errors without a fault"))
        }
        _ => None,
    };
    Ok(of_last.filter_map(problem).collect())
}

/// How a log differs from the expected one.
fn differences(expected: &[String], log: &[String]) -> Vec<String> {
    let mut count: BTreeMap<&str, i64> = BTreeMap::new();
    expected.iter().for_each(|line| *count.entry(line).or_default() -= 1);
    log.iter().for_each(|line| *count.entry(line).or_default() += 1);
    let short = |line: &str| line.chars().take(160).collect::<String>();
    let differing = count.into_iter().filter(|(_, count)| *count != 0);
    differing
        .map(|(line, count)| match count {
            ..0 => format!("the log lacks: {}", short(line)),
            0.. => format!("the log has {count} more of: {}", short(line)),
        })
        .collect()
}

/// What a defect that is planted does to the log of a run that is complete.
fn damage(plant: Plant, out: &Path) -> Result<()> {
    let path = out.join(EPISODES_FILE);
    let text = fs::read_to_string(&path)?;
    let mut lines: Vec<&str> = text.lines().collect();
    match plant {
        Plant::LostLine => drop(lines.pop()),
        Plant::DoubledLine => lines.push(lines[0]),
        Plant::LeftOpen | Plant::WaitsInVain | Plant::OtherDecisions => {}
    }
    Ok(fs::write(path, lines.join("\n") + "\n")?)
}

/// The journals of the run in `out` whose last lines may not be on the disk when the power fails.
fn journals(out: &Path) -> [PathBuf; 3] {
    [out.join(EPISODES_FILE), out.join(TIMINGS_FILE), out.join(SESSIONS_FILE)]
}

/// Bytes in each journal.
fn lengths(out: &Path) -> [usize; 3] {
    journals(out).map(|path| fs::metadata(path).map_or(0, |file| file.len() as usize))
}

/// Cuts part or all of the last line off the journals of the run in `out`, if it was written by the session that began
/// with these `lengths` and not flushed when the power failed. `seed` decides how much.
fn lose_last_lines(
    out: &Path,
    scheduler: &Scheduler,
    lengths: [usize; 3],
    seed: u64,
) -> Result<()> {
    for ((path, length), shift) in journals(out).into_iter().zip(lengths).zip(0..) {
        let Ok(text) = fs::read(&path) else { continue };
        let before = text.strip_suffix(b"\n").unwrap_or(&text);
        let last = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
        let flushed = scheduler.flushed(&path) as usize;
        let kept = last.max(length).max(flushed).min(text.len());
        let lost = (seed >> shift) as usize % (text.len() - kept + 1);
        fs::write(&path, &text[..text.len() - lost])?;
    }
    Ok(())
}

/// Damages half of the files in `folder` as a disk does that loses its power: some are cut off, some have a sector of other
/// bytes.
fn damage_files(folder: &Path, draws: &mut ChaCha8Rng) -> Result<()> {
    let entries = fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path()));
    let mut paths = entries.collect::<Result<Vec<_>, _>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            damage_files(&path, draws)?;
            continue;
        }
        let mut bytes = fs::read(&path)?;
        let [kind, at] = [(); 2].map(|()| draws.next_u64());
        let at = at as usize % bytes.len().max(1);
        match kind % 4 {
            0 => bytes.truncate(at),
            1 => {
                let end = bytes.len().min(at + SECTOR);
                draws.fill_bytes(&mut bytes[at..end]);
            }
            _ => continue,
        }
        fs::write(&path, &bytes)?;
    }
    Ok(())
}

/// What a program holds that a session must give back.
#[derive(Debug)]
struct Resources {
    descriptors: usize,
    threads: usize,
}

impl Resources {
    fn now() -> Result<Self> {
        let count = |folder: &str| Ok::<_, anyhow::Error>(fs::read_dir(folder)?.count());
        Ok(Self { descriptors: count("/proc/self/fd")?, threads: count("/proc/self/task")? })
    }

    /// What has been left open since `self` was counted. The system lists a thread for a moment after it was joined, so
    /// there may be fewer than before, and more count only if they stay.
    fn left_open(&self) -> Result<Option<String>> {
        let deadline = Instant::now() + ENDING_TIME;
        loop {
            let now = Self::now()?;
            if now.descriptors <= self.descriptors && now.threads <= self.threads {
                return Ok(None);
            }
            if Instant::now() >= deadline {
                return Ok(Some(format!(
                    "a session left something open: {self:?} before, {now:?} after"
                )));
            }
            thread::sleep(Duration::from_millis(1));
        }
    }
}
