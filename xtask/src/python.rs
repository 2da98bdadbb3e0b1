//! Python 3, which downloads wheels (pip) and runs the small scripts that take files out of them.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

/// `-m MODULE --version`'s first line, when it works.
pub(crate) fn module_version(module: &str) -> Option<String> {
    let output = python().args(["-m", module, "--version"]).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    output.status.success().then(|| text.lines().next().unwrap_or_default().to_owned())
}

/// Which Python it is: kind and version, machine, and where it is installed.
pub(crate) fn kind() -> anyhow::Result<String> {
    let print = "import platform, sys; \
                 print(sys.implementation.cache_tag, platform.machine(), sys.base_prefix)";
    let output = python().args(["-c", print]).output().context("cannot start python3")?;
    if !output.status.success() {
        bail!("python3 failed: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Downloads the one wheel of `package` (`name==version`) into `folder`.
pub(crate) fn download(package: &str, flags: &[String], folder: &Path) -> anyhow::Result<()> {
    let status = python()
        .args([
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--only-binary",
            ":all:",
            "--no-cache-dir",
            "--no-input",
        ])
        .args(["--disable-pip-version-check", "--quiet", "--retries", "2", "--dest"])
        .arg(folder)
        .args(flags)
        .arg(package)
        // What pip leaves when it is killed goes where set-up cleans up.
        .env("TMPDIR", folder)
        .stdout(Stdio::null())
        .status()
        .context("cannot start python3")?;
    if !status.success() {
        bail!("pip could not download {package} ({status}); its own words are above");
    }
    Ok(())
}

/// Runs `python3 SCRIPT ARGUMENTS...`.
pub(crate) fn run_script(script: &Path, arguments: &[&std::ffi::OsStr]) -> anyhow::Result<()> {
    // -B: leave no bytecode in the tree.
    let status = python()
        .arg("-B")
        .arg(script)
        .args(arguments)
        .stdout(Stdio::null())
        .status()
        .context("cannot start python3")?;
    if !status.success() {
        bail!("{} failed ({status}); its own words are above", script.display());
    }
    Ok(())
}

fn python() -> Command {
    let mut command = Command::new("python3");
    command.stdin(Stdio::null());
    command
}
