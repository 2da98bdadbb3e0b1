//! Python 3, and uv, which installs wheels and checks their hashes.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::cache::{Cache, remove_folder};
use crate::workspace::{Workspace, succeeds};

/// The requirements file of uv, relative to the workspace.
const UV: &str = "xtask/python/uv.txt";

/// File name of the note in a folder of packages that says what they were installed from. It is written last.
const NOTE: &str = "made-from.txt";

/// Variables of pip that uv has under other names: where packages come from instead of PyPI.
const SOURCES: [(&str, &str); 3] = [
    ("PIP_INDEX_URL", "UV_DEFAULT_INDEX"),
    ("PIP_FIND_LINKS", "UV_FIND_LINKS"),
    ("PIP_NO_INDEX", "UV_OFFLINE"),
];

/// What helps where nothing can be downloaded.
const WITHOUT_NETWORK: &str =
    "Without a network, name a folder with the wheels in PIP_FIND_LINKS, and set PIP_NO_INDEX=1";

/// First line of `-m MODULE --version`; `None` when it fails.
pub(crate) fn module_version(module: &str) -> Option<String> {
    let output = python().args(["-m", module, "--version"]).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    output.status.success().then(|| text.lines().next().unwrap_or_default().to_owned())
}

/// Whether `folder` has exactly the packages of `requirements` for this machine's Python.
pub(crate) fn is_made_from(folder: &Path, requirements: &Path) -> anyhow::Result<bool> {
    // An unreadable note counts as out of date.
    let note = fs::read_to_string(folder.join(NOTE)).unwrap_or_default();
    Ok(note == made_from(requirements)?)
}

/// Makes an environment with exactly the packages of `requirements`, in place of an earlier one.
pub(crate) fn make_environment(
    folder: &Path,
    requirements: &Path,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let venv = |uv: &mut Command| {
        uv.args(["venv", "--clear", "--no-project", "--python", "python3"]).arg(folder);
    };
    uv(cache, workspace, venv)?;
    let sync = |uv: &mut Command| {
        uv.args(["pip", "sync", "--require-hashes", "--python"]).arg(folder.join("bin/python"));
        uv.arg(requirements);
    };
    uv(cache, workspace, sync)?;
    write_note(folder, requirements)
}

/// Unpacks a wheel into `folder`. Its files do not depend on Python; 3.12 only names one wheel, the same on every machine.
pub(crate) fn unpack_wheel(
    requirement: &str,
    folder: &Path,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let requirements = cache.tmp()?.join("wheel.txt");
    fs::write(&requirements, requirement)
        .with_context(|| format!("cannot write {}", requirements.display()))?;
    let install = |uv: &mut Command| {
        let platform = format!("{}-manylinux_2_28", std::env::consts::ARCH);
        uv.args(["pip", "install", "--require-hashes", "--no-deps", "--python", "python3"]);
        uv.args(["--python-version", "3.12", "--python-platform", &platform]);
        uv.arg("--target").arg(folder).arg("--requirements").arg(&requirements);
    };
    uv(cache, workspace, install)
}

/// Runs uv, which is installed when it is missing. What it downloads is in the cache's `tmp/`.
fn uv(
    cache: &Cache,
    workspace: &Workspace,
    arguments: impl FnOnce(&mut Command),
) -> anyhow::Result<()> {
    let folder = cache.root().join("uv");
    let requirements = workspace.root().join(UV);
    if !is_made_from(&folder, &requirements)? {
        install_uv(&folder, &requirements)?;
    }
    let mut command = Command::new(folder.join("bin/uv"));
    command.env("UV_CACHE_DIR", cache.tmp()?.join("uv")).env("UV_PYTHON_DOWNLOADS", "never");
    for (pip, uv) in SOURCES {
        if let (Ok(value), None) = (std::env::var(pip), std::env::var_os(uv)) {
            // pip separates folders by spaces, uv by commas.
            command.env(uv, value.split_whitespace().collect::<Vec<_>>().join(","));
        }
    }
    command.args(["--quiet", "--no-progress"]);
    arguments(&mut command);
    // stdout carries data; set-up has none.
    command.stdin(Stdio::null()).stdout(Stdio::null());
    if !succeeds(&mut command)? {
        bail!("uv failed; its messages are above. {WITHOUT_NETWORK}");
    }
    Ok(())
}

fn install_uv(folder: &Path, requirements: &Path) -> anyhow::Result<()> {
    eprintln!("set-up: installing uv");
    remove_folder(folder)?;
    let mut command = python();
    command
        .args(["-m", "pip", "install", "--require-hashes", "--no-deps", "--only-binary", ":all:"])
        .args(["--no-cache-dir", "--no-input", "--disable-pip-version-check", "--quiet"])
        .arg("--target")
        .arg(folder)
        .arg("--requirement")
        .arg(requirements)
        .env("PIP_ROOT_USER_ACTION", "ignore")
        .stdout(Stdio::null());
    if !succeeds(&mut command)? {
        bail!(
            "pip could not install {}; its messages are above. {WITHOUT_NETWORK}",
            requirements.display()
        );
    }
    write_note(folder, requirements)
}

fn write_note(folder: &Path, requirements: &Path) -> anyhow::Result<()> {
    let note = folder.join(NOTE);
    fs::write(&note, made_from(requirements)?)
        .with_context(|| format!("cannot write {}", note.display()))
}

/// The note: this machine's Python, and the requirements.
fn made_from(requirements: &Path) -> anyhow::Result<String> {
    let print = "import platform, sys; \
                 print(sys.implementation.cache_tag, platform.machine(), sys.base_prefix)";
    let output = python().args(["-c", print]).output().context("cannot start python3")?;
    if !output.status.success() {
        bail!("python3 failed: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let requirements = fs::read_to_string(requirements)
        .with_context(|| format!("cannot read {}", requirements.display()))?;
    Ok(format!("{}{requirements}", String::from_utf8_lossy(&output.stdout)))
}

/// Runs `python3 SCRIPT ARGUMENTS...`.
pub(crate) fn run_script(script: &Path, arguments: &[&OsStr]) -> anyhow::Result<()> {
    // -B: leave no bytecode in the tree.
    let mut command = python();
    command.arg("-B").arg(script).args(arguments).stdout(Stdio::null());
    if !succeeds(&mut command)? {
        bail!("{} failed; its messages are above", script.display());
    }
    Ok(())
}

/// Builds the wheel, with the programs, into `target/wheels`. pip installs maturin in the version of `pyproject.toml`.
pub(crate) fn build_wheel(workspace: &Workspace) -> anyhow::Result<bool> {
    let wheels = workspace.root().join("target/wheels");
    let mut command = python();
    command
        .args(["-m", "pip", "wheel", "--no-deps", "--disable-pip-version-check", "--wheel-dir"])
        .arg(&wheels)
        .arg(workspace.root());
    succeeds(&mut command)
}

fn python() -> Command {
    let mut command = Command::new("python3");
    command.stdin(Stdio::null());
    command
}
