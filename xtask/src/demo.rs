//! `demo`: builds the programs and runs `memtransfer demo`.

use std::os::unix::process::CommandExt;

use anyhow::Context;

use crate::workspace::Workspace;

/// Builds the programs, then replaces this process with `memtransfer demo`.
pub(crate) fn run(workspace: &Workspace, run_flags: &[String]) -> anyhow::Result<bool> {
    if !workspace.build_programs_for_this_machine()? {
        return Ok(false);
    }
    let memtransfer = workspace.program("memtransfer")?;
    let mut arguments = vec!["demo"];
    arguments.extend(run_flags.iter().map(String::as_str));
    eprintln!("memtransfer {}", arguments.join(" "));
    // `exec` returns only on failure.
    Err(workspace.at_root(&memtransfer, &arguments).exec())
        .with_context(|| format!("cannot start {}", memtransfer.display()))
}
