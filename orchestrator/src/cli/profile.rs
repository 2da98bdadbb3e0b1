//! `memtransfer profile`: how long an access to memory takes, taken apart, with tables, data and a page.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use clap::Args;
use domain::{Representation, cache_folder};
use shm_types::message::Role;
use shm_types::{RunDir, registry};

use super::documents::RunDocuments;
use super::run::{attach, crewing, rules};
use super::{Exit, print};
use crate::commit::commit_of;
use crate::lanes::Lanes;
use crate::machine::{Machine, floors};
use crate::pipeline;
use crate::plan::plan;
use crate::profile::recorder::Recorder;
use crate::profile::summary::summary;
use crate::profile::{Mode, Profile, SCHEMA, Walk, search};
use crate::settings::{Layer, Origin, resolve, select_cases};
use crate::signals::Signals;
use crate::world::World;
use results::conditions::{PolicyKind, Start, representation};
use results::log::RunFolder;
use results::settings::{DocumentSource, RunSettings};

/// The folder with what a profile needs while it is made.
const SCRATCH: &str = "scratch";

#[derive(Debug, Args)]
#[command(after_help = "\
An access begins when the simulator has published an observation, and is over when the policy
has the recall that answers it. It is taken apart into wire (the way there and back), embedding,
search and assembly.

What is measured:
  floors      a cache line between two cores, a memcpy of a frame, the bandwidth of memory
  cold        every representation in one lane, with nothing cached: each view is drawn and
              embedded anew
  warm        the same episodes' views known; sleeping at once (blocking), and looking for work
              first (polling)
  lanes       warm, with several episodes at once
  sizes       the search by itself, exact and approximate with its recall, in memories of real
              embeddings and seeded neighbours of them

The episodes are walked by the policy `random` through the processes that a run starts. Nothing of
it is a score. Close other programs: on two cores every one of them shows.

Writes into --out: profile.html (one page with plots), profile.json and profile.csv.

Examples:
  memtransfer profile                                 about a minute on two cores
  memtransfer profile --quick                         a short one, to see whether it works
  memtransfer profile --full                          up to 64 lanes and ten million entries
  memtransfer profile --memory episodic --lanes 1,2,4,8 --entries 1000,100000")]
pub(super) struct ProfileArgs {
    /// As little as gives an impression
    #[arg(long, conflicts_with = "full")]
    quick: bool,
    /// Everything, up to memories that hardly fit into this machine's
    #[arg(long)]
    full: bool,
    /// Where to write; files of an earlier profile there are replaced
    #[arg(long, value_name = "DIR", default_value = "profile")]
    out: PathBuf,
    /// Memory representations [default: all six]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = representation)]
    memory: Vec<Representation>,
    /// Numbers of lanes to walk with, beside one
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    lanes: Vec<u32>,
    /// Microseconds for which a polling process looks for work before it sleeps
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 200)]
    spin_us: u32,
    /// Sizes of memory to search in by itself
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    entries: Vec<u32>,
    /// The model that embeds frames, by its name in models.toml
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_ENCODER")]
    encoder: Option<String>,
    /// Say nothing of what is being done
    #[arg(long)]
    quiet: bool,
}

/// How much is measured.
struct Extent {
    floors: floors::Effort,
    cases: u32,
    /// Repetitions of a case in a warm walk.
    runs: u32,
    lanes: Vec<u32>,
    exact: Vec<u32>,
    approximate: Vec<u32>,
    /// Seconds of a measurement of search.
    seconds: f64,
}

/// Steps of an episode: most of them are later ones, and a walk does not get far from its start.
const STEPS: u32 = 24;

impl ProfileArgs {
    fn extent(&self) -> Extent {
        let effort = floors::Effort::FULL;
        let mut extent = match (self.quick, self.full) {
            (true, _) => Extent {
                floors: floors::Effort { bytes: effort.bytes / 2, passes: 1, ..effort },
                cases: 2,
                runs: 4,
                lanes: vec![8],
                exact: vec![1000, 10_000],
                approximate: vec![10_000],
                seconds: 0.3,
            },
            (false, false) => Extent {
                floors: effort,
                cases: 4,
                runs: 20,
                lanes: vec![4, 16],
                exact: vec![1, 10, 100, 1000, 10_000, 100_000, 1_000_000],
                approximate: vec![1000, 10_000, 100_000],
                seconds: 0.5,
            },
            (false, true) => Extent {
                floors: effort,
                cases: 8,
                runs: 40,
                lanes: vec![2, 4, 8, 16, 32, 64],
                exact: (0..=7).map(|power| 10_u32.pow(power)).collect(),
                approximate: vec![1000, 10_000, 100_000, 1_000_000],
                seconds: 2.0,
            },
        };
        if !self.lanes.is_empty() {
            extent.lanes = self.lanes.iter().copied().filter(|lanes| *lanes > 1).collect();
        }
        if !self.entries.is_empty() {
            (extent.exact, extent.approximate) = (self.entries.clone(), self.entries.clone());
        }
        extent
    }

