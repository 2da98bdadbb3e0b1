//! Debian's packages: installed when this process may, otherwise the line that a person has to run.

use std::os::unix::fs::MetadataExt;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

/// Who may install.
enum Authority {
    Root,
    /// sudo that asks for no password.
    Sudo,
}

/// Installs packages, or says which line does.
pub(crate) fn install(packages: &[&str]) -> anyhow::Result<()> {
    let list = packages.join(" ");
    if !succeeds(Command::new("apt-get").arg("--version")) {
        bail!(
            "this machine has no apt-get; bring what these Debian packages hold by its own \
             package manager, then run the same command again: {list}"
        );
    }
    let Some(authority) = authority() else {
        bail!(
            "packages are missing and only root may install them; run this line, then the same \
             command again:\n\n    sudo apt-get update && \
             sudo apt-get install --yes --no-install-recommends {list}\n"
        );
    };
    let mut install = vec!["install", "--yes", "--no-install-recommends"];
    install.extend(packages);
    if lists_are_there() {
        if apt_get(&authority, &install)? {
            return Ok(());
        }
        eprintln!("set-up: the package lists may be old; updating them and trying once more");
    }
    if !apt_get(&authority, &["update"])? {
        bail!("apt-get update failed; its own words are above. Is there a network?");
    }
    if !apt_get(&authority, &install)? {
        bail!("apt-get could not install {list}; its own words are above");
    }
    Ok(())
}

/// Runs `apt-get` with nobody to answer questions; whether it succeeded.
fn apt_get(authority: &Authority, arguments: &[&str]) -> anyhow::Result<bool> {
    eprintln!("set-up: apt-get {}", arguments.join(" "));
    let mut command = match authority {
        Authority::Root => Command::new("env"),
        Authority::Sudo => {
            let mut command = Command::new("sudo");
            command.args(["--non-interactive", "env"]);
            command
        }
    };
    command
        .args([
            "DEBIAN_FRONTEND=noninteractive",
            "apt-get",
            "--quiet=2",
            "--option",
            "DPkg::Lock::Timeout=120",
        ])
        .args(arguments)
        .stdin(Stdio::null())
        // stdout is for data; there is none here.
        .stdout(std::io::stderr());
    Ok(command.status().context("cannot start apt-get")?.success())
}

/// Whether `apt-get update` has ever run here.
fn lists_are_there() -> bool {
    let entries = std::fs::read_dir("/var/lib/apt/lists").into_iter().flatten().flatten();
    entries.into_iter().any(|entry| entry.file_name().to_string_lossy().contains("_Packages"))
}

fn authority() -> Option<Authority> {
    if std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0) {
        Some(Authority::Root)
    } else if succeeds(Command::new("sudo").args(["--non-interactive", "true"])) {
        Some(Authority::Sudo)
    } else {
        None
    }
}

fn succeeds(command: &mut Command) -> bool {
    let quiet = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    quiet.status().is_ok_and(|status| status.success())
}
