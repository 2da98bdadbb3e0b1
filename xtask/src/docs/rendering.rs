//! That a page of the built site has the text and the parts that it has on a code host. MkDocs reads a few texts otherwise: it wants
//! four spaces before a list in a list, an empty line before a list that follows a paragraph, and no `[a][b]` outside of code.

use super::markdown::{Markdown, Parts};

/// What to do about a difference.
const ADVICE: &str = "put an empty line before lists, tables and code, four spaces before what is in a list, and brackets into code";

/// The characters that pages name by an entity.
const ENTITIES: [(&str, &str); 5] =
    [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&#39;", "'"), ("&amp;", "&")];

/// What is different on the site's page, as a message; `None` if nothing is.
pub(super) fn difference(page: &Markdown, html: &str) -> Option<String> {
    let article = html.split_once("<article").and_then(|(_, rest)| rest.split_once('>'));
    let article = article.map_or("", |(_, rest)| rest);
    let article = article.split_once("</article>").map_or(article, |(article, _)| article);
    let (there, here) = (&page.parts, parts_of(article));
    let kinds = [
        ("headings", there.headings, here.headings),
        ("lists", there.lists, here.lists),
        ("list items", there.list_items, here.list_items),
        ("rows of tables", there.table_rows, here.table_rows),
        ("code blocks", there.code_blocks, here.code_blocks),
        ("images", there.images, here.images),
    ];
    let different = kinds.iter().filter(|(_, there, here)| there != here);
    let mut messages: Vec<String> = different
        .map(|(kind, there, here)| format!("{kind}: {there}, on the site {here}"))
        .collect();
    messages.extend(difference_of_letters(&page.letters, &letters_of(article)));
    (!messages.is_empty()).then(|| format!("{}; {ADVICE}", messages.join("; ")))
}

/// The parts of a page of the site.
fn parts_of(article: &str) -> Parts {
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

/// What a reader of the site's page sees, without spaces and without the links that the theme puts behind headings.
fn letters_of(article: &str) -> String {
    let mut letters = String::new();
    let mut texts = article.split('<');
    letters.extend(texts.next().unwrap_or_default().split_whitespace());
    for element in texts {
        let (tag, text) = element.split_once('>').unwrap_or((element, ""));
        if !tag.contains("headerlink") {
            letters.extend(text.split_whitespace());
        }
    }
    ENTITIES.iter().fold(letters, |letters, (entity, character)| letters.replace(entity, character))
}

/// Where two texts are different first, with what is around.
fn difference_of_letters(there: &str, here: &str) -> Option<String> {
    let same = there.chars().zip(here.chars()).take_while(|(a, b)| a == b).count();
    let around =
        |text: &str| text.chars().skip(same.saturating_sub(15)).take(40).collect::<String>();
    (there != here).then(|| format!("{:?} is {:?} on the site", around(there), around(here)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(markdown: &str, article: &str, expected: Option<&str>) {
        let html = format!("<li>around</li><article class=\"x\">{article}</article>");
        let found = difference(&Markdown::read(markdown), &html);
        assert_eq!(found, expected.map(|expected| format!("{expected}; {ADVICE}")), "{markdown}");
    }

    #[test]
    fn a_list_that_the_site_shows_as_text_is_noticed() {
        let page = "# A\n\nThese:\n- one\n- two\n\nAnd:\n\n    a < b\n";
        let head = "<h1 id=\"a\">A<a class=\"headerlink\" href=\"#a\">&para;</a></h1>";
        let end = "<p>And:</p><pre><code><span>a</span> &lt; b</code></pre>";
        let list = "<p>These:</p><ul><li>one</li><li>two</li></ul>";
        check(page, &format!("{head}{list}{end}"), None);
        let expected = "lists: 1, on the site 0; list items: 2, on the site 0; \
                        \"AThese:onetwoAnd:a<b\" is \"AThese:-one-twoAnd:a<b\" on the site";
        check(page, &format!("{head}<p>These: - one - two</p>{end}"), Some(expected));
    }

    #[test]
    fn a_text_that_the_site_changes_is_noticed() {
        check("R[j][k] is\n", "<p>R[j][k] is</p>", None);
        check(
            "R[j][k] is\n",
            "<p>R[j][] is</p>",
            Some("\"R[j][k]is\" is \"R[j][]is\" on the site"),
        );
    }
}
