//! `memtransfer profile`: how long an access to memory takes, part by part, as tables, data and a page.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use build_commit::COMMIT;
use clap::Args;
use conditions::representation;
use conditions::settings::RunSettings;
use domain::{Representation, cache_folder};
use orchestrator::invocation::Invocation;
use orchestrator::machine::{Machine, floors};
use orchestrator::profile::recorder::AccessRecorder;
use orchestrator::profile::search;
use orchestrator::progress::Verbosity;
use orchestrator::run::{RunOutcome, observe};
use orchestrator::run_plan::{Purpose, RunPlan, Selected};
use orchestrator::scratch::ScratchFolder;
use settings::{Layer, resolve, variable};
use shm_types::message::Role;

use super::{Exit, print};
use crate::access_profile::summary::summary;
use crate::access_profile::{AccessRun, CacheState, Profile, SCHEMA};
use crate::signals::Signals;

#[derive(Debug, Args)]
#[command(after_help = "\
An access begins when the simulator has published an observation, and ends when the policy has the
recall that answers it. Its parts are wire (there and back), embedding, search and assembly. For an
external memory, search is what it computes, by its own clock, and wire includes the messages to it.

What is measured:
  floors      a cache line between two cores, a copy of a frame, the bandwidth of memory
  cold        accesses with one lane and empty caches: every view is rendered and embedded
  warm        the same episodes with known views; sleeping at once (blocking), and polling first
  lanes       warm, with several episodes at a time
  sizes       search alone, in memories of real embeddings and seeded neighbours of them

The policy is `random`, the processes are those of a run, and nothing is scored. Close other
programs: with few cores each of them shows in the figures.

Writes profile.html (a page with plots), profile.json and profile.csv into --out.

Examples:
  memtransfer profile                                 about a minute on two cores
  memtransfer profile --quick                         two memories and few figures
  memtransfer profile --full                          up to 64 lanes and ten million entries
  memtransfer profile --memory episodic --lanes 1,2,4,8 --entries 1000,100000
  memtransfer profile --quick --memory-cmd 'python my_memory.py'  your own memory beside others")]
pub(super) struct ProfileArgs {
    /// Measure little, for a first impression
    #[arg(long, conflicts_with = "full")]
    quick: bool,
    /// Measure everything, up to memories that barely fit into the machine
    #[arg(long)]
    full: bool,
    /// Write into DIR; files of an earlier profile are replaced
    #[arg(long, value_name = "DIR", default_value = "profile")]
    out: PathBuf,
    /// Memory representations [default: all; with --quick working and episodic]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = representation)]
    memory: Vec<Representation>,
    /// The command that starts a memory of your own, which is measured beside the others. Can be repeated
    #[arg(long, value_name = "COMMAND")]
    memory_cmd: Vec<String>,
    /// The command that starts a world of your own, in which accesses are measured; nothing is rendered beforehand there
    #[arg(long, value_name = "COMMAND", env = "MEMTRANSFER_WORLD_CMD")]
    world_cmd: Option<String>,
    /// Numbers of lanes to measure beside one
    #[arg(long, value_name = "LIST", value_delimiter = ',',
          value_parser = clap::value_parser!(u32).range(1..=1024))]
    lanes: Vec<u32>,
    /// Microseconds for which a polling process polls before it sleeps
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(1..))]
    spin_us: u32,
    /// Sizes of memory for search alone
    #[arg(long, value_name = "LIST", value_delimiter = ',',
          value_parser = clap::value_parser!(u32).range(1..))]
    entries: Vec<u32>,
    /// The model that embeds frames, by its name in models.toml
    #[arg(long, value_name = "NAME")]
    encoder: Option<String>,
    /// Show no progress
    #[arg(long)]
    quiet: bool,
}

/// How much is measured.
struct Extent {
    memory: Vec<Representation>,
    floors: floors::Effort,
    cases: u32,
    /// Steps of an episode.
    steps: u32,
    /// Repetitions of a case with warm caches.
    repetitions: u32,
    lanes: Vec<u32>,
    /// Sizes of memory for search alone.
    entries: Vec<u32>,
    /// Seconds of one measurement of search.
    seconds: f64,
}

