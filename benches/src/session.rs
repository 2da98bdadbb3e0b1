//! The environment of a running bench: size, rounds, scratch folder, programs.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use memory_proc::encoder::Provider;
use sim_proc::renderer::Backend;
use tempfile::TempDir;

/// How much a bench measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// Enough to show that the bench works, in a few seconds. The figures mean nothing.
    Tiny,
    /// Enough for a meaningful figure.
    Full,
}

impl Size {
    /// Returns the value for this size.
    pub const fn pick<T: Copy>(self, tiny: T, full: T) -> T {
        match self {
            Self::Tiny => tiny,
            Self::Full => full,
        }
    }
}

/// Threads that each side may use: the number of cores.
pub fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// What renders and embeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hardware {
    /// What renders views.
    pub backend: Backend,
    /// What the encoder computes on.
    pub provider: Provider,
}

impl Hardware {
    /// The processor alone.
    pub const CPU: Self = Self { backend: Backend::Cpu, provider: Provider::Cpu };
}

/// The environment of one bench.
#[derive(Debug)]
pub struct BenchSession<'a> {
    /// How much to measure.
    pub size: Size,
    /// What renders and embeds.
    pub hardware: Hardware,
    /// The Python interpreter of the baselines; without it a bench measures only this project.
    pub python: Option<&'a Path>,
    /// The folder of the built programs.
    pub programs: &'a Path,
    /// Rounds to measure, at least one.
    pub rounds: u32,
    bench: &'static str,
    scratch: TempDir,
    /// Registry folder of the runs of `memtransfer`. Its path is short because sockets are created below it.
    registry: TempDir,
}

impl<'a> BenchSession<'a> {
    /// A session for the bench called `bench`: one round, on the processor, without baselines.
    ///
    /// # Errors
    /// When a scratch folder cannot be created.
    pub fn new(bench: &'static str, size: Size, programs: &'a Path) -> Result<Self> {
        let scratch = tempfile::Builder::new().prefix("memtransfer-bench-").tempdir();
        let registry = tempfile::Builder::new().prefix("mtb").tempdir_in("/dev/shm");
        let scratch = scratch.context("cannot create a scratch folder")?;
        let registry = registry.context("cannot create a registry folder for runs")?;
        Ok(Self {
            size,
            hardware: Hardware::CPU,
            python: None,
            programs,
            rounds: 1,
            bench,
            scratch,
            registry,
        })
    }

    /// Prints progress on stderr.
    pub fn progress(&self, message: impl std::fmt::Display) {
        if self.size == Size::Full {
            eprintln!("{}: {message}", self.bench);
        }
    }

    /// A folder that is removed after the bench.
    pub fn scratch(&self) -> &Path {
        self.scratch.path()
    }

    /// Registry folder of the runs.
    pub fn registry(&self) -> &Path {
        self.registry.path()
    }

    /// Path of the built program `name`.
    ///
    /// # Errors
    /// When it is not built.
    pub fn program(&self, name: &str) -> Result<PathBuf> {
        let program = self.programs.join(name);
        if !program.is_file() {
            bail!(
                "{} is not built; run `cargo xtask bench`, which builds all programs first",
                program.display()
            );
        }
        Ok(program)
    }

    /// The flags of a run in the warehouse that say what renders.
    pub fn backend_flags(&self) -> [String; 2] {
        ["--backend".to_owned(), self.hardware.backend.to_string()]
    }

    /// A command for `memtransfer run` in the scratch folder, with the session's provider, a registry of its own and no
    /// settings from the environment.
    ///
    /// # Errors
    /// When it is not built.
    pub fn run_command(&self) -> Result<Command> {
        let mut command = Command::new(self.program("memtransfer")?);
        command.args(["run", "--provider", self.hardware.provider.word()]);
        // The cache folder belongs to the machine, not to the run.
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
}
