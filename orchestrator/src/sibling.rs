//! The other programs: they lie beside this one.

use std::path::PathBuf;

use anyhow::{Context, ensure};

/// Where the program called `name` lies.
///
/// # Errors
/// When it is not beside this one.
pub fn sibling(name: &str) -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("cannot find out where this program lies")?;
    let path = own.with_file_name(name);
    ensure!(
        path.is_file(),
        "{name} is not beside {}: build it with `cargo build --release --workspace`",
        own.display()
    );
    Ok(path)
}