impl ProfileArgs {
    fn extent(&self) -> Extent {
        let floors = floors::Effort::FULL;
        let mut extent = match (self.quick, self.full) {
            (true, _) => Extent {
                memory: vec![Representation::Working, Representation::Episodic],
                floors: floors::Effort { bytes: floors.bytes / 4, passes: 1, ..floors },
                cases: 1,
                steps: 12,
                repetitions: 8,
                lanes: Vec::new(),
                entries: vec![1000],
                seconds: 0.2,
            },
            (false, false) => Extent {
                memory: Representation::ALL.to_vec(),
                floors,
                cases: 4,
                steps: 24,
                repetitions: 20,
                lanes: vec![4, 16],
                entries: vec![1, 10, 100, 1000, 10_000, 100_000, 1_000_000],
                seconds: 0.5,
            },
            (false, true) => Extent {
                memory: Representation::ALL.to_vec(),
                floors,
                cases: 8,
                steps: 24,
                repetitions: 40,
                lanes: vec![2, 4, 8, 16, 32, 64],
                entries: (0..=7).map(|power| 10_u32.pow(power)).collect(),
                seconds: 2.0,
            },
        };
        if !self.memory.is_empty() {
            extent.memory.clone_from(&self.memory);
        }
        if !self.lanes.is_empty() {
            extent.lanes = self.lanes.iter().copied().filter(|lanes| *lanes > 1).collect();
        }
        if !self.entries.is_empty() {
            extent.entries.clone_from(&self.entries);
        }
        extent
    }

    fn progress(&self, what: impl std::fmt::Display) {
        if !self.quiet {
            say!("profile: {what}");
        }
    }
}

pub(super) fn run(args: &ProfileArgs) -> Result<Exit> {
    let extent = args.extent();
    let signals = Signals::listen().context("cannot listen to signals")?;
    let unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let scratch = Scratch::make()?;
    let profiler = Profiler { args, extent: &extent, scratch, signals };
    args.progress("the machine's floors");
    let mut profile = Profile {
        schema: SCHEMA,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: COMMIT.map(str::to_owned),
        unix_s,
        machine: Machine::here(),
        floors: floors::measure(extent.floors).context("cannot start a thread")?,
        encoder: profiler.settings(RunWay::COLD, &args.out)?.encoder,
        runs: Vec::new(),
        searches: Vec::new(),
        problems: Vec::new(),
    };
    for way in ways(args, &extent) {
        let measured = profiler.measure(way)?;
        if let Some(signal) = profiler.signals.received() {
            return Ok(Exit::Signal(signal));
        }
        let Some((run, problems)) = measured else { continue };
        profile.problems.extend(problems);
        if !way.is_warm_up {
            profile.runs.push(run);
            profile.write(&args.out)?;
        }
    }
    for &entries in &extent.entries {
        if let Some(signal) = profiler.signals.received() {
            return Ok(Exit::Signal(signal));
        }
        args.progress(format_args!("search among {entries}"));
        match search::measure(entries, extent.seconds) {
            Ok(searches) => profile.searches.extend(searches),
            Err(error) => {
                profile.problems.push(format!("search among {entries}: {error:#}"));
            }
        }
    }
    let page = profile.write(&args.out)?;
    print(&format!("{}\n{}", summary(&profile), page.display()))?;
    Ok(if profile.problems.is_empty() { Exit::Complete } else { Exit::Failed })
}

/// The way in which episodes run.
#[derive(Debug, Clone, Copy)]
struct RunWay {
    caches: CacheState,
    lanes: u32,
    spin_us: u32,
    /// Whether the episodes only fill the caches for those that follow.
    is_warm_up: bool,
}

impl RunWay {
    const COLD: Self = Self { caches: CacheState::Cold, lanes: 1, spin_us: 0, is_warm_up: false };
}

/// All ways, in order.
fn ways(args: &ProfileArgs, extent: &Extent) -> Vec<RunWay> {
    let warm = RunWay { caches: CacheState::Warm, ..RunWay::COLD };
    let mut ways = vec![RunWay::COLD, RunWay { is_warm_up: true, lanes: 8, ..warm }, warm];
    ways.push(RunWay { spin_us: args.spin_us, ..warm });
    ways.extend(extent.lanes.iter().map(|&lanes| RunWay { lanes, ..warm }));
    ways
}

/// Runs episodes and records their accesses.
struct Profiler<'a> {
    args: &'a ProfileArgs,
    extent: &'a Extent,
    scratch: Scratch,
    signals: Signals,
}

