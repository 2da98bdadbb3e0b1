//! The commit that this program was built from.

use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// The commit of the checkout that this program lies in, with a `+` when the checkout has changes; `None` outside of one, or
/// without git.
pub fn program_commit() -> Option<String> {
    static COMMIT: OnceLock<Option<String>> = OnceLock::new();
    COMMIT.get_or_init(ask_git).clone()
}

fn ask_git() -> Option<String> {
    let program = std::env::current_exe().ok()?;
    // A lock would stay in the checkout if this program were killed now.
    let mut git = Command::new("git");
    git.args(["--no-optional-locks", "-C"]).arg(program.parent()?);
    git.args(["status", "--porcelain=v2", "--branch", "--untracked-files=no"]);
    let output = git.stderr(Stdio::null()).output().ok()?;
    output.status.success().then_some(())?;
    commit(&String::from_utf8(output.stdout).ok()?)
}

/// The commit in what `git status` printed.
fn commit(status: &str) -> Option<String> {
    let hash = status.lines().find_map(|line| line.strip_prefix("# branch.oid "))?;
    let is_changed = status.lines().any(|line| !line.starts_with('#'));
    Some(format!("{hash}{}", if is_changed { "+" } else { "" }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkout_with_changes_is_marked() {
        let clean = "# branch.oid 514c55f\n# branch.head main\n";
        assert_eq!(commit(clean).as_deref(), Some("514c55f"));
        let changed = format!("{clean}1 .M N... 100644 100644 100644 1f 1f README.md\n");
        assert_eq!(commit(&changed).as_deref(), Some("514c55f+"));
        assert_eq!(commit(""), None);
    }
}
