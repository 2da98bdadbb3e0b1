//! `memtransfer demo`: the suite `quick` with the policy `grounded`, its tables, and what to do next.

use std::ffi::OsString;

use anyhow::{Result, bail};
use clap::Args;

use super::{Cli, Exit, MemtransferVerb, run};

#[derive(Debug, Args)]
#[command(after_help = "\
This is `memtransfer run --suite quick --policy grounded`, in the folder runs/quick-grounded. It
needs no model, no key and no network. The same command again resumes it, or prints its tables.

Examples:
  memtransfer demo
  memtransfer demo --limit 5 --out runs/first")]
pub(super) struct DemoArgs {
    /// Flags for `memtransfer run`
    #[arg(value_name = "FLAG", trailing_var_arg = true, allow_hyphen_values = true)]
    run_flags: Vec<OsString>,
}

pub(super) fn run(args: DemoArgs) -> Result<Exit> {
    let command = ["memtransfer", "run", "--suite", "quick", "--policy", "grounded"];
    let command = command.into_iter().map(OsString::from).chain(args.run_flags);
    let MemtransferVerb::Run(run_args) = program::parse_from::<Cli>(command).verb else {
        bail!("the flags of a demo are those of `memtransfer run`");
    };
    let out = run_args.resolve()?.settings.out;
    let exit = run::run(*run_args)?;
    if exit == Exit::Complete {
        say!("\n{}", next_steps(&out.display().to_string()));
    }
    Ok(exit)
}

fn next_steps(run: &str) -> String {
    format!(
        "\
`grounded` is a scripted stand-in for a model: these figures say nothing about language models.

Next:
  memtransfer view {run}
      its episodes step by step, in a browser
  memtransfer report {run}
      the paper's tables and figures, as a page
  memtransfer run --policy openai --model NAME --base-url http://localhost:8000/v1 --limit 5
      a model behind an OpenAI-compatible server
  memtransfer run --memory episodic --memory-cmd 'python my_memory.py'
      a memory of your own, in Python (`memtransfer.Memory`)"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn next_steps_name_the_folder_of_the_run() {
        let steps = next_steps("runs/first");
        assert!(steps.contains("memtransfer view runs/first\n"));
        assert!(steps.contains("memtransfer report runs/first\n"));
    }
}
