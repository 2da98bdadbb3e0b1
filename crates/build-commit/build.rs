//! Asks git for the commit that is built, once for each commit and for each change of the programs' sources.

#[path = "src/status.rs"]
mod status;

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the programs are built from. Changes of other files, such as documents, do not make a build another one.
const SOURCES: [&str; 10] = [
    "Cargo.lock",
    "Cargo.toml",
    "assets",
    "benches/src",
    "crates",
    "memory-proc",
    "orchestrator",
    "policy-proc",
    "shm-types",
    "sim-proc",
];

fn main() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let commit = if is_repository(&root) { commit(&root) } else { None };
    println!("cargo::rustc-env=BUILD_COMMIT={}", commit.unwrap_or_default());
    SOURCES.iter().for_each(|path| watch(&root.join(path)));
}

/// Whether `root` is the top of a repository, and not a folder of another project's.
fn is_repository(root: &Path) -> bool {
    let top = git(root, &["rev-parse", "--show-toplevel"]);
    let top = top.and_then(|top| Path::new(top.trim_end()).canonicalize().ok());
    top.is_some() && top == root.canonicalize().ok()
}

fn commit(root: &Path) -> Option<String> {
    // These change with every commit and checkout. A file that is missing would have the script run in every build.
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(root, &["rev-parse", "--git-path", name]) {
            watch(&root.join(path.trim_end()));
        }
    }
    let flags = ["status", "--porcelain=v2", "--branch", "--untracked-files=no", "--"];
    status::commit(&git(root, &[&flags[..], &SOURCES].concat())?)
}

/// What git prints about the repository that `root` is in; `None` when it fails.
fn git(root: &Path, args: &[&str]) -> Option<String> {
    let mut git = Command::new("git");
    // A lock would stay in the checkout if the build were killed now. No program that the repository names is started.
    git.args(["--no-optional-locks", "-c", "core.fsmonitor=false", "-C"]).arg(root).args(args);
    // Variables such as GIT_DIR name other repositories.
    let variables = env::vars_os().map(|(name, _)| name);
    for variable in variables.filter(|name| name.to_string_lossy().starts_with("GIT_")) {
        git.env_remove(variable);
    }
    let output = git.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    String::from_utf8(output.stdout).ok().filter(|_| output.status.success())
}

/// Has the script run again when `path` changes.
fn watch(path: &Path) {
    if path.exists() {
        println!("cargo::rerun-if-changed={}", path.display());
    }
}
