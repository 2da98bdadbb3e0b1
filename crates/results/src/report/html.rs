//! The report as one self-contained HTML page: it includes its style and figures, and has no scripts.

use askama::Template;

use super::document::{Block, Cell, Document};

#[derive(Template)]
#[template(path = "report.html")]
struct HtmlPage<'a> {
    document: &'a Document,
    style: &'static str,
}

/// The page.
///
/// # Errors
/// When the template fails, which would be a bug.
pub(super) fn render(document: &Document) -> askama::Result<String> {
    HtmlPage { document, style: include_str!("../../templates/report.css") }.render()
}
