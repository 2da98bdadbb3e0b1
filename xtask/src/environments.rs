//! Folders of Python packages in the cache folder: an interpreter, and exactly the packages of one
//! list.
//!
//! Such a folder is never changed. It says in a note what it was made from: the sum of the list, and
//! the Python. When the note does not say what would be written now, the folder is made anew.

use std::ffi::OsStr;
use std::fs;

use anyhow::Context;

use crate::cache::{Cache, LockedCache};
use crate::files::Found;
use crate::pins::EnvironmentPin;
use crate::python;
use crate::sha256::Sum;
use crate::workspace::Workspace;

/// The note's name in the folder.
const NOTE: &str = "made-from.txt";

/// Looks at an environment's place.
pub(crate) fn look(
    environment: &EnvironmentPin,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<Found> {
    let folder = cache.root().join(&environment.place);
    if !folder.exists() {
        return Ok(Found::Nothing);
    }
    // The interpreter is a link to the machine's, which may be gone.
    let whole = folder.join("bin/python").is_file();
    // Whatever keeps the note from being read, it does not say what it should.
    let note = fs::read_to_string(folder.join(NOTE)).unwrap_or_default();
    Ok(if whole && note == made_from(environment, workspace)? {
        Found::Right
    } else {
        Found::Other
    })
}

/// Makes the environment and moves it into place.
pub(crate) fn bring(
    environment: &EnvironmentPin,
    cache: &LockedCache<'_>,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    eprintln!("set-up: making {}", environment.place.display());
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

/// What the environment would be made from now.
fn made_from(environment: &EnvironmentPin, workspace: &Workspace) -> anyhow::Result<String> {
    let requirements = Sum::of_file(&workspace.root().join(&environment.requirements))?;
    Ok(format!("{requirements}\n{}\n", python::kind()?))
}
