//! What a Markdown page has: links, images and headings, read as a code host does (CommonMark with GitHub's tables).

use std::ops::Range;

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

/// A page's links and headings, in the order of the text.
#[derive(Default)]
pub(super) struct Markdown {
    pub(super) links: Vec<Link>,
    pub(super) headings: Vec<Heading>,
    pub(super) parts: Parts,
    /// Lines with links that are not read: those of HTML, and those whose target is not written beside them.
    pub(super) unread: Vec<usize>,
}

/// How many parts of each kind a text has.
#[derive(Default, PartialEq, Eq, Debug)]
pub(super) struct Parts {
    pub(super) headings: usize,
    pub(super) lists: usize,
    pub(super) list_items: usize,
    pub(super) table_rows: usize,
    pub(super) code_blocks: usize,
    pub(super) images: usize,
}

/// A link or an image.
pub(super) struct Link {
    pub(super) target: String,
    pub(super) is_image: bool,
    /// From 1.
    pub(super) line: usize,
    /// The bytes of `target` in the text.
    pub(super) range: Range<usize>,
}

/// A heading.
pub(super) struct Heading {
    /// 1 for `#`.
    pub(super) level: usize,
    pub(super) text: String,
    /// What follows `#` in a link to it. Of two headings with the same text, code hosts and site generators number the second
    /// differently, so that only the first can be linked.
    pub(super) anchor: String,
    pub(super) line: usize,
}

impl Markdown {
    pub(super) fn read(text: &str) -> Self {
        let line_of = |at: usize| text[..at].matches('\n').count() + 1;
        let mut page = Self::default();
        let mut heading: Option<String> = None;
        for (event, range) in Parser::new_ext(text, Options::ENABLE_TABLES).into_offset_iter() {
            match &event {
                Event::Start(Tag::Heading { .. }) => page.parts.headings += 1,
                Event::Start(Tag::List(_)) => page.parts.lists += 1,
                Event::Start(Tag::Item) => page.parts.list_items += 1,
                Event::Start(Tag::TableHead | Tag::TableRow) => page.parts.table_rows += 1,
                Event::Start(Tag::CodeBlock(_)) => page.parts.code_blocks += 1,
                Event::Start(Tag::Image { .. }) => page.parts.images += 1,
                _ => {}
            }
            match event {
                Event::Start(
                    ref tag @ (Tag::Link { ref dest_url, .. } | Tag::Image { ref dest_url, .. }),
                ) => match text[range.clone()].rfind(&**dest_url) {
                    Some(at) => page.links.push(Link {
                        target: dest_url.to_string(),
                        is_image: matches!(tag, Tag::Image { .. }),
                        line: line_of(range.start + at),
                        range: range.start + at..range.start + at + dest_url.len(),
                    }),
                    None => page.unread.push(line_of(range.start)),
                },
                Event::Html(html) | Event::InlineHtml(html)
                    if html.contains("href=") || html.contains("src=") =>
                {
                    page.unread.push(line_of(range.start));
                }
                Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
                Event::End(TagEnd::Heading(level)) => {
                    let text = heading.take().unwrap_or_default();
                    let (anchor, line) = (anchor_of(&text), line_of(range.start));
                    page.headings.push(Heading { level: level as usize, text, anchor, line });
                }
                Event::Text(part) | Event::Code(part) => {
                    if let Some(heading) = &mut heading {
                        heading.push_str(&part);
                    }
                }
                _ => {}
            }
        }
        page
    }

    pub(super) fn has_anchor(&self, anchor: &str) -> bool {
        self.headings.iter().any(|heading| heading.anchor == anchor)
    }
}

/// The anchor that code hosts give a heading: lower case, hyphens for spaces, no punctuation.
fn anchor_of(heading: &str) -> String {
    let is_kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    heading.to_lowercase().chars().filter(is_kept).collect::<String>().replace(' ', "-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_have_lines_and_places() {
        let text = "# A\n\nSee [the\nguide](guide.md#start \"title\"), ![view](a.png).\n\n| a |\n|---|\n| [b](b) |\n";
        let page = Markdown::read(text);
        let links: Vec<_> = page
            .links
            .iter()
            .map(|link| (&text[link.range.clone()], link.line, link.is_image))
            .collect();
        assert_eq!(links, [("guide.md#start", 4, false), ("a.png", 4, true), ("b", 8, false)]);
    }

    #[test]
    fn what_is_code_is_no_link() {
        let text = "`[a](a)`\n\n    [b](b)\n\n```\n[c](c)\n```\n";
        assert!(Markdown::read(text).links.is_empty());
    }

    #[test]
    fn links_that_cannot_be_read_are_noticed() {
        let text = "<a href=\"x\">x</a>\n\n[text][name]\n\n[name]: elsewhere.md\n";
        assert_eq!(Markdown::read(text).unread, [1, 3]);
    }

    #[test]
    fn headings_have_the_anchors_of_code_hosts() {
        let check = |heading: &str, anchor: &str| {
            let page = Markdown::read(&format!("# {heading}\n"));
            assert_eq!(page.headings[0].anchor, anchor, "{heading}");
        };
        check("The life of an episode", "the-life-of-an-episode");
        check("7. Metrics", "7-metrics");
        check("`evaluate`, and *more*: [here](x)", "evaluate-and-more-here");
        check("snake_case - and Ö", "snake_case---and-ö");
    }
}
