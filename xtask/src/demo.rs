//! `demo`: the main job, from nothing to its table.

use std::os::unix::process::CommandExt;

use anyhow::Context;

use crate::workspace::Workspace;

/// Builds the programs, then becomes `memtransfer run`: its progress, its signals and its exit
/// status are the demo's.
pub(crate) fn run(workspace: &Workspace, run_flags: &[String]) -> anyhow::Result<bool> {
    if !workspace.build_programs(&[])? {
        return Ok(false);
    }
    let memtransfer = workspace.program("memtransfer")?;
    let mut arguments = vec!["run", "--suite", "quick", "--policy", "grounded"];
    arguments.extend(run_flags.iter().map(String::as_str));
    eprintln!("memtransfer {}", arguments.join(" "));
    // `exec` returns only when it failed.
    Err(workspace.at_root(&memtransfer, &arguments).exec())
        .with_context(|| format!("cannot start {}", memtransfer.display()))
}
