//! The report as one HTML page that needs nothing else: style and figures are in it, scripts there are none.

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
