//! The cache folder, where set-up installs the files that the programs need.
//!
//! `$MEMTRANSFER_CACHE`, else `$XDG_CACHE_HOME/memtransfer`, else `~/.cache/memtransfer`. `tmp/` holds unfinished files and
//! is emptied by every set-up.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

/// The environment variable that names the folder, also for the programs.
pub(crate) const VARIABLE: &str = "MEMTRANSFER_CACHE";

/// The path of the cache folder, which need not exist.
pub(crate) struct Cache {
    root: PathBuf,
}

impl Cache {
    /// Determines the path from the environment.
    pub(crate) fn locate() -> anyhow::Result<Self> {
        let root = root_from(|name| std::env::var_os(name).filter(|value| !value.is_empty()))?;
        let root = std::path::absolute(&root)
            .with_context(|| format!("cannot resolve {}", root.display()))?;
        Ok(Self { root })
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// Locks the cache until the file is dropped, and empties `tmp/` of the remains of an interrupted set-up.
    pub(crate) fn lock(&self) -> anyhow::Result<File> {
        let open = || -> io::Result<File> {
            fs::create_dir_all(&self.root)?;
            File::options().create(true).truncate(false).write(true).open(self.root.join(".lock"))
        };
        let file = open().with_context(|| {
            format!(
                "cannot write the cache folder {}; set {VARIABLE} to one that can be written",
                self.root.display()
            )
        })?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                eprintln!("set-up: waiting for another set-up in {}", self.root.display());
                file.lock().context("cannot wait for the other set-up")?;
            }
            Err(TryLockError::Error(error)) => {
                return Err(error).context("cannot lock the cache folder");
            }
        }
        self.empty_tmp()?;
        Ok(file)
    }

    /// The folder for unfinished files, which exists afterwards.
    pub(crate) fn tmp(&self) -> anyhow::Result<PathBuf> {
        let tmp = self.root.join("tmp");
        fs::create_dir_all(&tmp).with_context(|| format!("cannot create {}", tmp.display()))?;
        Ok(tmp)
    }

    /// Removes `tmp/`.
    pub(crate) fn empty_tmp(&self) -> anyhow::Result<()> {
        remove_folder(&self.root.join("tmp"))
    }
}

/// Removes a folder with all that is in it, if it exists.
pub(crate) fn remove_folder(path: &Path) -> anyhow::Result<()> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

fn root_from(variable: impl Fn(&str) -> Option<OsString>) -> anyhow::Result<PathBuf> {
    if let Some(folder) = variable(VARIABLE) {
        Ok(folder.into())
    } else if let Some(folder) = variable("XDG_CACHE_HOME") {
        Ok(Path::new(&folder).join("memtransfer"))
    } else if let Some(home) = variable("HOME") {
        Ok(Path::new(&home).join(".cache/memtransfer"))
    } else {
        bail!("cannot determine the cache folder: set {VARIABLE}, XDG_CACHE_HOME or HOME")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_variable_that_is_set_names_the_folder() {
        let check = |variables: &[(&str, &str)], expected: Option<&str>| {
            let variable = |name: &str| {
                variables.iter().find(|(known, _)| *known == name).map(|(_, value)| value.into())
            };
            assert_eq!(root_from(variable).ok(), expected.map(PathBuf::from), "{variables:?}");
        };
        let all = [("MEMTRANSFER_CACHE", "/a"), ("XDG_CACHE_HOME", "/b"), ("HOME", "/c")];
        check(&all, Some("/a"));
        check(&all[1..], Some("/b/memtransfer"));
        check(&all[2..], Some("/c/.cache/memtransfer"));
        check(&[], None);
    }
}
