//! `bench`: installs the baselines' packages, builds the programs and runs the benches.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;

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
    /// Measure only this project, without installing the baselines
    #[arg(long)]
    pub(crate) no_baselines: bool,
    /// Further flags for `memtransfer-bench`, for example `-- --rounds 3 --backend wgpu`
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
    let mut flags = Vec::<OsString>::new();
    if !arguments.no_baselines {
        flags.extend(["--python".into(), cache.root().join(BASELINES).into()]);
    }
    if let Some(only) = &arguments.only {
        flags.extend(["--only".into(), only.into()]);
    }
    flags.extend(arguments.flags.iter().cloned());
    // `exec` returns only on failure.
    Err(workspace.at_root(&program, &[]).args(flags).exec())
        .with_context(|| format!("cannot start {}", program.display()))
}
