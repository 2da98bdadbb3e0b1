//! The workspace: its root, cargo commands in it, and the programs built from it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};
use serde::de::DeserializeOwned;

use crate::cache::{self, Cache};

/// The crates whose programs a run needs.
pub(crate) const PROGRAMS: [&str; 4] = ["memtransfer", "sim-proc", "memory-proc", "policy-proc"];

/// The repository's root, and the cache folder that its programs use.
pub(crate) struct Workspace {
    root: PathBuf,
    cache: PathBuf,
}

impl Workspace {
    /// Finds the root: the parent of xtask's folder.
    pub(crate) fn locate(cache: &Cache) -> anyhow::Result<Self> {
        let xtask = std::env::var_os("CARGO_MANIFEST_DIR")
            .unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
        let root =
            Path::new(&xtask).parent().context("xtask has no parent folder; run `cargo xtask`")?;
        Ok(Self { root: root.to_owned(), cache: cache.root().to_owned() })
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// `cargo ARGUMENTS...` at the root, as if called directly: what the cargo that runs xtask says of xtask would make build
    /// scripts run again that look at it, and build again what depends on them.
    pub(crate) fn cargo(&self, arguments: &[&str]) -> Command {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = self.at_root(cargo.as_ref(), arguments);
        for (name, _) in std::env::vars_os() {
            let bytes = name.as_encoded_bytes();
            if bytes.starts_with(b"CARGO_PKG_") || bytes.starts_with(b"CARGO_MANIFEST_") {
                command.env_remove(name);
            }
        }
        command
    }

    /// The packages that `cargo metadata` lists with these flags.
    pub(crate) fn packages<P: DeserializeOwned>(&self, flags: &[&str]) -> anyhow::Result<Vec<P>> {
        #[derive(serde::Deserialize)]
        struct Metadata<P> {
            packages: Vec<P>,
        }
        let output = self
            .cargo(&["metadata", "--format-version", "1"])
            .args(flags)
            .output()
            .context("cannot start cargo metadata")?;
        if !output.status.success() {
            bail!("cargo metadata failed: {}", String::from_utf8_lossy(&output.stderr));
        }
        let metadata: Metadata<P> = serde_json::from_slice(&output.stdout)
            .context("cannot read cargo metadata's output")?;
        Ok(metadata.packages)
    }

    /// The files under version control that match any of the patterns, relative to the root; those that exist.
    pub(crate) fn tracked_files(&self, patterns: &[&str]) -> anyhow::Result<Vec<PathBuf>> {
        let output = self
            .at_root(Path::new("git"), &["ls-files", "-z", "--"])
            .args(patterns)
            .output()
            .context("cannot start git")?;
        if !output.status.success() {
            bail!("git ls-files failed: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        let listed =
            String::from_utf8(output.stdout).context("git printed a name that is not UTF-8")?;
        let paths = listed.split_terminator('\0').map(PathBuf::from);
        Ok(paths.filter(|path| self.root.join(path).exists()).collect())
    }

    /// Any program, run at the root with the cache folder in its environment.
    pub(crate) fn at_root(&self, program: &Path, arguments: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(&self.root).env(cache::VARIABLE, &self.cache);
        command
    }

    /// Builds `memtransfer`, the processes that it starts, and the programs of the crates `also`.
    pub(crate) fn build_programs(&self, also: &[&str]) -> anyhow::Result<bool> {
        self.build(also, &[])
    }

    /// As [`Self::build_programs`], for a first run: without the backend for graphics cards where there is none. One in seven
    /// packages are that backend's.
    pub(crate) fn build_programs_for_this_machine(&self) -> anyhow::Result<bool> {
        let flags: &[&str] = if has_graphics_device() { &[] } else { &["--no-default-features"] };
        self.build(&[], flags)
    }

    fn build(&self, also: &[&str], flags: &[&str]) -> anyhow::Result<bool> {
        eprintln!("building the programs");
        let mut command = self.cargo(&["build", "--release", "--bins"]);
        command.args(flags);
        for package in PROGRAMS.iter().chain(also) {
            command.args(["--package", package]);
        }
        succeeds(&mut command)
    }

    /// Builds the extension of the Python package and puts it into `python/memtransfer`, so that Python finds the
    /// package with `PYTHONPATH=python`.
    pub(crate) fn build_python_extension(&self) -> anyhow::Result<bool> {
        eprintln!("building the Python package's extension");
        let mut command = self.cargo(&["build", "--release", "--lib"]);
        // With the programs, so that shared dependencies keep the features that they are built with.
        for package in PROGRAMS.iter().chain(&["memtransfer-python"]) {
            command.args(["--package", package]);
        }
        if !succeeds(&mut command)? {
            return Ok(false);
        }
        let built = self.program("lib_native.so")?;
        let place = self.root.join("python/memtransfer/_native.abi3.so");
        // Renamed into place, so that a process that uses the present file is not disturbed.
        let draft = place.with_extension("new");
        std::fs::copy(&built, &draft)
            .and_then(|_| std::fs::rename(&draft, &place))
            .with_context(|| format!("cannot copy {} to {}", built.display(), place.display()))?;
        Ok(true)
    }

    /// The path of a program that [`Self::build_programs`] built: the folder of xtask itself.
    pub(crate) fn program(&self, name: &str) -> anyhow::Result<PathBuf> {
        Ok(std::env::current_exe().context("cannot find the path of xtask")?.with_file_name(name))
    }

    /// The folder of everything that is built, which may be elsewhere than here.
    pub(crate) fn target_folder(&self) -> anyhow::Result<PathBuf> {
        let program = self.program("xtask")?;
        let folder = program.parent().and_then(Path::parent);
        Ok(folder.context("the programs have no parent folder")?.to_owned())
    }
}

/// Whether the kernel offers a device that a Vulkan driver may use.
fn has_graphics_device() -> bool {
    let entries =
        ["/dev/dri", "/dev"].into_iter().filter_map(|folder| std::fs::read_dir(folder).ok());
    let names = entries.flatten().filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names
        .into_iter()
        .any(|name| name.starts_with("renderD") || name.starts_with("nvidia") || name == "dxg")
}

/// Runs a command with this process's streams. Returns whether it succeeded.
pub(crate) fn succeeds(command: &mut Command) -> anyhow::Result<bool> {
    let program = command.get_program().to_string_lossy().into_owned();
    Ok(command.status().with_context(|| format!("cannot start {program}"))?.success())
}
