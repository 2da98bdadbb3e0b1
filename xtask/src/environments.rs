//! Python environments in the cache folder: an interpreter and exactly the packages of one requirements file.
//!
//! An environment is never modified. A note in it records the hash of the requirements and the Python version; when the
//! note is out of date, the environment is created again.

use std::ffi::OsStr;
use std::fs;

use anyhow::Context;

use crate::cache::{Cache, LockedCache};
use crate::files::FileState;
use crate::pins::EnvironmentPin;
use crate::python;
use crate::sha256::Sum;
use crate::workspace::Workspace;

/// File name of the note.
const NOTE: &str = "made-from.txt";

/// Inspects an environment.
pub(crate) fn look(
    environment: &EnvironmentPin,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<FileState> {
    let folder = cache.root().join(&environment.place);
    if !folder.exists() {
        return Ok(FileState::Nothing);
    }
    // The interpreter is a link to the system's, which may have been removed.
    let whole = folder.join("bin/python").is_file();
    // An unreadable note counts as out of date.
    let note = fs::read_to_string(folder.join(NOTE)).unwrap_or_default();
    Ok(if whole && note == made_from(environment, workspace)? {
        FileState::Right
    } else {
        FileState::Other
    })
}

/// Creates the environment and moves it into place.
pub(crate) fn install(
    environment: &EnvironmentPin,
    cache: &LockedCache<'_>,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    eprintln!("set-up: creating {}", environment.place.display());
    let made = cache.tmp()?.join("environment");
    let requirements = workspace.root().join(&environment.requirements);
    let wheels = cache.wheels()?;
    let arguments: [&OsStr; 3] = [made.as_ref(), requirements.as_ref(), wheels.as_ref()];
    python::run_script(&workspace.root().join(&environment.script), &arguments).with_context(
        || {
            format!(
                "{} is missing. Without a network, put the wheels that {} lists into {} and run \
                 the same command again",
                environment.name,
                environment.requirements.display(),
                wheels.display(),
            )
        },
    )?;
    let note = made.join(NOTE);
    fs::write(&note, made_from(environment, workspace)?)
        .with_context(|| format!("cannot write {}", note.display()))?;
    let place = cache.place(&environment.place);
    if place.exists() {
        fs::remove_dir_all(&place).with_context(|| format!("cannot remove {}", place.display()))?;
    }
    cache.finish(&made, &place)
}

/// Contents of an up-to-date note.
fn made_from(environment: &EnvironmentPin, workspace: &Workspace) -> anyhow::Result<String> {
    let requirements = Sum::of_file(&workspace.root().join(&environment.requirements))?;
    Ok(format!("{requirements}\n{}\n", python::kind()?))
}
