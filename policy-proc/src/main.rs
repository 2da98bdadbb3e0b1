//! The policy process: one of the built-in policies, put on the wire.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand, ValueEnum};
use policy_proc::grounded::Grounded;
use policy_proc::random::Random;
use policy_proc::{Policy, serve};
use shm_types::Attach;
use shm_types::process::die_with_parent;
use tracing_subscriber::EnvFilter;

/// Decides what the agents do. Started by `memtransfer run`.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Take part in a run until it stops.
    Serve {
        /// The run's folder, which holds attach.json.
        #[arg(long, value_name = "DIR")]
        attach: PathBuf,
        /// Who decides.
        #[arg(long)]
        policy: BuiltIn,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum BuiltIn {
    /// Draws an action from the episode's seed and the step.
    Random,
    /// A scripted stand-in for a model: reads label plates, follows what memory offers, explores.
    Grounded,
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(std::io::stderr)
        .init();
    let Verb::Serve { attach, policy } = Arguments::parse().verb;
    match take_part(&attach, policy) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("policy-proc: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn take_part(attach_dir: &Path, policy: BuiltIn) -> anyhow::Result<()> {
    let run = Attach::read(attach_dir).context("cannot take part in the run")?;
    die_with_parent(run.orchestrator_pid).context("this process belongs to an orchestrator")?;
    let mut policy: Box<dyn Policy> = match policy {
        BuiltIn::Random => Box::new(Random),
        BuiltIn::Grounded => Box::new(Grounded::default()),
    };
    serve(policy.as_mut(), attach_dir).context("the policy process cannot go on")
}
