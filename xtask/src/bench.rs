//! `bench`: the baselines' packages, the programs, then the benches themselves.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use crate::cache::Cache;
use crate::pins::Pins;
use crate::workspace::Workspace;

/// The environment that has the baselines' packages, by its name in the list.
const BASELINES: &str = "Python of the benches";

/// What `memtransfer-bench` is told.
#[derive(Args)]
pub(crate) struct BenchArguments {
    /// Measure these benches alone (`-- --help` lists them)
    #[arg(long, value_name = "NAMES")]
    only: Option<String>,
    /// How often each figure is measured
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Earlier results (a bench.json) to set beside the new ones
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Keep earlier results of benches that are not measured now
    #[arg(long)]
    keep: bool,
    /// Bring no baselines, and measure ours alone
    #[arg(long)]
    pub(crate) no_baselines: bool,
    /// Further flags for `memtransfer-bench`, for example `-- --page docs/performance.md`
    #[arg(last = true)]
    flags: Vec<OsString>,
}

/// Builds the programs, then becomes `memtransfer-bench`: its exit status is the benches'.
pub(crate) fn run(
    arguments: &BenchArguments,
    pins: &Pins,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<bool> {
    if !workspace.build_programs(&["benches"])? {
        return Ok(false);
    }
    let program = workspace.program("memtransfer-bench")?;
    let target = program.parent().and_then(|folder| folder.parent());
    let out = target.context("the programs lie in no folder")?.join("bench");
    let mut flags: Vec<OsString> = vec!["--out".into(), out.into()];
    if !arguments.no_baselines {
        let place = cache.root().join(&pins.environment(BASELINES)?.place);
        flags.extend(["--python".into(), place.join("bin/python").into()]);
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
    // `exec` returns only when it failed.
    Err(workspace.at_root(&program, &[]).args(flags).exec())
        .with_context(|| format!("cannot start {}", program.display()))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_list_has_the_baselines() {
        let pins = Pins::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("setup.toml")).unwrap();
        assert!(pins.environment(BASELINES).is_ok());
    }
}
