//! `docs`: the documents as a site, which MkDocs checks and builds. `xtask/site` has its settings.

use crate::cache::Cache;
use crate::pins::{Pins, Purpose};
use crate::setup;
use crate::workspace::{Workspace, succeeds};

/// The environment with MkDocs, a place of `setup.toml`.
const ENVIRONMENT: &str = "python-docs";

/// Checks the documents, builds the site into `target/site`, and prints where it is. Returns whether all is right.
pub(crate) fn build(pins: &Pins, cache: &Cache, workspace: &Workspace) -> anyhow::Result<bool> {
    setup::install_missing(Purpose::Only(ENVIRONMENT), pins, cache, workspace)?;
    let site = workspace.target_folder()?.join("site");
    let mut mkdocs = workspace.at_root(
        &cache.root().join(ENVIRONMENT).join("bin/mkdocs"),
        // Not `--quiet`: MkDocs would count no warnings.
        &["build", "--strict", "--config-file", "xtask/site/mkdocs.yml", "--site-dir"],
    );
    // An advertisement.
    mkdocs.arg(&site).env("NO_MKDOCS_2_WARNING", "1");
    let right = succeeds(&mut mkdocs)?;
    if right {
        eprintln!("the site: {}", site.join("index.html").display());
    }
    Ok(right)
}
