//! Files in the cache folder: identified by their SHA-256, made from a wheel, moved into place when complete.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use crate::cache::{Cache, LockedCache};
use crate::pins::{FilePin, WheelPin};
use crate::python;
use crate::sha256::Sum;
use crate::workspace::Workspace;

/// State of a file or environment.
#[derive(PartialEq, Eq, Debug)]
pub(crate) enum FileState {
    /// It is the pinned one.
    Right,
    /// It is another one: outdated or damaged.
    Other,
    /// It does not exist.
    Nothing,
}

/// Inspects a file.
pub(crate) fn look(file: &FilePin, cache: &Cache) -> anyhow::Result<FileState> {
    found(&cache.root().join(&file.place), file.here()?.sha256)
}

/// Makes the file from its wheel with its script, verifies its hash, and moves it into place.
pub(crate) fn install(
    file: &FilePin,
    cache: &LockedCache<'_>,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let pin = file.here()?;
    let wheel = pin.wheel.as_ref().map(|wheel| download(wheel, &file.name, cache)).transpose()?;

    eprintln!("set-up: making {}", file.place.display());
    let made = cache.tmp()?.join("made");
    let from = file.from.as_ref().map(|from| cache.place(from));
    let mut arguments: Vec<&OsStr> = wheel.iter().chain(&from).map(|it| it.as_os_str()).collect();
    arguments.push(made.as_os_str());
    arguments.extend(file.arguments.iter().map(OsStr::new));
    python::run_script(&workspace.root().join(&file.script), &arguments)?;
    let sum = Sum::of_file(&made)?;
    if sum != pin.sha256 {
        bail!(
            "{} was made with SHA-256 {sum}, but {} is pinned; nothing was put into place. If {} \
             was changed on purpose, put the new sum into xtask/setup.toml",
            file.place.display(),
            pin.sha256,
            file.script.display(),
        );
    }
    cache.finish(&made, &cache.place(&file.place))?;
    // The wheel takes tens of megabytes and is not needed again.
    wheel.map_or(Ok(()), |wheel| {
        fs::remove_file(&wheel).with_context(|| format!("cannot remove {}", wheel.display()))
    })
}

/// Has pip put the pinned wheel into `wheels/`, and returns its path. pip verifies the hash, also of a wheel that is
/// already there, and downloads only what is missing or damaged.
fn download(
    wheel: &WheelPin,
    needed_for: &str,
    cache: &LockedCache<'_>,
) -> anyhow::Result<PathBuf> {
    eprintln!("set-up: downloading {}", wheel.package);
    let wheels = cache.wheels()?;
    python::download(wheel, &wheels, &cache.tmp()?).with_context(|| {
        format!(
            "{needed_for} is missing. Without a network, put {} (SHA-256 {}) into {} and run the \
             same command again",
            wheel.file,
            wheel.sha256,
            wheels.display(),
        )
    })?;
    let downloaded = wheels.join(&wheel.file);
    if !downloaded.is_file() {
        bail!(
            "pip downloaded another wheel of {} than the pinned {}; nothing was installed",
            wheel.package,
            wheel.file
        );
    }
    Ok(downloaded)
}

fn found(path: &Path, pinned: Sum) -> anyhow::Result<FileState> {
    if !path.is_file() {
        return Ok(FileState::Nothing);
    }
    Ok(if Sum::of_file(path)? == pinned { FileState::Right } else { FileState::Other })
}
