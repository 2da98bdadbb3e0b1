//! The command line: the verbs, and one exit point.
//!
//! Data goes to stdout, progress and messages go to stderr. The exit status is 0 when everything is complete, 1 when
//! something is incomplete or failed, 2 on an error, 3 when units of a plan are missing, 4 when a gate is not passed, and 128 + n when
//! signal n ended the program.

/// Prints a message to stderr, as [`orchestrator::progress::say`] does.
macro_rules! say {
    ($($text:tt)*) => { orchestrator::progress::say(&format!($($text)*)) };
}

mod access_profile;
mod cache;
mod clean;
mod commands;
mod conformance;
mod demo;
mod doctor;
mod document_estimate;
mod estimate;
mod execution;
mod export;
mod generate;
mod list;
mod map;
mod memory;
mod merge;
mod parent;
mod plan;
mod profile;
mod render;
mod report;
mod run;
mod score;
mod show;
mod signals;
mod top;
mod validate;
mod view;
mod work;

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use ::report::table::{WIDTH, wrap};
use anyhow::{Context, bail};
use clap::{Args, Parser, Subcommand};
use program::in_one_line;
use supervise::{QUIET_DRIVER, sibling};
use world_client::WorldProgram;

/// A benchmark of embodied memory: a hundred navigation cases in a rendered warehouse, run by four
/// processes over shared memory.
#[derive(Debug, Parser)]
#[command(name = "memtransfer", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    verb: MemtransferVerb,
}

const EXAMPLES: &str = "\
Examples:
  memtransfer demo                         two minutes to the first tables
  memtransfer run                          the suite `quick`; the same command again resumes it
  memtransfer run --limit 5 --policy random
  memtransfer score runs/quick-grounded    its table again, from the log alone
  memtransfer report runs/quick-grounded   its report: pages, tables and data files
  memtransfer view runs/quick-grounded     its episodes step by step, in a browser
  memtransfer export runs/quick-grounded --format parquet --out tables
  memtransfer ls cases                     the cases
  memtransfer map t03-07 --out map.svg     one case from above
  memtransfer top                          the live status of the run in progress
  memtransfer plan --out plan.json         units of the run for `work` and `merge` on many machines
  memtransfer profile                      measure how long an access to memory takes
  memtransfer doctor                       check what is missing on this machine

Exit status: 0 complete, 1 incomplete or failed, 2 error, 3 units missing, 4 a gate not passed,
128 + n ended by signal n.
Every setting of `run` can be given as a MEMTRANSFER_* variable, most also as a key of a suite
file.";

#[derive(Debug, Subcommand)]
enum MemtransferVerb {
    /// Try it: the suite `quick` with a scripted policy, its tables and what to do next
    Demo(demo::DemoArgs),
    /// Run a suite: start the processes, run the episodes, print the table
    Run(Box<run::RunArgs>),
    /// Divide a run into units for several machines
    Plan(Box<plan::PlanArgs>),
    /// Execute one unit of a plan
    Work(Box<work::WorkArgs>),
    /// Join finished units into one run folder
    Merge(merge::MergeArgs),
    /// Show the live status of a run: rates, queues, lanes, frames, latencies
    Top(top::TopArgs),
    /// List cases, histories, tasks, items, suites, conditions, streams or runs
    Ls(list::ListArgs),
    /// Check every constraint on warehouse and cases, or the log of a run
    Validate(validate::ValidateArgs),
    /// Draw the warehouse, or a case, from above as SVG
    Map(map::MapArgs),
    /// Render views of an agent as PNG
    Render(render::RenderArgs),
    /// Build, list and show the documents of summary, semantic and hybrid memory
    Memory(memory::MemoryArgs),
    /// Print a run's tables from its log, or compare conditions and runs
    Score(score::ScoreArgs),
    /// Write a report of one run or several: the paper's tables, figures and data files
    Report(report::ReportArgs),
    /// Show a run in a browser: every episode step by step, two side by side
    View(view::ViewArgs),
    /// Write a run for other programs: MCAP, MP4, CSV, Parquet, Hugging Face
    Export(export::ExportArgs),
    /// Print one step: what the policy received, and what it answered
    Show(show::ShowArgs),
    /// Measure how long an access to memory takes, part by part
    Profile(profile::ProfileArgs),
    /// Test your own policy, memory or world, and report what it does wrong
    Conformance(conformance::ConformanceArgs),
    /// Remove what killed runs left in shared memory and temporary folders
    Clean(clean::CleanArgs),
    /// List or remove the cached replies of models
    Cache(cache::CacheArgs),
    /// Generate a case file, or a warehouse with its cases, from a seed
    Generate(generate::GenerateArgs),
    /// Check what a run needs on this machine, and say how to get what is missing
    Doctor(doctor::DoctorArgs),
}

