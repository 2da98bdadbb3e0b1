//! The cache folder: models from set-up, and results that later runs reuse. Folders that other users cannot read.

use std::ffi::OsString;
use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// The place of ONNX Runtime's library in the cache folder.
pub const RUNTIME_FILE: &str = "onnxruntime/libonnxruntime.so";

/// The variable that names a library of the user's own instead.
pub const RUNTIME_VARIABLE: &str = "MEMTRANSFER_ONNXRUNTIME";

/// SHA-256 of the libraries that set-up puts there, one for each platform. The library is code that a process loads, so one in
/// the cache folder with another hash is not used, and no plan brings one.
pub const RUNTIME_SHA256: &[&str] =
    &["ad9665887025474170d3e71cd28021e7e811c5bf201bc365f953e34a2c4989cc"];

/// The environment names no cache folder.
#[derive(Debug, thiserror::Error)]
#[error(
    "no cache folder: none of MEMTRANSFER_CACHE, XDG_CACHE_HOME and HOME is set; set MEMTRANSFER_CACHE to a folder"
)]
pub struct NoCacheFolder;

/// The folder that the environment names: `$MEMTRANSFER_CACHE`, else `$XDG_CACHE_HOME/memtransfer`, else
/// `~/.cache/memtransfer`. It need not exist.
///
/// # Errors
/// When none of the three variables is set.
pub fn cache_folder() -> Result<PathBuf, NoCacheFolder> {
    folder(|name| std::env::var_os(name))
}

/// Creates a folder, and those above it that are missing, for the eyes of this user alone: for prompts, replies and what
/// programs print. One that exists stays as it is.
///
/// # Errors
/// When the system refuses.
pub fn create_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(path)
}

fn folder(variable: impl Fn(&str) -> Option<OsString>) -> Result<PathBuf, NoCacheFolder> {
    let set = |name| variable(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    set("MEMTRANSFER_CACHE")
        .or_else(|| Some(set("XDG_CACHE_HOME")?.join("memtransfer")))
        .or_else(|| Some(set("HOME")?.join(".cache").join("memtransfer")))
        .ok_or(NoCacheFolder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_runtimes_are_those_that_set_up_fetches() {
        let pins = include_str!("../../../xtask/setup.toml");
        let place = format!("place = \"{RUNTIME_FILE}\"");
        let entry = pins.split("[[file]]").find(|entry| entry.contains(&place)).unwrap();
        let line = entry.lines().find(|line| line.starts_with("sha256 = ")).unwrap();
        let hashes: Vec<&str> = line.split('"').skip(1).step_by(2).collect();
        assert_eq!(hashes, RUNTIME_SHA256);
    }

    #[test]
    fn the_first_variable_that_is_set_decides() {
        let all = [("MEMTRANSFER_CACHE", "/a"), ("XDG_CACHE_HOME", "/b"), ("HOME", "/c")];
        let named = |set: &[(&str, &str)]| {
            folder(|name| set.iter().find(|(set, _)| *set == name).map(|(_, value)| value.into()))
        };
        assert_eq!(named(&all).unwrap(), PathBuf::from("/a"));
        assert_eq!(named(&all[1..]).unwrap(), PathBuf::from("/b/memtransfer"));
        assert_eq!(named(&all[2..]).unwrap(), PathBuf::from("/c/.cache/memtransfer"));
        assert_eq!(
            named(&[("MEMTRANSFER_CACHE", ""), all[1]]).unwrap(),
            PathBuf::from("/b/memtransfer")
        );
        assert!(named(&[]).is_err());
    }
}
