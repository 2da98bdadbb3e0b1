//! Debian packages: installed by root, otherwise the command line to run.

use std::os::unix::fs::MetadataExt;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

/// Installs packages with apt-get.
///
/// # Errors
/// When this process is not root (the message has the command line to run), the machine has no apt-get, or apt-get
/// fails.
pub(crate) fn install(packages: &[&str]) -> anyhow::Result<()> {
    let list = packages.join(" ");
    if !std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0) {
        bail!(
            "system packages are missing. On Debian or Ubuntu run this line, elsewhere install the same packages \
             with the system's package manager; then run the same command again:\n\n    \
             sudo apt-get update && sudo apt-get install --yes --no-install-recommends {list}\n"
        );
    }
    apt_get(&["update"])?;
    let mut arguments = vec!["install", "--yes", "--no-install-recommends"];
    arguments.extend(packages);
    apt_get(&arguments)
}

fn apt_get(arguments: &[&str]) -> anyhow::Result<()> {
    let line = format!("apt-get {}", arguments.join(" "));
    eprintln!("set-up: {line}");
    let status = Command::new("apt-get")
        .args(["--quiet=2", "--option", "DPkg::Lock::Timeout=120"])
        .args(arguments)
        .env("DEBIAN_FRONTEND", "noninteractive")
        .stdin(Stdio::null())
        // stdout carries data; set-up has none.
        .stdout(std::io::stderr())
        .status()
        .with_context(|| format!("cannot start {line}"))?;
    if !status.success() {
        bail!("{line} failed ({status}); its messages are above. Is there a network?");
    }
    Ok(())
}
