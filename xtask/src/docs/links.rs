//! Links between files of the repository: each names a file or folder under version control, and a heading of it.
//!
//! Addresses elsewhere are not fetched.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::Context;

use super::markdown::{Link, Markdown};
use crate::workspace::Workspace;

/// The template of `docs/wire.md`, whose links are those of that page.
const TEMPLATE: &str = "shm-types/examples/wire/wire.md";

/// All Markdown files, and what they may link to. Paths are relative to the root.
pub(super) struct Documents {
    pages: BTreeMap<PathBuf, Page>,
    files: BTreeSet<PathBuf>,
    folders: BTreeSet<PathBuf>,
}

/// A Markdown file.
pub(super) struct Page {
    pub(super) text: String,
    pub(super) markdown: Markdown,
}

/// What a link leads to.
#[derive(PartialEq, Eq, Debug)]
pub(super) enum Target {
    /// An address on another host.
    Elsewhere,
    /// A file; of a folder that has a README, the README.
    File(PathBuf),
    /// A folder without a README; empty for the root.
    Folder(PathBuf),
}

/// What is wrong in a file, and where.
#[derive(PartialEq, Eq, Debug)]
pub(super) struct Fault {
    pub(super) path: PathBuf,
    /// 0: the whole file.
    pub(super) line: usize,
    pub(super) message: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, line, message } = self;
        match line {
            0 => write!(formatter, "{}: {message}", path.display()),
            line => write!(formatter, "{}:{line}: {message}", path.display()),
        }
    }
}

impl Documents {
    /// Reads the Markdown files under version control.
    pub(super) fn load(workspace: &Workspace) -> anyhow::Result<Self> {
        Self::read(workspace.root(), workspace.tracked_files(&[])?)
    }

    /// Reads the Markdown files among `files` of the folder `root`.
    pub(super) fn read(root: &Path, files: Vec<PathBuf>) -> anyhow::Result<Self> {
        let files: BTreeSet<PathBuf> = files.into_iter().collect();
        let folders = files.iter().flat_map(|file| file.ancestors().skip(1).map(Path::to_owned));
        let mut documents =
            Self { pages: BTreeMap::new(), folders: folders.collect(), files: files.clone() };
        for path in files {
            if path.extension().is_some_and(|extension| extension == "md")
                && path != Path::new(TEMPLATE)
            {
                let text = fs::read_to_string(root.join(&path))
                    .with_context(|| format!("cannot read {}", path.display()))?;
                let markdown = Markdown::read(&text);
                documents.pages.insert(path, Page { text, markdown });
            }
        }
        Ok(documents)
    }

    pub(super) fn pages(&self) -> impl Iterator<Item = (&Path, &Page)> {
        self.pages.iter().map(|(path, page)| (path.as_path(), page))
    }

    pub(super) fn page(&self, path: &Path) -> Option<&Page> {
        self.pages.get(path)
    }

    /// Every link that leads nowhere.
    pub(super) fn broken_links(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (path, page) in self.pages() {
            let broken = page.markdown.links.iter().filter_map(|link| {
                let reason = self.target(path, link).err()?;
                Some((link.line, format!("the link to {} is broken: {reason}", link.target)))
            });
            let unread = page.markdown.unread.iter().map(|line| {
                (*line, "write the link as [text](target): no other form is checked".to_owned())
            });
            let messages = broken.chain(unread);
            faults.extend(messages.map(|(line, message)| {
                let path = path.to_owned();
                Fault { path, line, message }
            }));
        }
        faults
    }

    /// What a link of a page leads to, or the reason why it leads nowhere.
    pub(super) fn target(&self, page: &Path, link: &Link) -> Result<Target, String> {
        let (path, anchor) = link.target.split_once('#').unwrap_or((&link.target, ""));
        if path.split_once(':').is_some_and(|(scheme, _)| !scheme.contains('/')) {
            return Ok(Target::Elsewhere);
        }
        let target = match path {
            "" => Target::File(page.to_owned()),
            path => self.at(page, path)?,
        };
        match &target {
            _ if anchor.is_empty() => Ok(target),
            Target::File(path) if let Some(page) = self.pages.get(path) => {
                if page.markdown.has_anchor(anchor) {
                    Ok(target)
                } else {
                    Err(format!("{} has no heading #{anchor}", path.display()))
                }
            }
            _ => Err("only Markdown files have headings".to_owned()),
        }
    }