    fn say(&self, what: impl std::fmt::Display) {
        if !self.quiet {
            eprintln!("profile: {what}");
        }
    }
}

pub(super) fn run(args: &ProfileArgs) -> Result<Exit> {
    ensure!(
        args.spin_us > 0,
        "--spin-us is 0, which is blocking: give the microseconds of polling"
    );
    ensure!(
        args.entries.iter().all(|entries| *entries > 0),
        "--entries has a 0: a memory of nothing is not searched"
    );
    let (extent, signals) = (args.extent(), Signals::listen().context("cannot listen to signals")?);
    let unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let world = World::load(None)?;
    let scratch = Scratch::make(&args.out)?;
    args.say("the machine's floors");
    let floors = floors::measure(extent.floors);
    let program = std::env::current_exe().ok();
    let mut profile = Profile {
        schema: SCHEMA,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: program.as_deref().and_then(Path::parent).and_then(commit_of),
        unix_s,
        machine: Machine::here(),
        floors,
        encoder: scratch.settings(args, &extent, How::COLD)?.encoder,
        walks: Vec::new(),
        searches: Vec::new(),
        problems: Vec::new(),
    };
    for how in hows(args, &extent) {
        let settings = scratch.settings(args, &extent, how)?;
        let walked = scratch.walk(&settings, &world, how, &signals, args)?;
        if let Some(signal) = signals.received() {
            return Ok(Exit::Signal(signal));
        }
        let Some((walk, problems)) = walked else { continue };
        profile.problems.extend(problems);
        if !how.unseen {
            profile.walks.push(walk);
            profile.write(&args.out)?;
        }
    }
    for (kind, sizes) in [("exact", &extent.exact), ("approximate", &extent.approximate)] {
        for &entries in sizes {
            if let Some(signal) = signals.received() {
                return Ok(Exit::Signal(signal));
            }
            args.say(format_args!("{kind} search among {entries}"));
            match search::measure(kind, entries, extent.seconds) {
                Ok(searches) => profile.searches.extend(searches),
                Err(error) => {
                    profile.problems.push(format!("{kind} search among {entries}: {error:#}"));
                }
            }
        }
    }
    let page = profile.write(&args.out)?;
    print(&format!("{}\n{}", summary(&profile), page.display()))?;
    Ok(if profile.problems.is_empty() { Exit::Complete } else { Exit::Failed })
}

/// How episodes are walked.
#[derive(Debug, Clone, Copy)]
struct How {
    mode: Mode,
    lanes: u32,
    spin_us: u32,
    /// Whether it is only there for what comes after it: views become known.
    unseen: bool,
}

impl How {
    const COLD: Self = Self { mode: Mode::Cold, lanes: 1, spin_us: 0, unseen: false };
}

/// All walks, in order.
fn hows(args: &ProfileArgs, extent: &Extent) -> Vec<How> {
    let warm = How { mode: Mode::Warm, ..How::COLD };
    let mut hows = vec![How::COLD, How { unseen: true, lanes: 8, ..warm }, warm];
    hows.push(How { spin_us: args.spin_us, ..warm });
    hows.extend(extent.lanes.iter().map(|&lanes| How { lanes, ..warm }));
    hows
}