impl Profiler<'_> {
    /// The settings of a run in the folder `out`.
    fn settings(&self, way: RunWay, out: &Path) -> Result<RunSettings> {
        let Self { args, extent, .. } = self;
        let repetitions = if way.caches == CacheState::Cold { 1 } else { extent.repetitions };
        let names: Vec<&str> = extent.memory.iter().map(|memory| memory.name()).collect();
        let (memory, out) = (names.join(","), out.display().to_string());
        let numbers = [extent.cases, repetitions, extent.steps, way.lanes, way.spin_us];
        let [cases, runs, steps, lanes, spin_us] = numbers.map(|number| number.to_string());
        let mut flags = vec![
            ("policy", "random"),
            ("memory", &*memory),
            ("starts", "new"),
            ("limit", &*cases),
            ("runs", &*runs),
            ("max-steps", &*steps),
            ("documents", "extractive"),
            ("out", &*out),
            ("lanes", &*lanes),
            ("spin-us", &*spin_us),
        ];
        let world_cmd = args.world_cmd.as_deref().filter(|command| !command.is_empty());
        match world_cmd {
            Some(command) => flags.push(("world-cmd", command)),
            None if way.caches == CacheState::Warm => flags.push(("warm-views", "true")),
            None => {}
        }
        let variable = variable("encoder")?;
        let encoder = args.encoder.as_deref().or(variable.as_ref().and_then(|v| v.as_str()));
        flags.extend(encoder.map(|encoder| ("encoder", encoder)));
        flags.extend(args.memory_cmd.iter().map(|command| ("memory-cmd", command.as_str())));
        Ok(resolve([Layer::flags(flags)?])?.settings)
    }

    /// Runs episodes; `None` when a signal asked to stop. Returns what was measured, and problems.
    fn measure(&self, way: RunWay) -> Result<Option<(AccessRun, Vec<String>)>> {
        let Self { args, scratch, signals, .. } = self;
        // Of this way alone: a folder in which a run has begun is refused to another.
        let folder = ScratchFolder::new().context("cannot make a temporary folder")?;
        let settings = self.settings(way, &folder.path().join("run"))?;
        ensure!(
            settings.stream.is_none(),
            "`memtransfer profile` measures single episodes: choose a suite without streams, such as quick"
        );
        let invocation = Invocation {
            fresh: true,
            verbosity: Verbosity::of_quiet(args.quiet),
            adjust: Box::new(|_, _, pipeline| {
                let launches = pipeline.launches.iter_mut();
                for memory in launches.filter(|launch| launch.role == Role::Memory) {
                    memory.env.push(("MEMTRANSFER_CACHE".into(), scratch.cache().into()));
                }
                Ok(())
            }),
            ..Invocation::until(signals.stop())
        };
        let plan = RunPlan::new(settings, &Selected::All, Purpose::Execution, &invocation)?;
        let Some(plan) = plan else { return Ok(None) };
        let mut run = AccessRun {
            caches: way.caches,
            lanes: way.lanes,
            spin_us: way.spin_us,
            episodes: 0,
            steps: 0,
            seconds: 0.0,
            latencies: Vec::new(),
        };
        let purpose = if way.is_warm_up { " (to fill the caches)" } else { "" };
        args.progress(format_args!("{}: {} episodes{purpose}", run.name(), plan.episodes.len()));
        let mut recorder = AccessRecorder::default();
        let RunOutcome::Ended(ending) = observe(plan, &invocation, &mut recorder)? else {
            return Ok(None);
        };
        if ending.interrupted {
            return Ok(None);
        }
        let name = run.name();
        let mut problems = std::mem::take(&mut recorder.problems);
        problems.extend(ending.unfinished.into_iter().map(|(_, why)| why));
        if recorder.unordered > 0 {
            problems.push(format!("{} steps with stamps out of order", recorder.unordered));
        }
        problems.iter_mut().for_each(|problem| problem.insert_str(0, &format!("{name}: ")));
        (run.episodes, run.steps) = (recorder.episodes, recorder.steps);
        (run.seconds, run.latencies) = (recorder.seconds(), recorder.latencies());
        Ok(Some((run, problems)))
    }
}

/// A temporary folder with an empty cache folder.
#[derive(Debug)]
struct Scratch {
    folder: ScratchFolder,
}

impl Scratch {
    fn make() -> Result<Self> {
        let folder = ScratchFolder::new().context("cannot make a temporary folder")?;
        let scratch = Self { folder };
        let cache = scratch.cache();
        fs::create_dir_all(&cache).with_context(|| format!("cannot make {}", cache.display()))?;
        // Files from set-up are used; cached embeddings are not.
        let shared = std::path::absolute(cache_folder()?)?;
        for part in ["models", "onnxruntime"] {
            let link = cache.join(part);
            std::os::unix::fs::symlink(shared.join(part), &link)
                .with_context(|| format!("cannot link {}", link.display()))?;
        }
        Ok(scratch)
    }

    fn cache(&self) -> PathBuf {
        self.folder.path().join("cache")
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        args: ProfileArgs,
    }

    #[test]
    fn a_quick_profile_measures_little() {
        let extent = |arguments: &[&str]| {
            let arguments = ["profile"].iter().chain(arguments);
            let args = Cli::parse_from(arguments).args;
            let extent = args.extent();
            let steps = |way: &RunWay| {
                let repetitions =
                    if way.caches == CacheState::Cold { 1 } else { extent.repetitions };
                extent.cases * repetitions * extent.steps * extent.memory.len() as u32
            };
            let steps: u32 = ways(&args, &extent).iter().map(steps).sum();
            (steps, extent.entries.iter().sum::<u32>())
        };
        let (quick, usual) = (extent(&["--quick"]), extent(&[]));
        assert!(quick.0 < 1000 && quick.0 * 40 < usual.0, "{quick:?} of {usual:?}");
        assert!(quick.1 <= 1000, "{quick:?}");
        // What is asked for is measured.
        assert_eq!(extent(&["--quick", "--entries", "5000"]).1, 5000);
    }
}