    /// The file or folder at `path`, which is relative to the page.
    fn at(&self, page: &Path, path: &str) -> Result<Target, String> {
        let mut found = page.parent().unwrap_or(Path::new("")).to_owned();
        for component in Path::new(path).components() {
            match component {
                Component::Normal(name) => found.push(name),
                Component::CurDir => {}
                Component::ParentDir if found.pop() => {}
                _ => return Err("it leaves the repository".to_owned()),
            }
        }
        if self.files.contains(&found) {
            return Ok(Target::File(found));
        }
        if !self.folders.contains(&found) {
            return Err(format!("no file under version control is at {}", found.display()));
        }
        let readme = found.join("README.md");
        Ok(if self.pages.contains_key(&readme) {
            Target::File(readme)
        } else {
            Target::Folder(found)
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Documents of these files and texts.
    pub(crate) fn documents(files: &[(&str, &str)]) -> Documents {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let paths = files.iter().map(|(path, _)| path.into()).collect();
        Documents::read(root.path(), paths).unwrap()
    }

    /// The faults of a page `docs/a.md` with this text, beside others.
    fn faults_of(text: &str) -> Vec<String> {
        let documents = documents(&[
            ("README.md", "# Front page\n\n## Quick start\n"),
            ("docs/a.md", text),
            ("docs/b.md", "# B\n\n## Part `x`\n"),
            ("docs/decisions/README.md", "# Decisions\n"),
            ("assets/models.toml", ""),
        ]);
        documents.broken_links().iter().map(Fault::to_string).collect()
    }

    #[test]
    fn links_that_lead_somewhere_have_no_fault() {
        let text = "# A\n\n[1](b.md) [2](./b.md#part-x) [3](../README.md#quick-start) [4](#a) [5](decisions/)\n\
                    [6](decisions#decisions) [7](../assets) [8](../assets/models.toml) [9](..)\n\
                    [10](https://example.org/a.md#x) [11](mailto:a@example.org)\n";
        assert_eq!(faults_of(text), <[String; 0]>::default());
    }

    #[test]
    fn a_broken_link_is_named_with_file_line_and_target() {
        let text = "# A\n\nSee [this](b.md) and\n[that](c.md), or ![it](images/none.png).\n";
        let expected = [
            "docs/a.md:4: the link to c.md is broken: no file under version control is at docs/c.md",
            "docs/a.md:4: the link to images/none.png is broken: no file under version control is at docs/images/none.png",
        ];
        assert_eq!(faults_of(text), expected);
    }

    #[test]
    fn a_broken_anchor_is_named_with_file_line_and_target() {
        let text = "# A\n\n[1](b.md#part-y)\n[2](#b)\n[3](../assets/models.toml#L1)\n";
        let expected = [
            "docs/a.md:3: the link to b.md#part-y is broken: docs/b.md has no heading #part-y",
            "docs/a.md:4: the link to #b is broken: docs/a.md has no heading #b",
            "docs/a.md:5: the link to ../assets/models.toml#L1 is broken: only Markdown files have headings",
        ];
        assert_eq!(faults_of(text), expected);
    }

    #[test]
    fn links_out_of_the_repository_are_faults() {
        for target in ["../../other/README.md", "/README.md"] {
            let expected =
                format!("docs/a.md:1: the link to {target} is broken: it leaves the repository");
            assert_eq!(faults_of(&format!("[1]({target})\n")), [expected]);
        }
    }

    #[test]
    fn links_in_another_form_are_faults() {
        let expected = "docs/a.md:1: write the link as [text](target): no other form is checked";
        assert_eq!(faults_of("<img src=\"images/none.png\">\n"), [expected]);
    }
}
