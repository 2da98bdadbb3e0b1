//! The commit that a program was built from.

use std::path::Path;
use std::process::{Command, Stdio};

/// The commit of the checkout that `path` lies in, with a `+` when the checkout has changes; `None` outside
/// of one, or without git.
pub fn commit_of(path: &Path) -> Option<String> {
    let git = |arguments: &[&str]| {
        let output =
            Command::new("git").arg("-C").arg(path).args(arguments).stderr(Stdio::null()).output();
        let output = output.ok().filter(|output| output.status.success())?;
        String::from_utf8(output.stdout).ok()
    };
    let commit = git(&["rev-parse", "HEAD"])?;
    let changed = !git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty();
    Some(format!("{}{}", commit.trim(), if changed { "+" } else { "" }))
}