/// Writes a file that a user has named, and makes its folder.
fn write_file(path: &Path, text: &str) -> anyhow::Result<()> {
    make_folder_of(path)?;
    durable::output::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// Makes the folder of the file `path`, if it is missing.
fn make_folder_of(path: &Path) -> anyhow::Result<()> {
    let Some(folder) = path.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
}

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Exit {
    /// Everything is complete.
    Complete,
    /// It ended with missing episodes or violated constraints.
    Failed,
    /// The verb failed with an error.
    Error,
    /// Units of a plan are missing.
    UnitsMissing,
    /// A gate on a run's figures is failed or undecided.
    NotPassed,
    /// A signal ended it.
    Signal(u8),
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(match exit {
            Exit::Complete => 0,
            Exit::Failed => 1,
            Exit::Error => 2,
            Exit::UnitsMissing => 3,
            Exit::NotPassed => 4,
            Exit::Signal(signal) => 128_u8.saturating_add(signal),
        })
    }
}

/// The whole program: reads the command line, runs the verb, returns how it ended.
fn main() -> ExitCode {
    program::log_to_stderr();
    let outcome = match program::parse::<Cli>().verb {
        MemtransferVerb::Demo(args) => demo::run(args),
        MemtransferVerb::Run(args) => run::run(*args),
        MemtransferVerb::Plan(args) => plan::run(*args),
        MemtransferVerb::Work(args) => work::run(*args),
        MemtransferVerb::Merge(args) => merge::run(&args),
        MemtransferVerb::Top(args) => top::run(&args),
        MemtransferVerb::Ls(args) => list::run(&args),
        MemtransferVerb::Validate(args) => validate::run(&args),
        MemtransferVerb::Map(args) => map::run(&args),
        MemtransferVerb::Render(args) => render::run(&args),
        MemtransferVerb::Memory(args) => memory::run(args),
        MemtransferVerb::Score(args) => score::run(&args),
        MemtransferVerb::Report(args) => report::run(&args),
        MemtransferVerb::View(args) => view::run(&args),
        MemtransferVerb::Export(args) => export::run(&args),
        MemtransferVerb::Show(args) => show::run(&args),
        MemtransferVerb::Profile(args) => profile::run(&args),
        MemtransferVerb::Conformance(args) => conformance::run(&args),
        MemtransferVerb::Clean(args) => clean::run(&args),
        MemtransferVerb::Cache(args) => cache::run(&args),
        MemtransferVerb::Generate(args) => generate::run(&args),
        MemtransferVerb::Doctor(args) => doctor::run(&args),
    };
    match outcome {
        Ok(exit) => exit.into(),
        // `memtransfer ls cases | head` is not an error.
        Err(error) if program::is_closed_pipe(&error) => Exit::Complete.into(),
        Err(error) => {
            say!("memtransfer: {}", program::with_advice(&in_one_line(&error)));
            Exit::Error.into()
        }
    }
}

/// Prints a text to stdout, with a line end, and without characters that steer a terminal.
fn print(text: &str) -> anyhow::Result<()> {
    let mut text = program::printable(text);
    if !text.ends_with('\n') {
        text.push('\n');
    }
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    written.context("cannot write to standard output")
}

/// Prints a value to stdout as JSON.
fn print_json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    print(&serde_json::to_string_pretty(value)?)
}

/// Most damaged lines that a verb names; it only counts the others.
const NAMED_DAMAGES: usize = 20;

