//! What people type: the verbs, and one exit point.
//!
//! stdout carries data, stderr progress and messages. The exit status is 0 when everything is complete, 1
//! when something finished with failures, 2 when it could not be done, 128 + n when signal n ended it.

mod cache;
mod clean;
mod conformance;
mod doctor;
mod documents;
mod generate;
mod list;
mod map;
mod memory;
mod profile;
mod render;
mod report;
mod run;
mod score;
mod show;
mod top;
mod validate;

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::world::World;

/// A benchmark of embodied memory: a hundred navigation cases in a rendered warehouse, walked by four
/// processes over shared memory.
#[derive(Debug, Parser)]
#[command(name = "memtransfer", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

const EXAMPLES: &str = "\
Examples:
  memtransfer run                          the main job; the same command again resumes it
  memtransfer run --limit 5 --policy random
  memtransfer score runs/quick-grounded    its table once more, from the log alone
  memtransfer report runs/quick-grounded   pages, tables and data files of it
  memtransfer ls cases                     what there is to walk
  memtransfer map t03-07 --out map.svg     one case from above
  memtransfer top                          what the run that is going on is at
  memtransfer profile                      how long an access to memory takes
  memtransfer doctor                       what is missing on this machine

Exit status: 0 complete, 1 finished with failures, 2 could not run, 128 + n ended by signal n.
Every flag of `run` can be given as a MEMTRANSFER_* variable, or as a key of a suite file.";

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run a suite: start the processes, walk the episodes, print the table
    Run(Box<run::RunArgs>),
    /// Show what a running run is at: rates, queues, lanes, the frame store, latencies
    Top(top::TopArgs),
    /// List cases, tasks, items, suites or runs
    Ls(list::ListArgs),
    /// Check every constraint on warehouse and cases by replay
    Validate(validate::ValidateArgs),
    /// Draw a case, or the warehouse, from above as SVG
    Map(map::MapArgs),
    /// Render what an agent sees as PNG
    Render(render::RenderArgs),
    /// Build, list and show the documents that summary, semantic and hybrid memory supply
    Memory(memory::MemoryArgs),
    /// Print a run's tables once more, from its log alone, or compare conditions and runs
    Score(score::ScoreArgs),
    /// Write a run's pages: the paper's tables, figures and data files, from its log alone
    Report(report::ReportArgs),
    /// Print what the policy was given at a step, and what it answered
    Show(show::ShowArgs),
    /// Measure how long an access to memory takes, taken apart
    Profile(profile::ProfileArgs),
    /// Play hard situations to a policy of your own, and say what it does wrong
    Conformance(conformance::ConformanceArgs),
    /// Remove what killed runs left in shared memory and temporary folders
    Clean(clean::CleanArgs),
    /// List or remove the replies of models that are kept on disk
    Cache(cache::CacheArgs),
    /// Make a case file from a seed
    Generate(generate::GenerateArgs),
    /// Check what a run needs on this machine, and say what to do about what is missing
    Doctor(doctor::DoctorArgs),
}

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Everything is complete.
    Complete,
    /// It finished, with failed episodes or violated constraints.
    Failed,
    /// It could not be done.
    CouldNot,
    /// A signal ended it.
    Signal(u8),
    /// As a program ended that did the work.
    Code(u8),
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(match exit {
            Exit::Complete => 0,
            Exit::Failed => 1,
            Exit::CouldNot => 2,
            Exit::Signal(signal) => 128_u8.saturating_add(signal),
            Exit::Code(code) => code,
        })
    }
}

/// The whole program: reads the command line, does what the verb says, tells how it ended.
pub fn main() -> ExitCode {
    program::log_to_stderr();
    let matches = Cli::command().get_matches();
    let verb = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli.verb,
        Err(error) => error.exit(),
    };
    let done = match verb {
        Verb::Run(args) => {
            // Which flags were typed and which are variables is known here only.
            let matches = matches.subcommand_matches("run").unwrap_or(&matches);
            run::run(*args, matches)
        }
        Verb::Top(args) => top::run(&args),
        Verb::Ls(args) => list::run(&args),
        Verb::Validate(args) => validate::run(&args),
        Verb::Map(args) => map::run(&args),
        Verb::Render(args) => render::run(&args),
        Verb::Memory(args) => memory::run(args),
        Verb::Score(args) => score::run(&args),
        Verb::Report(args) => report::run(&args),
        Verb::Show(args) => show::run(&args),
        Verb::Profile(args) => profile::run(&args),
        Verb::Conformance(args) => conformance::run(&args),
        Verb::Clean(args) => clean::run(&args),
        Verb::Cache(args) => cache::run(&args),
        Verb::Generate(args) => generate::run(&args),
        Verb::Doctor(args) => doctor::run(&args),
    };
    match done {
        Ok(exit) => exit.into(),
        // `memtransfer ls cases | head` is no failure of anything.
        Err(error) if is_closed_pipe(&error) => Exit::Complete.into(),
        Err(error) => {
            eprintln!("memtransfer: {}", said_once(&error));
            Exit::CouldNot.into()
        }
    }
}

/// An error and its causes in one line, without what an error already says about its own cause.
fn said_once(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |said, cause| match cause.to_string() {
        cause if said.is_empty() => cause,
        cause if said.contains(&cause) => said,
        cause => format!("{said}: {cause}"),
    })
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let io_error = error.downcast_ref::<io::Error>();
    io_error.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// Writes data to stdout, line end included.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        stdout.write_all(b"\n")?;
    }
    stdout.flush()?;
    Ok(())
}

/// Writes a value to stdout as JSON.
fn print_json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    print(&serde_json::to_string_pretty(value)?)
}

/// Which world a verb is about.
#[derive(Debug, Args)]
struct WorldArgs {
    /// Use the layout, catalogue and cases in DIR instead of the built-in ones
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS")]
    assets: Option<PathBuf>,
}

impl WorldArgs {
    fn load(&self) -> anyhow::Result<World> {
        Ok(World::load(self.assets.as_deref())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed_and_explains_itself() {
        let mut command = Cli::command().term_width(100);
        command.clone().debug_assert();
        insta::assert_snapshot!("help", command.render_long_help());
        command.build();
        let run = command.find_subcommand_mut("run").unwrap().clone().term_width(100);
        // What this machine's environment says is not part of the help.
        insta::assert_snapshot!("help-run", run.hide_env_values().render_help());
    }

    trait HideEnvironment {
        fn hide_env_values(self) -> Self;
        fn render_help(self) -> String;
    }

    impl HideEnvironment for clap::Command {
        fn hide_env_values(self) -> Self {
            self.mut_args(|arg| arg.hide_env(true))
        }
        fn render_help(mut self) -> String {
            clap::Command::render_help(&mut self).to_string()
        }
    }

    #[test]
    fn causes_are_said_once() {
        let missing = || io::Error::new(io::ErrorKind::NotFound, "no such file");
        let own = anyhow::Error::from(missing()).context("cannot read x: no such file");
        assert_eq!(said_once(&own), "cannot read x: no such file");
        assert_eq!(said_once(&own.context("no suite")), "no suite: cannot read x: no such file");
    }

    #[test]
    fn exit_codes_are_what_scripts_rely_on() {
        for (exit, code) in [
            (Exit::Complete, 0),
            (Exit::Failed, 1),
            (Exit::CouldNot, 2),
            (Exit::Signal(2), 130),
            (Exit::Signal(15), 143),
        ] {
            assert_eq!(ExitCode::from(exit), ExitCode::from(code));
        }
    }
}
