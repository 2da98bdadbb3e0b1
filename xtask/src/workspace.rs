//! The workspace: where it is, how cargo is called in it, where its programs are built.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::cache::{self, Cache};

/// The repository's root, and the cache that its programs are to use.
pub(crate) struct Workspace {
    root: PathBuf,
    cache: PathBuf,
}

impl Workspace {
    /// Finds the root: the folder above xtask's own.
    pub(crate) fn locate(cache: &Cache) -> anyhow::Result<Self> {
        let xtask = std::env::var_os("CARGO_MANIFEST_DIR")
            .unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
        let root = Path::new(&xtask)
            .parent()
            .context("xtask has no folder above it; run `cargo xtask`")?;
        Ok(Self { root: root.to_owned(), cache: cache.root().to_owned() })
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// `cargo ARGUMENTS...` at the root.
    pub(crate) fn cargo(&self, arguments: &[&str]) -> Command {
        self.at_root(
            std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()).as_ref(),
            arguments,
        )
    }

    /// Any program at the root, told which cache folder to use.
    pub(crate) fn at_root(&self, program: &Path, arguments: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(&self.root).env(cache::VARIABLE, &self.cache);
        command
    }

    /// Builds every program but xtask, which is running, in the one profile that everything shares.
    pub(crate) fn build_programs(&self) -> anyhow::Result<bool> {
        eprintln!("building the programs");
        succeeds(&mut self.cargo(&[
            "build",
            "--release",
            "--workspace",
            "--exclude",
            "xtask",
            "--bins",
        ]))
    }

    /// A program that [`Self::build_programs`] built: they all lie beside xtask itself.
    pub(crate) fn program(&self, name: &str) -> anyhow::Result<PathBuf> {
        Ok(std::env::current_exe().context("cannot find xtask's own place")?.with_file_name(name))
    }
}

/// Runs a command with this process's own streams; whether it succeeded.
pub(crate) fn succeeds(command: &mut Command) -> anyhow::Result<bool> {
    let program = command.get_program().to_string_lossy().into_owned();
    Ok(command.status().with_context(|| format!("cannot start {program}"))?.success())
}
