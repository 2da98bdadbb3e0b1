//! The site: copies of the pages, their links written for it, rendered by MkDocs.

use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, ensure};
use serde_json::json;

use super::links::{Documents, Fault, Target};
use super::navigation::Navigation;
use super::{commands, foreign, reference, rendering};
use crate::cache::{Cache, remove_folder};
use crate::pins::{Pins, Purpose};
use crate::setup;
use crate::workspace::{Workspace, succeeds};

/// The environment with MkDocs, a place of `setup.toml`.
const ENVIRONMENT: &str = "python-docs";

/// What does not depend on the pages, relative to the workspace.
const SETTINGS: &str = "xtask/site/mkdocs.yml";

/// Where the repository is published.
const REPOSITORY: &str = env!("CARGO_PKG_REPOSITORY");

/// Checks links and commands of all Markdown files, and that each page is in the navigation once. Prints the faults; returns
/// whether there was none.
pub(crate) fn check(workspace: &Workspace) -> anyhow::Result<bool> {
    Ok(read(workspace)?.is_some())
}

/// Checks the documents, builds the site into `target/site`, and prints where it is. Returns whether all is right.
pub(crate) fn build(pins: &Pins, cache: &Cache, workspace: &Workspace) -> anyhow::Result<bool> {
    let Some((documents, navigation)) = read(workspace)? else { return Ok(false) };
    setup::install_missing(Purpose::Only(ENVIRONMENT), pins, cache, workspace)?;

    let target = workspace.target_folder()?;
    let (sources, site) = (target.join("site-sources"), target.join("site"));
    remove_folder(&sources)?;
    let revision = revision(workspace)?;
    for path in &navigation.pages {
        let page =
            Copy { documents: &documents, navigation: &navigation, path, revision: &revision };
        let text = format!("{}{}", rank(path), page.text());
        write(&sources.join("pages").join(path), text.as_bytes())?;
        for image in page.images() {
            let bytes = fs::read(workspace.root().join(&image))
                .with_context(|| format!("cannot read {}", image.display()))?;
            write(&sources.join("pages").join(&image), &bytes)?;
        }
    }
    let reference = reference::pages(workspace)?;
    for page in &reference {
        write(&sources.join("pages").join(&page.path), page.text.as_bytes())?;
    }
    let mut entries = navigation.entries.clone();
    entries.push(reference::entry(&reference));
    let package = workspace.root().join(reference::PACKAGE);
    let settings = workspace.root().join(SETTINGS);
    let configuration = json!({
        "INHERIT": settings,
        "docs_dir": sources.join("pages"),
        "site_dir": site,
        "theme": { "custom_dir": settings.with_file_name("theme") },
        "nav": entries,
        "plugins": { "mkdocstrings": { "handlers": { "python": { "paths": [package.parent()] } } } },
    });
    // JSON is YAML.
    let configuration_path = sources.join("mkdocs.yml");
    write(&configuration_path, configuration.to_string().as_bytes())?;

    let mut mkdocs = workspace.at_root(
        &cache.root().join(ENVIRONMENT).join("bin/mkdocs"),
        &["build", "--strict", "--quiet", "--config-file"],
    );
    // An advertisement.
    mkdocs.arg(&configuration_path).env("NO_MKDOCS_2_WARNING", "1");
    if !succeeds(&mut mkdocs)? {
        return Ok(false);
    }
    let faults = faults(&documents, &navigation, &site)?;
    for fault in &faults {
        eprintln!("{fault}");
    }
    eprintln!("the site: {}", site.join("index.html").display());
    Ok(faults.is_empty())
}

/// The head of a copy that ranks the page in the search: what was decided or changed comes after what is.
fn rank(path: &Path) -> &'static str {
    if path.starts_with("docs/decisions") || path == Path::new("CHANGELOG.md") {
        "---\nsearch:\n  boost: 0.2\n---\n\n"
    } else {
        ""
    }
}

/// What is wrong in the built site.
fn faults(
    documents: &Documents,
    navigation: &Navigation,
    site: &Path,
) -> anyhow::Result<Vec<Fault>> {
    let of_site = foreign::loads(site)?.into_iter().map(|(path, load)| {
        let message = format!("the page loads from another host: {load}");
        Fault { path, line: 0, message }
    });
    let mut faults: Vec<Fault> = of_site.collect();
    for path in &navigation.pages {
        let Some(page) = documents.page(path) else { continue };
        let html = match path.ends_with("README.md") {
            true => site.join(path.with_file_name("index.html")),
            false => site.join(path.with_extension("html")),
        };
        let text =
            fs::read_to_string(&html).with_context(|| format!("cannot read {}", html.display()))?;
        if let Some(message) = rendering::difference(&page.markdown, &text) {
            faults.push(Fault { path: path.clone(), line: 0, message });
        }
    }
    Ok(faults)
}

