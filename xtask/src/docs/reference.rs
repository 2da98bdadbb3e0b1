//! The Python package's reference: a page for each module, made from its docstrings.

use std::path::Path;

use serde_json::{Value, json};

use crate::workspace::Workspace;

/// The folder of the package.
pub(super) const PACKAGE: &str = "python/memtransfer";

/// A page that the repository does not have.
pub(super) struct ReferencePage {
    /// Relative to the site's folder of pages.
    pub(super) path: String,
    pub(super) text: String,
}

/// The pages: that of the package, then those of its modules by name. A module whose name begins with an underscore has none.
pub(super) fn pages(workspace: &Workspace) -> anyhow::Result<Vec<ReferencePage>> {
    let files = workspace.tracked_files(&["python/memtransfer/*.py"])?;
    let modules = files.iter().filter_map(|path| {
        let name = path.file_stem()?.to_str()?;
        (path.parent() == Some(Path::new(PACKAGE)) && !name.starts_with('_')).then_some(name)
    });
    // Every other name of the package is of a module.
    let package = page("memtransfer", "    options:\n      members: [Frame]\n");
    let modules = modules.map(|name| page(&format!("memtransfer.{name}"), ""));
    Ok(std::iter::once(package).chain(modules).collect())
}

fn page(name: &str, options: &str) -> ReferencePage {
    ReferencePage {
        path: format!("python/reference/{name}.md"),
        text: format!("# {name}\n\n::: {name}\n{options}"),
    }
}

/// Their entry in the navigation.
pub(super) fn entry(pages: &[ReferencePage]) -> Value {
    let paths: Vec<&str> = pages.iter().map(|page| page.path.as_str()).collect();
    json!({ "Python reference": paths })
}
