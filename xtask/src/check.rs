//! `check`: every check that runs no test.

use std::process::Command;

use crate::workspace::{Workspace, succeeds};
use crate::{boundaries, citations, features};

/// Runs all checks, also after one has failed. Returns whether all passed.
pub(crate) fn run(workspace: &Workspace) -> anyhow::Result<bool> {
    let mut failed = Vec::new();
    let mut check = |name: &'static str, passed: bool| {
        eprintln!("check: {name}: {}", if passed { "ok" } else { "FAILED" });
        if !passed {
            failed.push(name);
        }
    };

    check("links between crates", boundaries::check(workspace)?);
    check("features of dependencies", features::check(workspace)?);
    check("citations", citations::resolve(workspace)?);
    check("format", succeeds(&mut workspace.cargo(&["fmt", "--all", "--check"]))?);
    check("lints", succeeds(&mut lints(workspace))?);
    check("rustdoc", succeeds(&mut rustdoc(workspace))?);

    if failed.is_empty() {
        eprintln!("check: all passed");
    } else {
        eprintln!("check: failed: {}", failed.join("; "));
    }
    Ok(failed.is_empty())
}

fn lints(workspace: &Workspace) -> Command {
    workspace.cargo(&[
        "clippy",
        "--release",
        "--workspace",
        "--all-targets",
        "--keep-going",
        "--",
        "--deny",
        "warnings",
    ])
}

fn rustdoc(workspace: &Workspace) -> Command {
    let mut command =
        workspace.cargo(&["doc", "--release", "--workspace", "--no-deps", "--keep-going"]);
    command.env("RUSTDOCFLAGS", "--deny warnings");
    command
}
