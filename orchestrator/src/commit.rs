//! The commit that this program was built from.

use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// The commit of the checkout that this program lies in, with a `+` when the checkout has changes; `None` outside of one, or
/// without git.
pub fn program_commit() -> Option<String> {
    static COMMIT: OnceLock<Option<String>> = OnceLock::new();
    COMMIT.get_or_init(describe).clone()
}

fn describe() -> Option<String> {
    let program = std::env::current_exe().ok()?;
    let mut git = Command::new("git");
    git.args(["--no-optional-locks", "-C"]).arg(program.parent()?);
    git.args(["describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]);
    let output = git.stderr(Stdio::null()).output().ok()?;
    let commit = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| commit.trim().to_owned())
}
