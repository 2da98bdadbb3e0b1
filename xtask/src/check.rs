//! `check`: every check that runs no test.

use std::process::{Command, Stdio};

use crate::workspace::{Workspace, succeeds};
use crate::{boundaries, citations, features, licences};

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
    check("docs", succeeds(&mut docs(workspace))?);
    if cargo_deny_is_there(workspace) {
        check(
            "licences, bans, sources",
            succeeds(&mut workspace.cargo(&["deny", "check", "licenses", "bans", "sources"]))?,
        );
        match advisories(workspace) {
            Some(mut advisories) => check("advisories", succeeds(&mut advisories)?),
            None => eprintln!(
                "check: advisories: skipped, cargo-deny's database is not on this machine"
            ),
        }
    } else {
        check("licences, sources", licences::are_allowed(workspace)?);
        eprintln!("check: bans, advisories: skipped, cargo-deny is not installed");
    }

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

fn docs(workspace: &Workspace) -> Command {
    let mut command =
        workspace.cargo(&["doc", "--release", "--workspace", "--no-deps", "--keep-going"]);
    command.env("RUSTDOCFLAGS", "--deny warnings");
    command
}

fn cargo_deny_is_there(workspace: &Workspace) -> bool {
    let mut command = workspace.cargo(&["deny", "--version"]);
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// The check for known vulnerabilities, if their database has been fetched; CI cannot fetch it.
fn advisories(workspace: &Workspace) -> Option<Command> {
    let home = std::env::var_os("CARGO_HOME").map(Into::into).or_else(|| {
        let home = std::env::home_dir()?;
        Some(home.join(".cargo"))
    })?;
    let databases = std::path::Path::join(&home, "advisory-dbs");
    let fetched = std::fs::read_dir(databases).is_ok_and(|mut entries| entries.next().is_some());
    fetched
        .then(|| workspace.cargo(&["deny", "--offline", "check", "--disable-fetch", "advisories"]))
}