/// Reads the documents; `None` where there are faults, which are printed.
fn read(workspace: &Workspace) -> anyhow::Result<Option<(Documents, Navigation)>> {
    let documents = Documents::load(workspace)?;
    let mut faults: Vec<Fault> = documents.broken_links();
    let (navigation, of_navigation) = Navigation::of(&documents);
    faults.extend(of_navigation);
    faults.extend(commands::refused(&documents, &workspace.packages(&["--no-deps"])?));
    for fault in &faults {
        eprintln!("{fault}");
    }
    Ok(faults.is_empty().then_some((documents, navigation)))
}

/// The commit that is checked out.
fn revision(workspace: &Workspace) -> anyhow::Result<String> {
    let output = workspace
        .at_root(Path::new("git"), &["rev-parse", "HEAD"])
        .output()
        .context("cannot start git")?;
    ensure!(
        output.status.success(),
        "git rev-parse failed: {}",
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Writes a file in a folder that need not exist.
fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let write = || {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(path, bytes)
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}

/// The site's copy of a page.
struct Copy<'a> {
    documents: &'a Documents,
    navigation: &'a Navigation,
    path: &'a Path,
    revision: &'a str,
}

impl Copy<'_> {
    /// The text of the page, in which links lead to pages of the site where there is one, and to the published repository
    /// otherwise.
    fn text(&self) -> String {
        let Some(page) = self.documents.page(self.path) else { return String::new() };
        let (mut text, mut copied) = (String::new(), 0);
        for link in &page.markdown.links {
            let Ok(target) = self.documents.target(self.path, link) else { continue };
            let anchor = link.target.find('#').map_or("", |at| &link.target[at..]);
            let address = match &target {
                Target::Elsewhere => continue,
                Target::File(path) if link.is_image || self.navigation.pages.contains(path) => {
                    relative(self.path, path) + anchor
                }
                Target::File(path) => {
                    format!("{REPOSITORY}/blob/{}/{}{anchor}", self.revision, path.display())
                }
                Target::Folder(path) => {
                    format!("{REPOSITORY}/tree/{}/{}", self.revision, path.display())
                }
            };
            text.push_str(&page.text[copied..link.range.start]);
            text.push_str(&address);
            copied = link.range.end;
        }
        text + &page.text[copied..]
    }

    /// The images that the page shows.
    fn images(&self) -> Vec<PathBuf> {
        let links =
            self.documents.page(self.path).into_iter().flat_map(|page| &page.markdown.links);
        let images = links.filter(|link| link.is_image).filter_map(|link| {
            match self.documents.target(self.path, link) {
                Ok(Target::File(path)) => Some(path),
                _ => None,
            }
        });
        images.collect()
    }
}

/// The address of `path` in a link of `page`.
fn relative(page: &Path, path: &Path) -> String {
    let folder: Vec<Component> =
        page.parent().map(Path::components).into_iter().flatten().collect();
    let path: Vec<Component> = path.components().collect();
    let common = folder.iter().zip(&path).take_while(|(a, b)| a == b).count();
    let mut address = "../".repeat(folder.len() - common);
    let names = path[common..].iter().map(|name| name.as_os_str().to_string_lossy());
    address.push_str(&names.collect::<Vec<_>>().join("/"));
    address
}

#[cfg(test)]
mod tests {
    use super::super::links::tests::documents;
    use super::*;

    #[test]
    fn links_of_a_copy_lead_to_pages_or_to_the_repository() {
        let text = "# A\n\n[1](b.md#b) [2](decisions/) [3](#a) [4](https://example.org) [5](../README.md)\n\
                    [6](../src/x.rs) [7](../src) ![8](images/x.png) [9](../crates/x/README.md#x)\n";
        let documents = documents(&[
            ("README.md", "# Front page\n"),
            ("docs/README.md", "## Pages\n\n[a](a.md) [b](b.md) [d](decisions/)\n"),
            ("docs/a.md", text),
            ("docs/b.md", "# B\n"),
            ("docs/decisions/README.md", "# Decisions\n"),
            ("docs/images/x.png", ""),
            ("crates/x/README.md", "# X\n"),
            ("src/x.rs", ""),
        ]);
        let (navigation, faults) = Navigation::of(&documents);
        assert_eq!((documents.broken_links(), faults), (Vec::new(), Vec::new()));
        let path = Path::new("docs/a.md");
        let copy = Copy { documents: &documents, navigation: &navigation, path, revision: "abc" };
        let expected = format!(
            "# A\n\n[1](b.md#b) [2](decisions/README.md) [3](a.md#a) [4](https://example.org) [5](../README.md)\n\
             [6]({REPOSITORY}/blob/abc/src/x.rs) [7]({REPOSITORY}/tree/abc/src) ![8](images/x.png) \
             [9]({REPOSITORY}/blob/abc/crates/x/README.md#x)\n",
        );
        assert_eq!(copy.text(), expected);
        assert_eq!(copy.images(), [PathBuf::from("docs/images/x.png")]);
    }
}
