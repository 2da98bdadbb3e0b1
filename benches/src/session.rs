//! What a bench is given while it runs.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

use crate::peers::Peers;

/// How much a bench measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// As little as shows that it works: a few seconds, and figures that mean nothing.
    Tiny,
    /// As much as a figure needs.
    Full,
}

impl Size {
    /// One of two values.
    pub const fn pick<T: Copy>(self, tiny: T, full: T) -> T {
        match self {
            Self::Tiny => tiny,
            Self::Full => full,
        }
    }
}

/// One bench's run.
#[derive(Debug)]
pub struct Session<'a> {
    /// How much is measured.
    pub size: Size,
    /// The peers' Python; without it, a bench measures ours alone.
    pub peers: Option<&'a Peers>,
    /// The folder of the built programs.
    pub programs: &'a Path,
    rounds: u32,
    bench: &'static str,
    scratch: TempDir,
    /// Where the runs of `memtransfer` are registered: short, since sockets lie below it.
    registry: TempDir,
}

impl<'a> Session<'a> {
    /// A session for the bench called `bench`.
    ///
    /// # Errors
    /// When no scratch folder can be made.
    pub fn new(
        bench: &'static str,
        size: Size,
        rounds: u32,
        programs: &'a Path,
        peers: Option<&'a Peers>,
    ) -> Result<Self> {
        let scratch = tempfile::Builder::new().prefix("memtransfer-bench-").tempdir();
        let registry = tempfile::Builder::new().prefix("mtb").tempdir_in("/tmp");
        let scratch = scratch.context("cannot make a scratch folder")?;
        let registry = registry.context("cannot make a folder for runs")?;
        Ok(Self { size, peers, programs, rounds: rounds.max(1), bench, scratch, registry })
    }

    /// How often everything is measured, at least once.
    pub fn rounds(&self) -> u32 {
        self.size.pick(1, self.rounds)
    }

    /// Says on stderr what is being done.
    pub fn say(&self, what: impl std::fmt::Display) {
        if self.size == Size::Full {
            eprintln!("{}: {what}", self.bench);
        }
    }

    /// A folder that is gone after the bench.
    pub fn scratch(&self) -> &Path {
        self.scratch.path()
    }

    /// Where runs are registered.
    pub fn registry(&self) -> &Path {
        self.registry.path()
    }

    /// The built program `name`.
    ///
    /// # Errors
    /// When it is not built.
    pub fn program(&self, name: &str) -> Result<PathBuf> {
        let program = self.programs.join(name);
        if !program.is_file() {
            bail!(
                "{} is not built: `cargo xtask bench` builds all programs first, by hand \
                 `cargo build --release --workspace --bins` does",
                program.display()
            );
        }
        Ok(program)
    }

    /// `memtransfer`, to be started in the scratch folder, with this session's runs apart from all others and no
    /// setting from the environment.
    ///
    /// # Errors
    /// When it is not built.
    pub fn memtransfer(&self) -> Result<Command> {
        let mut command = Command::new(self.program("memtransfer")?);
        // The cache folder is the machine's, not a setting of a run.
        let settings = std::env::vars_os().map(|(name, _)| name).filter(|name| {
            let name = name.to_string_lossy();
            name.starts_with("MEMTRANSFER_") && name != "MEMTRANSFER_CACHE"
        });
        for name in settings {
            command.env_remove(name);
        }
        command
            .current_dir(self.scratch())
            .env("MEMTRANSFER_RUN_DIR", self.registry())
            .stdin(Stdio::null());
        Ok(command)
    }

    /// Measures ours and the peer's in turns, so that both see the same machine: a value each, every round.
    ///
    /// # Errors
    /// The first error of either.
    pub fn in_turns(
        &mut self,
        mut ours: impl FnMut(&mut Self) -> Result<f64>,
        mut theirs: impl FnMut(&mut Self) -> Result<f64>,
    ) -> Result<(Vec<f64>, Vec<f64>)> {
        let mut values = (Vec::new(), Vec::new());
        for _ in 0..self.rounds() {
            values.0.push(ours(self)?);
            values.1.push(theirs(self)?);
        }
        Ok(values)
    }
}
