//! What the pages of a built site load from other hosts. Links that a reader follows are no loads.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

/// Elements that load what an attribute of theirs names.
const ELEMENTS: [&str; 9] =
    ["<script", "<link", "<img", "<iframe", "<source", "<video", "<audio", "<object", "<embed"];

/// Every load of a page or style sheet in `folder`, with the file, in the order of their names.
pub(super) fn loads(folder: &Path) -> anyhow::Result<Vec<(PathBuf, String)>> {
    let mut entries = fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, _>>())
        .with_context(|| format!("cannot read {}", folder.display()))?;
    entries.sort();
    let mut found = Vec::new();
    for path in entries {
        if path.is_dir() {
            found.extend(loads(&path)?);
            continue;
        }
        let of_text = match path.extension().and_then(|extension| extension.to_str()) {
            Some("html") => of_page,
            Some("css") => of_styles,
            _ => continue,
        };
        let text =
            fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        found.extend(of_text(&text).into_iter().map(|load| (path.clone(), load)));
    }
    Ok(found)
}

/// The elements of a page that load from another host, and what its styles load.
fn of_page(html: &str) -> Vec<String> {
    let elements = html.match_indices('<').filter_map(|(at, _)| {
        let element = html[at..].split_inclusive('>').next()?;
        ELEMENTS.iter().any(|name| element.starts_with(name)).then_some(element)
    });
    let foreign = elements.filter(|element| {
        ["src", "href", "data", "srcset", "poster"].iter().any(|name| {
            ["http:", "https:", "//"].iter().any(|start| {
                [format!("{name}={start}"), format!("{name}=\"{start}")]
                    .iter()
                    .any(|attribute| element.contains(attribute.as_str()))
            })
        })
    });
    foreign.map(str::to_owned).chain(of_styles(html)).collect()
}

/// The functions and rules of style sheets that load from another host.
fn of_styles(css: &str) -> Vec<String> {
    let starts = css.match_indices("url(").chain(css.match_indices("@import"));
    let arguments = starts.map(|(at, start)| (at, css[at + start.len()..].trim_start()));
    let foreign = arguments.filter(|(_, argument)| {
        let address = argument.trim_start_matches(['"', '\'']);
        ["http:", "https:", "//"].iter().any(|start| address.starts_with(start))
    });
    foreign
        .map(|(at, _)| css[at..].chars().take_while(|c| !matches!(c, ')' | ';')).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loads_from_other_hosts_are_found() {
        let html = "<a href=\"https://example.org\">x</a><img src=\"a.png\"><script src=\"https://example.org/a.js\"></script>\
                    <link rel=stylesheet href=//example.org/a.css><style>p{background:url(https://example.org/b.png)}</style>";
        let expected = [
            "<script src=\"https://example.org/a.js\">",
            "<link rel=stylesheet href=//example.org/a.css>",
            "url(https://example.org/b.png",
        ];
        assert_eq!(of_page(html), expected);
        let css = "@import 'http://example.org/a.css';p{src:url(data:font/woff2;base64,AA)}q{src:url(\"//example.org/f\")}";
        assert_eq!(
            of_styles(css),
            ["url(\"//example.org/f\"", "@import 'http://example.org/a.css'"]
        );
    }
}
