//! What a Markdown page has: links, images and headings, read as GitHub does.

use std::ops::Range;

use markdown::ParseOptions;
use markdown::mdast::Node;

/// A page's links and headings, in the order of the text.
#[derive(Default)]
pub(super) struct Markdown {
    pub(super) links: Vec<Link>,
    pub(super) headings: Vec<Heading>,
    pub(super) parts: Parts,
    /// What a reader sees, without spaces.
    pub(super) letters: String,
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
        let mut page = Self::default();
        // Only MDX, which is off, has texts that cannot be read.
        if let Ok(root) = markdown::to_mdast(text, &ParseOptions::gfm()) {
            page.add(&root, text);
        }
        page
    }

    /// Adds a node of the text and what is in it.
    fn add(&mut self, node: &Node, text: &str) {
        let range = node.position().map_or(0..0, |it| it.start.offset..it.end.offset);
        let line = node.position().map_or(0, |it| it.start.line);
        match node {
            Node::Link(link) => self.add_link(&link.url, false, range, text),
            Node::Image(image) => {
                self.parts.images += 1;
                self.add_link(&image.url, true, range, text);
            }
            Node::LinkReference(_) | Node::ImageReference(_) => self.unread.push(line),
            Node::Html(html) if html.value.contains("href=") || html.value.contains("src=") => {
                self.unread.push(line);
            }
            Node::Heading(heading) => {
                self.parts.headings += 1;
                let (level, text) = (usize::from(heading.depth), node.to_string());
                let anchor = anchor_of(&text);
                self.headings.push(Heading { level, text, anchor, line });
            }
            Node::List(_) => self.parts.lists += 1,
            Node::ListItem(_) => self.parts.list_items += 1,
            Node::TableRow(_) => self.parts.table_rows += 1,
            Node::Code(code) => {
                self.parts.code_blocks += 1;
                self.letters.extend(code.value.split_whitespace());
            }
            Node::Text(text) => self.letters.extend(text.value.split_whitespace()),
            Node::InlineCode(code) => self.letters.extend(code.value.split_whitespace()),
            _ => {}
        }
        for child in node.children().into_iter().flatten() {
            self.add(child, text);
        }
    }

    /// Adds the link in these bytes of the text.
    fn add_link(&mut self, target: &str, is_image: bool, range: Range<usize>, text: &str) {
        let line_of = |at: usize| text[..at].matches('\n').count() + 1;
        match text[range.clone()].rfind(target) {
            Some(at) => {
                let start = range.start + at;
                let (line, range) = (line_of(start), start..start + target.len());
                self.links.push(Link { target: target.to_owned(), is_image, line, range });
            }
            // Of other hosts and of mail, where the text leaves out the scheme.
            None if target.contains(':') => {}
            None => self.unread.push(line_of(range.start)),
        }
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
        assert!(Markdown::read("someone@example.org, www.example.org\n").unread.is_empty());
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
