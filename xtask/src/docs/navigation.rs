//! The navigation of the site: the pages that `docs/README.md` links, in its order and under its headings.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::links::{Documents, Fault, Target};

/// The front page.
const FRONT: &str = "README.md";

/// The page that lists the others.
const LIST: &str = "docs/README.md";

/// Where Markdown files are about the code beside them, and no pages of the site.
const NO_PAGES: &str = "crates";

/// The pages of the site, and how they are grouped.
pub(super) struct Navigation {
    /// As MkDocs takes it: paths, and lists of them by heading.
    pub(super) entries: Vec<Value>,
    pub(super) pages: BTreeSet<PathBuf>,
}

impl Navigation {
    /// Collects the pages, and finds those that are missing or there twice.
    pub(super) fn of(documents: &Documents) -> (Self, Vec<Fault>) {
        let mut collector =
            Collector { documents, pages: [FRONT.into(), LIST.into()].into(), faults: Vec::new() };
        let mut entries = vec![json!(FRONT), json!(LIST)];
        let headings = documents
            .page(Path::new(LIST))
            .into_iter()
            .flat_map(|page| page.markdown.headings.iter().filter(|heading| heading.level == 2));
        let headings: Vec<_> = headings.collect();
        for (at, heading) in headings.iter().enumerate() {
            let end = headings.get(at + 1).map_or(usize::MAX, |next| next.line);
            let pages = collector.linked(Path::new(LIST), Path::new(""), heading.line..end);
            entries.push(json!({ &heading.text: pages }));
        }
        let Collector { pages, mut faults, .. } = collector;
        for (path, _) in documents.pages() {
            if !path.starts_with(NO_PAGES) && !pages.contains(path) {
                let message = format!("not in the navigation: link it under a heading of {LIST}");
                faults.push(Fault { path: path.to_owned(), line: 0, message });
            }
        }
        (Self { entries, pages }, faults)
    }
}

/// What was collected so far.
struct Collector<'a> {
    documents: &'a Documents,
    pages: BTreeSet<PathBuf>,
    faults: Vec<Fault>,
}

impl Collector<'_> {
    /// The entries of the pages in `folder` that `list` links in these lines. A link to a heading is no entry: it leads into a
    /// page that has one.
    fn linked(&mut self, list: &Path, folder: &Path, lines: Range<usize>) -> Vec<Value> {
        let documents = self.documents;
        let links = documents.page(list).into_iter().flat_map(|page| &page.markdown.links);
        let mut entries = Vec::new();
        for link in links.filter(|it| lines.contains(&it.line) && !it.target.contains('#')) {
            let Ok(Target::File(path)) = documents.target(list, link) else { continue };
            if documents.page(&path).is_none() || !path.starts_with(folder) {
                continue;
            }
            if self.pages.insert(path.clone()) {
                entries.push(self.entry(&path));
            } else {
                let message = format!("{} is in the navigation twice", path.display());
                self.faults.push(Fault { path: list.to_owned(), line: link.line, message });
            }
        }
        entries
    }

    /// The entry of a page; of a README, with the pages of its folder that it links.
    fn entry(&mut self, path: &Path) -> Value {
        let mut within = match (path.file_name(), path.parent()) {
            (Some(name), Some(folder)) if name == "README.md" => {
                self.linked(path, folder, 0..usize::MAX)
            }
            _ => Vec::new(),
        };
        if within.is_empty() {
            return json!(path);
        }
        let headings = self.documents.page(path).map(|page| &page.markdown.headings);
        let title = headings.and_then(|headings| Some(headings.first()?.text.as_str()));
        within.insert(0, json!(path));
        json!({ title.unwrap_or_default(): within })
    }
}

#[cfg(test)]
mod tests {
    use super::super::links::tests::documents;
    use super::*;

    const PAGES: [(&str, &str); 6] = [
        ("README.md", "# Front page\n"),
        ("docs/a.md", "# A\n\n## Terms\n"),
        ("docs/b.md", "# B\n"),
        ("docs/decisions/README.md", "# Decisions\n\n1. [One](one.md)\n2. [A](../a.md)\n"),
        ("docs/decisions/one.md", "# One\n"),
        ("crates/prompt/README.md", "# Cases\n"),
    ];

    /// The navigation and the faults where the list has this text.
    fn check(list: &str) -> (Value, Vec<String>) {
        let documents = documents(&[&PAGES[..], &[("docs/README.md", list)]].concat());
        let (navigation, faults) = Navigation::of(&documents);
        (navigation.entries.into(), faults.iter().map(Fault::to_string).collect())
    }

    #[test]
    fn pages_are_grouped_as_the_list_has_them() {
        let (entries, faults) = check(
            "# Documentation\n\n[front](../README.md)\n\n## Running\n\n[b](b.md)\n\n## Code\n\n\
             [a](a.md), its [terms](a.md#terms), [decisions](decisions/)\n",
        );
        assert_eq!(faults, <[String; 0]>::default());
        let decisions = json!(["docs/decisions/README.md", "docs/decisions/one.md"]);
        let expected = json!([
            "README.md",
            "docs/README.md",
            { "Running": ["docs/b.md"] },
            { "Code": ["docs/a.md", { "Decisions": decisions }] },
        ]);
        assert_eq!(entries, expected);
    }

    #[test]
    fn a_page_that_is_missing_or_there_twice_is_named() {
        let (_, faults) = check("## Running\n\n[a](a.md) [d](decisions/)\n[again](a.md)\n");
        let expected = [
            "docs/README.md:4: docs/a.md is in the navigation twice",
            "docs/b.md: not in the navigation: link it under a heading of docs/README.md",
        ];
        assert_eq!(faults, expected);
    }
}