/// Names the `damaged` lines of a run, whose content is missing in what a verb prints or writes.
fn warn_of_damage(damaged: impl IntoIterator<Item: Display>) {
    let mut damaged = damaged.into_iter();
    for line in damaged.by_ref().take(NAMED_DAMAGES) {
        let text = format!("warning: damaged, left out: {line}");
        say!("{}", wrap(&text, WIDTH).join("\n"));
    }
    let more = damaged.count();
    if more > 0 {
        say!("warning: damaged, left out: {more} more lines");
    }
}

/// How a world of the user's is started.
#[derive(Debug, Default, Clone, Args)]
struct WorldCommandArgs {
    /// The command that starts a world of your own, as in `memtransfer run`
    #[arg(long, value_name = "COMMAND", env = "MEMTRANSFER_WORLD_CMD", global = true)]
    world_cmd: Option<String>,
}

impl WorldCommandArgs {
    /// The command. An empty variable is none.
    fn command(&self) -> Option<&str> {
        self.world_cmd.as_deref().filter(|command| !command.is_empty())
    }

    /// The program that knows the warehouse, and how to start the other world.
    fn program(&self) -> anyhow::Result<WorldProgram> {
        let world_cmd = self.command().map(str::to_owned);
        let (path, arguments) = (sibling("sim-proc")?, Vec::new());
        Ok(WorldProgram { path, arguments, world_cmd, variable: QUIET_DRIVER })
    }
}

/// The world that a verb uses.
#[derive(Debug, Default, Args)]
struct WorldArgs {
    /// Use the layout, catalogue and cases in DIR instead of the built-in ones
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS", global = true)]
    assets: Option<PathBuf>,
    #[command(flatten)]
    other: WorldCommandArgs,
}

impl WorldArgs {
    /// The program of the other world, if one is named; otherwise that of the warehouse.
    fn program(&self) -> anyhow::Result<WorldProgram> {
        let program = self.other.program()?;
        let Some(other) = program.other_world()? else { return Ok(program) };
        if self.assets.is_some() {
            bail!(
                "--assets are those of the warehouse, and --world-cmd names another world: leave one of them out"
            );
        }
        Ok(other)
    }

    /// The program of the warehouse, for a verb that other worlds do not have.
    fn warehouse(&self) -> anyhow::Result<WorldProgram> {
        let program = self.other.program()?;
        match &program.world_cmd {
            None => Ok(program),
            Some(_) => bail!(
                "this is about the warehouse, and --world-cmd (or MEMTRANSFER_WORLD_CMD) names another world: leave it out"
            ),
        }
    }

    /// The flags for the program that knows the world.
    fn flags(&self) -> Vec<OsString> {
        let assets = self.assets.iter();
        assets.flat_map(|dir| [OsString::from("--assets"), dir.into()]).collect()
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_well_formed_and_explains_itself() {
        let mut command = Cli::command().term_width(100);
        command.clone().debug_assert();
        insta::assert_snapshot!("help", command.render_long_help());
        command.build();
        let mut run = command.find_subcommand_mut("run").unwrap().clone().term_width(100);
        insta::assert_snapshot!("help-run", run.render_help());
    }

    #[test]
    fn every_help_fits_a_hundred_columns_and_teaches_by_example() {
        let mut command = Cli::command().term_width(100);
        command.build();
        for verb in command.get_subcommands_mut() {
            let name = verb.get_name().to_owned();
            if ["help", "cache"].contains(&name.as_str()) {
                continue;
            }
            let help = verb.clone().term_width(100).render_long_help().to_string();
            assert!(help.contains("memtransfer "), "{name} shows no example");
            // Longer lines would be broken in the middle of a sentence or of an example.
            let after = verb.get_after_help().map(ToString::to_string).unwrap_or_default();
            for text in [help, after] {
                assert!(text.lines().all(|line| line.chars().count() <= 100), "{name}: {text}");
            }
        }
    }

    #[test]
    fn exit_codes_are_what_scripts_rely_on() {
        for (exit, code) in [
            (Exit::Complete, 0),
            (Exit::Failed, 1),
            (Exit::Error, 2),
            (Exit::UnitsMissing, 3),
            (Exit::NotPassed, 4),
            (Exit::Signal(2), 130),
            (Exit::Signal(15), 143),
        ] {
            assert_eq!(ExitCode::from(exit), ExitCode::from(code));
        }
    }
}
