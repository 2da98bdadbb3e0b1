//! A folder for the files of one input.

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::input::files;

thread_local! {
    static SCRATCH: RefCell<Option<TempDir>> = const { RefCell::new(None) };
}

/// Calls `read` with an empty folder.
pub(crate) fn with_folder(read: impl FnOnce(&Path)) {
    let folder: PathBuf = SCRATCH.with_borrow_mut(|scratch| {
        let dir = scratch.get_or_insert_with(|| tempfile::tempdir().unwrap());
        dir.path().join("input")
    });
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    fs::create_dir(&folder).unwrap();
    read(&folder);
}

/// Calls `read` with a folder that holds `given`, and of the files in `input` those with a name in `names`. A name that ends
/// in a slash stands for any plain name in that folder.
pub(crate) fn with_files(
    given: &[(&str, &[u8])],
    names: &[&str],
    input: &[u8],
    read: impl FnOnce(&Path),
) {
    let own: Vec<_> = files(input).into_iter().filter(|(name, _)| is_named(name, names)).collect();
    let is_replaced = |name: &str| own.iter().any(|(replaced, _)| *replaced == name);
    let kept = given.iter().filter(|(name, _)| !is_replaced(name));
    with_folder(|folder| {
        for (name, content) in kept.chain(&own) {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        read(folder);
    });
}

fn is_named(name: &str, names: &[&str]) -> bool {
    let is_plain = |rest: &str| {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'.' || byte == b'-';
        (1..64).contains(&rest.len()) && rest.bytes().all(plain) && !rest.starts_with('.')
    };
    names.iter().any(|known| match known.strip_suffix('/') {
        None => name == *known,
        Some(_) => name.strip_prefix(known).is_some_and(is_plain),
    })
}
