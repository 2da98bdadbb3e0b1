//! Citations of the specification in code comments, checked against the headings of `docs/specification.md`.

use std::collections::BTreeSet;
use std::fs;

use anyhow::Context;

use crate::workspace::Workspace;

/// The page that is cited.
const PAGE: &str = "docs/specification.md";

/// What a citation starts with; numbers follow: `section 4`, `sections 2 and 4`, `sections 2 to 4`.
const CITATION: &str = "specification, section";

/// Prints every citation of a section that the page does not have. Returns whether there was none.
pub(crate) fn resolve(workspace: &Workspace) -> anyhow::Result<bool> {
    let page = workspace.root().join(PAGE);
    let text = fs::read_to_string(&page).with_context(|| format!("cannot read {PAGE}"))?;
    let sections = sections(&text);
    let mut resolved = true;
    for path in workspace.tracked_files(&["*.rs", "*.py"])? {
        let path = workspace.root().join(path);
        let source =
            fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        for number in cited(&source).difference(&sections) {
            eprintln!("{}: cites section {number}, which {PAGE} does not have", path.display());
            resolved = false;
        }
    }
    Ok(resolved)
}

/// The numbers of the page's second-level headings, `## 4. Trajectories`.
fn sections(page: &str) -> BTreeSet<u32> {
    let headings = page.lines().filter_map(|line| line.strip_prefix("## "));
    headings.filter_map(|heading| heading.split_once('.')?.0.parse().ok()).collect()
}

/// The section numbers that a source cites. A citation may be broken over two comment lines.
fn cited(source: &str) -> BTreeSet<u32> {
    let joined: Vec<&str> = source
        .split_whitespace()
        .filter(|word| !matches!(*word, "//" | "///" | "//!" | "#"))
        .collect();
    let text = joined.join(" ");
    let mut numbers = BTreeSet::new();
    for (at, _) in text.match_indices(CITATION) {
        let mut from = None;
        for word in text[at + CITATION.len()..].trim_start_matches('s').split_whitespace() {
            let digits = word.trim_matches(|c: char| !c.is_ascii_digit());
            match (digits.parse::<u32>(), word) {
                (Ok(number), _) => {
                    numbers.extend(from.take().unwrap_or(number)..=number);
                    from = Some(number);
                    if word.ends_with(|c: char| !c.is_ascii_digit() && c != ',') {
                        break;
                    }
                }
                (Err(_), "to") => {}
                (Err(_), "and") => from = None,
                (Err(_), _) => break,
            }
        }
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_of_citation_is_read() {
        let check = |source: &str, expected: &[u32]| {
            assert_eq!(cited(source), expected.iter().copied().collect(), "{source}");
        };
        check("/// Success rate (specification, section 7).", &[7]);
        check("//! See the specification, sections 2 and 4.", &[2, 4]);
        check("(specification, sections 2 to 4 and 6)", &[2, 3, 4, 6]);
        check("/// (specification,\n/// section 5): 40 keyframes", &[5]);
        check("specification, section 3, of 10 types", &[3]);
        check("the specification in general", &[]);
    }

    #[test]
    fn headings_with_a_number_are_sections() {
        let page = "# Specification\n\n## 1. The question\n\n## 2. World\n\n## Notes\n";
        assert_eq!(sections(page), [1, 2].into());
    }
}
