//! `bench`: installs the baselines' packages, builds the programs and runs the benches.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use crate::cache::Cache;
use crate::workspace::Workspace;

/// The interpreter with the baselines' packages, in the cache folder.
const BASELINES: &str = "python-bench/bin/python";

/// Flags passed on to `memtransfer-bench`.
#[derive(Args)]
pub(crate) struct BenchArguments {
    /// Measure only these benches, separated by commas (`-- --help` lists them)
    #[arg(long, value_name = "NAMES")]
    only: Option<String>,
    /// Number of rounds
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Compare with earlier results (a bench.json)
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Keep earlier results of benches that are not measured now
    #[arg(long)]
    keep: bool,
    /// Measure only this project, without installing the baselines
    #[arg(long)]
    pub(crate) no_baselines: bool,
    /// Further flags for `memtransfer-bench`, for example `-- --backend wgpu --provider cuda`
    #[arg(last = true)]
    flags: Vec<OsString>,
}

/// Builds the programs, then replaces this process with `memtransfer-bench`.
pub(crate) fn run(
    arguments: &BenchArguments,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<bool> {
    if !workspace.build_programs(&["benches"])?
        || (!arguments.no_baselines && !workspace.build_python_extension()?)
    {
        return Ok(false);
    }
    let program = workspace.program("memtransfer-bench")?;
    let out = workspace.target_folder()?.join("bench");
    let mut flags: Vec<OsString> = vec!["--out".into(), out.into()];
    if !arguments.no_baselines {
        flags.extend(["--python".into(), cache.root().join(BASELINES).into()]);
    }
    if let Some(only) = &arguments.only {
        flags.extend(["--only".into(), only.into()]);
    }
    if let Some(rounds) = arguments.rounds {
        flags.extend(["--rounds".into(), rounds.to_string().into()]);
    }
    if let Some(earlier) = &arguments.compare {
        let earlier = std::path::absolute(earlier).context("--compare")?;
        flags.extend(["--compare".into(), earlier.into()]);
    }
    if arguments.keep {
        flags.push("--keep".into());
    }
    flags.extend(arguments.flags.iter().cloned());
    // `exec` returns only on failure.
    Err(workspace.at_root(&program, &[]).args(flags).exec())
        .with_context(|| format!("cannot start {}", program.display()))
}
