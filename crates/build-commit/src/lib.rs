//! The commit that the programs were built from, which the build script asks git for. A program asks nothing when it runs:
//! the repository that it happens to lie in then, and the variables of git, say nothing about it.
//!
//! A crate of its own, which only the crates of the programs use, so that a commit does not have everything built again.

#[cfg(test)]
mod status;

/// The commit, with a `+` where files that the programs are built from had changes; `None` where they were built outside of the
/// project's repository, or without git.
pub const COMMIT: Option<&str> = {
    let commit = env!("BUILD_COMMIT");
    if commit.is_empty() { None } else { Some(commit) }
};
