//! Python 3: downloads wheels with pip and runs the scripts that extract files from them.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::pins::WheelPin;
use crate::workspace::{Workspace, succeeds};

/// First line of `-m MODULE --version`; `None` when it fails.
pub(crate) fn module_version(module: &str) -> Option<String> {
    let output = python().args(["-m", module, "--version"]).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    output.status.success().then(|| text.lines().next().unwrap_or_default().to_owned())
}

/// Implementation, version, machine and installation prefix.
pub(crate) fn kind() -> anyhow::Result<String> {
    let print = "import platform, sys; \
                 print(sys.implementation.cache_tag, platform.machine(), sys.base_prefix)";
    let output = python().args(["-c", print]).output().context("cannot start python3")?;
    if !output.status.success() {
        bail!("python3 failed: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Has pip download exactly `wheel` into `folder` and verify its hash. pip's temporary files go to `tmp`.
pub(crate) fn download(wheel: &WheelPin, folder: &Path, tmp: &Path) -> anyhow::Result<()> {
    let requirement = tmp.join("requirement.txt");
    let line = format!("{} --hash=sha256:{}\n", wheel.package, wheel.sha256);
    std::fs::write(&requirement, line)
        .with_context(|| format!("cannot write {}", requirement.display()))?;
    let status = python()
        .args(["-m", "pip", "download", "--require-hashes", "--no-deps"])
        .args(["--only-binary", ":all:", "--no-cache-dir", "--no-input"])
        .args(["--disable-pip-version-check", "--quiet", "--retries", "2"])
        .args(&wheel.pip)
        .arg("--dest")
        .arg(folder)
        .arg("--find-links")
        .arg(folder)
        .arg("--requirement")
        .arg(&requirement)
        .env("TMPDIR", tmp)
        .stdout(Stdio::null())
        .status()
        .context("cannot start python3")?;
    if !status.success() {
        bail!("pip could not download {} ({status}); its messages are above", wheel.package);
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
        bail!("{} failed ({status}); its messages are above", script.display());
    }
    Ok(())
}

/// Builds a wheel of the package in `python/` into `target/wheels`. pip installs maturin in the version of
/// `python/pyproject.toml`.
pub(crate) fn build_wheel(workspace: &Workspace) -> anyhow::Result<bool> {
    let wheels = workspace.root().join("target/wheels");
    let mut command = python();
    command
        .args(["-m", "pip", "wheel", "--no-deps", "--disable-pip-version-check", "--wheel-dir"])
        .arg(&wheels)
        .arg(workspace.root().join("python"));
    succeeds(&mut command)
}

fn python() -> Command {
    let mut command = Command::new("python3");
    command.stdin(Stdio::null());
    command
}
