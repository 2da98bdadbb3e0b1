//! The policy process: one of the built-in policies on the wire, checks of a model's server, and the cached replies.

mod cli;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand, ValueEnum};
use peer::{Decider, serve};
use policy_proc::grounded::Grounded;
use policy_proc::imitate::Imitate;
use policy_proc::random::Random;
use shm_types::ATTACH_VARIABLE;

/// Decides what the agents do. Started by `memtransfer run`.
#[derive(Parser)]
#[command(version)]
struct PolicyProcArguments {
    #[command(subcommand)]
    verb: PolicyProcVerb,
}

#[derive(Subcommand)]
enum PolicyProcVerb {
    /// Take part in a run until it stops
    Serve {
        /// The run's folder, which contains attach.json
        #[arg(long, value_name = "DIR", env = ATTACH_VARIABLE)]
        attach: PathBuf,
        /// The policy
        #[arg(long)]
        policy: BuiltInPolicy,
        #[command(flatten)]
        model: Box<cli::openai::ModelArguments>,
    },
    /// Check what a model's server can do
    Probe(cli::probe::ProbeArguments),
    /// List or remove the cached replies of models
    Cache(cli::cache::CacheArguments),
}

#[derive(Clone, Copy, ValueEnum)]
enum BuiltInPolicy {
    /// Draws an action from the episode's seed and the step
    Random,
    /// A scripted stand-in for a model: reads label plates, follows the memory, explores
    Grounded,
    /// A scripted stand-in for any world: does what the expert did where memory shows it, and explores otherwise
    Imitate,
    /// A vision-language model behind an OpenAI-compatible endpoint
    Openai,
}

fn main() -> ExitCode {
    program::run("policy-proc", || match program::parse::<PolicyProcArguments>().verb {
        PolicyProcVerb::Serve { attach, policy, model } => {
            take_part(&attach, policy, *model).map(|()| ExitCode::SUCCESS)
        }
        PolicyProcVerb::Probe(arguments) => cli::probe::run(&arguments),
        PolicyProcVerb::Cache(arguments) => cli::cache::run(&arguments).map(|()| ExitCode::SUCCESS),
    })
}

fn take_part(
    attach_dir: &Path,
    policy: BuiltInPolicy,
    model: cli::openai::ModelArguments,
) -> anyhow::Result<()> {
    let mut policy: Box<dyn Decider> = match policy {
        BuiltInPolicy::Random => Box::new(Random),
        BuiltInPolicy::Grounded => Box::new(Grounded::default()),
        BuiltInPolicy::Imitate => Box::new(Imitate),
        BuiltInPolicy::Openai => Box::new(cli::openai::policy(model)?),
    };
    serve(policy.as_mut(), attach_dir).context("the policy process cannot continue")
}
