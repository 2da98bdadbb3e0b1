//! `memtransfer demo`: the suite `quick` with the policy `grounded`, its tables, and what to do next.

use std::ffi::{OsStr, OsString};
use std::fs::canonicalize;
use std::path::Path;

use anyhow::{Result, bail};
use clap::Args;
use domain::shell_word;

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
        // A program that was replaced meanwhile has no path.
        let program = std::env::current_exe().and_then(canonicalize).ok();
        let path = std::env::var_os("PATH").unwrap_or_default();
        let hint = program.and_then(|program| hint_of_path(&program, &path));
        say!("\n{}", next_steps(&out.display().to_string(), &hint.unwrap_or_default()));
    }
    Ok(exit)
}

/// How the shell finds this `program`, if `memtransfer` stands for no program in the folders of `path`, or for another one.
fn hint_of_path(program: &Path, path: &OsStr) -> Option<String> {
    let found =
        std::env::split_paths(path).find_map(|dir| canonicalize(dir.join("memtransfer")).ok());
    let dir = program.parent().filter(|_| found.as_deref() != Some(program))?;
    Some(format!(
        "  export PATH={}:$PATH\n      so that the shell finds `memtransfer`\n",
        shell_word(dir)
    ))
}

fn next_steps(run: &str, hint_of_path: &str) -> String {
    format!(
        "\
`grounded` is a scripted stand-in for a model: these figures say nothing about language models.

Next:
{hint_of_path}  memtransfer view {run}
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
    fn next_steps_name_the_folder_of_the_run_and_make_the_program_known() {
        let folder = tempfile::tempdir().unwrap();
        let dir = canonicalize(folder.path()).unwrap();
        let program = dir.join("memtransfer");
        std::fs::write(&program, "").unwrap();
        assert_eq!(
            hint_of_path(&program, OsStr::new(&format!("/nowhere:{}", dir.display()))),
            None
        );
        let hint = hint_of_path(&program, OsStr::new("/nowhere")).unwrap();
        let steps = next_steps("runs/first", &hint);
        assert!(steps.contains("memtransfer view runs/first\n"));
        assert!(steps.contains("memtransfer report runs/first\n"));
        let export = format!("Next:\n  export PATH={}:$PATH\n", dir.display());
        assert!(steps.contains(&export), "{steps}");
        assert!(next_steps("runs/first", "").contains("Next:\n  memtransfer view"));
    }
}
