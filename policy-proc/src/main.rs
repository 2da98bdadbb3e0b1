//! The policy process: one of the built-in policies, put on the wire; or a pipe to a model, and what there is to
//! say about the model's server and about its replies that are kept.

mod cli;

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, Parser, Subcommand, ValueEnum};
use policy_proc::chat::{Client, Endpoint, ResponseCache, Settings, pipe};
use policy_proc::grounded::Grounded;
use policy_proc::random::Random;
use policy_proc::{Decider, serve};
use shm_types::ATTACH_VARIABLE;
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
        /// The run's folder, which holds attach.json
        #[arg(long, value_name = "DIR", env = ATTACH_VARIABLE)]
        attach: PathBuf,
        /// Who decides.
        #[arg(long)]
        policy: BuiltIn,
        #[command(flatten)]
        model: cli::openai::ModelArguments,
    },
    /// Ask a model behind an OpenAI-compatible endpoint: a line of JSON in, a line of JSON out.
    #[command(after_help = ASK_HELP)]
    Ask(AskArguments),
    /// Find out what a model's server can do, and who it is
    Probe(cli::probe::ProbeArguments),
    /// List or remove the replies of models that are kept on disk
    Cache(cli::cache::CacheArguments),
}

#[derive(Args)]
struct AskArguments {
    /// Where the server is, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME")]
    model: String,
    /// Longest that one attempt may take, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "300", value_parser = clap::value_parser!(u32).range(1..))]
    timeout: u32,
    /// How often a request is sent again that met status 429 or 5xx, no answer in time or no connection
    #[arg(long, value_name = "N", default_value = "5")]
    max_retries: u32,
    /// Look for replies there before asking, and keep them: on (responses in the cache folder), off, or a folder
    #[arg(long, value_name = "on|off|DIR", default_value = "off")]
    response_cache: String,
    /// End with this process, which started this one
    #[arg(long, value_name = "PID", hide = true)]
    parent: Option<u32>,
}

const ASK_HELP: &str = r#"Variables that are not set are looked for in the file .env of the working folder:
  OPENAI_BASE_URL   where the server is, for example http://localhost:8000/v1
  OPENAI_API_KEY    the key, where the server wants one; it is never printed

A question, one line on stdin:
  {"messages": [{"role": "user", "content": "Where is north?"}], "max_tokens": 30}
Its answer, one line on stdout; a count that the server does not give is null:
  {"text": "Up.", "outcome": "text", "model": "m", "prompt_tokens": 12, "completion_tokens": 2,
   "from_cache": false}
  outcome: text (whole), length (cut off at max_tokens), empty or refusal
Or, when there is no reply:
  {"error": "what happened, and what to do"}

The temperature is 0 and reasoning is off. Ends with stdin: with status 0, or 2 when a question got no reply.

Example:
  echo '{"messages": [{"role": "user", "content": "Hello"}], "max_tokens": 30}' |
      policy-proc ask --base-url http://localhost:8000/v1 --model my-model"#;

#[derive(Clone, Copy, ValueEnum)]
enum BuiltIn {
    /// Draws an action from the episode's seed and the step.
    Random,
    /// A scripted stand-in for a model: reads label plates, follows what memory offers, explores.
    Grounded,
    /// A vision-language model behind an OpenAI-compatible endpoint.
    Openai,
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(std::io::stderr)
        .init();
    let done = match Arguments::parse().verb {
        Verb::Serve { attach, policy, model } => {
            take_part(&attach, policy, model).map(|()| ExitCode::SUCCESS)
        }
        Verb::Ask(arguments) => ask(arguments).map(|()| ExitCode::SUCCESS),
        Verb::Probe(arguments) => cli::probe::run(&arguments),
        Verb::Cache(arguments) => cli::cache::run(&arguments).map(|()| ExitCode::SUCCESS),
    };
    match done {
        Ok(code) => code,
        Err(error) => {
            eprintln!("policy-proc: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn take_part(
    attach_dir: &Path,
    policy: BuiltIn,
    model: cli::openai::ModelArguments,
) -> anyhow::Result<()> {
    let mut policy: Box<dyn Decider> = match policy {
        BuiltIn::Random => Box::new(Random),
        BuiltIn::Grounded => Box::new(Grounded::default()),
        BuiltIn::Openai => Box::new(cli::openai::policy(model)?),
    };
    serve(policy.as_mut(), attach_dir).context("the policy process cannot go on")
}

fn ask(arguments: AskArguments) -> anyhow::Result<()> {
    let AskArguments { base_url, model, timeout, max_retries, response_cache, parent } = arguments;
    if let Some(parent) = parent {
        die_with_parent(parent).context("cannot answer another process")?;
    }
    let endpoint = Endpoint::from_environment(base_url.as_deref(), Path::new("."))?;
    let timeout = Duration::from_secs(timeout.into());
    let client = Client::new(endpoint, Settings { model, timeout, max_retries });
    let cache = ResponseCache::from_setting(&response_cache)?;
    match pipe::run(&client, cache.as_ref(), io::stdin().lock(), io::stdout().lock())? {
        0 => Ok(()),
        failed => bail!("questions without a reply: {failed}; their lines say why"),
    }
}
