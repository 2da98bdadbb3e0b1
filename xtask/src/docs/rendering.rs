//! That a page of the built site has the parts that it has on a code host. MkDocs reads a few texts otherwise: it wants four spaces
//! before a list in a list, and an empty line before a list that follows a paragraph.

use super::markdown::Parts;

/// What to do about a difference.
const ADVICE: &str =
    "put an empty line before lists, tables and code, and four spaces before what is in a list";

/// The kinds of which the site's page has more or fewer, as a message; `None` if there are none.
pub(super) fn difference(on_code_host: &Parts, html: &str) -> Option<String> {
    let on_site = parts_of(html);
    let kinds = [
        ("headings", on_code_host.headings, on_site.headings),
        ("lists", on_code_host.lists, on_site.lists),
        ("list items", on_code_host.list_items, on_site.list_items),
        ("rows of tables", on_code_host.table_rows, on_site.table_rows),
        ("code blocks", on_code_host.code_blocks, on_site.code_blocks),
        ("images", on_code_host.images, on_site.images),
    ];
    let different = kinds.iter().filter(|(_, there, here)| there != here);
    let messages: Vec<String> = different
        .map(|(kind, there, here)| format!("{kind}: {there}, on the site {here}"))
        .collect();
    (!messages.is_empty()).then(|| format!("{}; {ADVICE}", messages.join("; ")))
}

/// The parts of a page of the site, without what the theme puts around it.
fn parts_of(html: &str) -> Parts {
    let article = html.split_once("<article").map_or("", |(_, rest)| rest);
    let article = article.split_once("</article>").map_or(article, |(article, _)| article);
    let count = |element: &str| article.matches(element).count();
    Parts {
        headings: (1..=6).map(|level| count(&format!("<h{level} "))).sum(),
        lists: count("<ul>") + count("<ol>") + count("<ol "),
        list_items: count("<li>"),
        table_rows: count("<tr>"),
        code_blocks: count("<pre>"),
        images: count("<img "),
    }
}

#[cfg(test)]
mod tests {
    use super::super::markdown::Markdown;
    use super::*;

    #[test]
    fn a_list_that_the_site_shows_as_text_is_noticed() {
        let page = Markdown::read("# A\n\nThese:\n- one\n- two\n\nAnd:\n\n    code\n");
        let html = "<li>around</li><article><h1 id=\"a\">A</h1><p>These: - one - two</p><p>And:</p><pre>code</pre></article>";
        let expected = format!("lists: 1, on the site 0; list items: 2, on the site 0; {ADVICE}");
        assert_eq!(difference(&page.parts, html), Some(expected));
        let html = "<article><h1 id=\"a\">A</h1><ul><li>one</li><li>two</li></ul><pre>code</pre></article>";
        assert_eq!(difference(&page.parts, html), None);
    }
}
