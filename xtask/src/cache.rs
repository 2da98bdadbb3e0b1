//! The cache folder, where set-up installs the files that the programs need.
//!
//! `$MEMTRANSFER_CACHE`, else `$XDG_CACHE_HOME/memtransfer`, else `~/.cache/memtransfer`. `tmp/` holds unfinished files
//! and `wheels/` downloads; everything else is complete and verified, because it was moved into place.

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

    /// Locks the cache until the value is dropped, and empties `tmp/` of the remains of an interrupted set-up.
    pub(crate) fn lock(&self) -> anyhow::Result<LockedCache<'_>> {
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
        let locked = LockedCache { cache: self, _lock: file };
        locked.empty_tmp()?;
        Ok(locked)
    }
}

/// The cache folder, locked by this process.
pub(crate) struct LockedCache<'a> {
    cache: &'a Cache,
    _lock: File,
}

impl LockedCache<'_> {
    /// The absolute path of a path relative to the folder.
    pub(crate) fn place(&self, relative: &Path) -> PathBuf {
        self.cache.root.join(relative)
    }

    /// The folder for unfinished files, emptied when a set-up starts.
    pub(crate) fn tmp(&self) -> anyhow::Result<PathBuf> {
        self.folder("tmp")
    }

    /// The folder for downloaded wheels. A wheel placed here by hand is not downloaded.
    pub(crate) fn wheels(&self) -> anyhow::Result<PathBuf> {
        self.folder("wheels")
    }

    /// Moves a finished file into place atomically.
    pub(crate) fn finish(&self, from: &Path, to: &Path) -> anyhow::Result<()> {
        let rename = || -> io::Result<()> {
            if let Some(parent) = to.parent() {
                fs::create_dir_all(parent)?;
            }
            // After a power failure the name must not exist without its bytes.
            File::open(from)?.sync_all()?;
            fs::rename(from, to)
        };
        rename().with_context(|| format!("cannot move {} to {}", from.display(), to.display()))
    }

    /// Empties `tmp/` and removes `wheels/` when it is empty.
    pub(crate) fn tidy(&self) -> anyhow::Result<()> {
        self.empty_tmp()?;
        match fs::remove_dir(self.cache.root.join("wheels")) {
            Err(error)
                if !matches!(
                    error.kind(),
                    io::ErrorKind::NotFound | io::ErrorKind::DirectoryNotEmpty
                ) =>
            {
                Err(error).context("cannot remove the empty wheels folder")
            }
            _ => Ok(()),
        }
    }

    fn empty_tmp(&self) -> anyhow::Result<()> {
        let tmp = self.cache.root.join("tmp");
        match fs::remove_dir_all(&tmp) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot empty {}", tmp.display()))
            }
            _ => Ok(()),
        }
    }

    fn folder(&self, name: &str) -> anyhow::Result<PathBuf> {
        let path = self.cache.root.join(name);
        fs::create_dir_all(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok(path)
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

    #[test]
    fn locking_removes_what_an_interrupted_set_up_left() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache { root: folder.path().join("cache") };
        let half = cache.lock().unwrap().tmp().unwrap().join("half.whl");
        fs::write(&half, "half").unwrap();
        drop(cache.lock().unwrap());
        assert!(!half.exists());
    }
}