/// What a profile needs while it is made: a cache folder of its own, in which nothing is embedded at first, and the
/// processes' logs. Gone when it is dropped.
#[derive(Debug)]
struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    fn make(out: &Path) -> Result<Self> {
        fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
        let folder = fs::canonicalize(out)?.join(SCRATCH);
        if folder.exists() {
            fs::remove_dir_all(&folder)
                .with_context(|| format!("cannot remove {}", folder.display()))?;
        }
        let scratch = Self { folder };
        let cache = scratch.cache();
        fs::create_dir_all(&cache).with_context(|| format!("cannot make {}", cache.display()))?;
        // What set-up brought is used where it lies; what is embedded is not.
        let whole = std::path::absolute(cache_folder()?)?;
        for part in ["models", "onnxruntime"] {
            let (from, to) = (whole.join(part), cache.join(part));
            std::os::unix::fs::symlink(&from, &to)
                .with_context(|| format!("cannot link {}", to.display()))?;
        }
        Ok(scratch)
    }

    fn cache(&self) -> PathBuf {
        self.folder.join("cache")
    }

    /// The settings of a walk.
    fn settings(&self, args: &ProfileArgs, extent: &Extent, how: How) -> Result<RunSettings> {
        let memory =
            if args.memory.is_empty() { Representation::ALL.to_vec() } else { args.memory.clone() };
        let layer = Layer {
            policy: Some(PolicyKind::Random),
            memory: Some(memory),
            starts: Some(vec![Start::New]),
            limit: Some(extent.cases),
            runs: Some(if how.mode == Mode::Cold { 1 } else { extent.runs }),
            max_steps: Some(STEPS),
            documents: Some(DocumentSource::Extractive),
            encoder: args.encoder.clone(),
            out: Some(self.folder.join("run")),
            lanes: Some(how.lanes),
            spin_us: Some(how.spin_us),
            warm_views: how.mode == Mode::Warm,
            ..Layer::default()
        };
        Ok(resolve([(Origin::Default, Layer::defaults()), (Origin::CommandLine, layer)])?.settings)
    }

    /// Walks episodes; `None` when a signal asked to stop. Beside what was measured, what went wrong.
    fn walk(
        &self,
        settings: &RunSettings,
        world: &World,
        how: How,
        signals: &Signals,
        args: &ProfileArgs,
    ) -> Result<Option<(Walk, Vec<String>)>> {
        let ids = world.case_ids();
        let cases = select_cases(&ids, &settings.cases, settings.limit)?;
        let episodes = plan(&settings.runs(), &cases, &ids, settings.seed);
        let mut walk = Walk {
            mode: how.mode,
            lanes: how.lanes,
            spin_us: how.spin_us,
            episodes: 0,
            steps: 0,
            seconds: 0.0,
            latencies: Vec::new(),
        };
        let purpose = if how.unseen { " (views become known)" } else { "" };
        args.say(format_args!("{}: {} episodes{purpose}", walk.name(), episodes.len()));
        let Some(supply) = RunDocuments::of(settings, true).supply(signals, args.quiet)? else {
            return Ok(None);
        };
        supply.copy_to(&RunFolder::documents_of(&settings.out))?;
        drop(supply);
        let base = registry::default_base();
        registry::clean(&base)?;
        let run = RunDir::create(&base)?;
        let attach = attach(settings, world, &episodes, &run, 1)?;
        let mut crewing = crewing(settings, self.folder.join("logs"))?;
        for launch in crewing.launches.iter_mut().filter(|launch| launch.role == Role::Memory) {
            launch.env.push(("MEMTRANSFER_CACHE".into(), self.cache().into()));
        }
        let rules = rules(settings)?;
        let mut lanes = Lanes::new(&world.warehouse, &world.cases, rules, attach.lanes as usize);
        let mut recorder = Recorder::default();
        let stop = signals.stop();
        let ending = pipeline::walk(&mut lanes, episodes, &attach, &crewing, stop, &mut recorder)?;
        if ending.interrupted {
            return Ok(None);
        }
        let of_walk = |what: String| format!("{}: {what}", walk.name());
        let mut problems: Vec<String> = recorder.troubles.iter().cloned().map(of_walk).collect();
        problems.extend(ending.unfinished.into_iter().map(|(_, why)| of_walk(why)));
        if recorder.senseless > 0 {
            problems
                .push(of_walk(format!("{} steps with stamps out of order", recorder.senseless)));
        }
        (walk.episodes, walk.steps) = (recorder.episodes, recorder.steps);
        (walk.seconds, walk.latencies) = (recorder.seconds(), recorder.latencies());
        Ok(Some((walk, problems)))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.folder) {
            tracing::warn!(%error, "{} could not be removed", self.folder.display());
        }
    }
}
