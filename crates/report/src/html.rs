//! The report as one self-contained HTML page: it includes its style and figures, and has no scripts.

use askama::Template;

use super::document::{ReportBlock, ReportDocument, TableCell};

#[derive(Template)]
#[template(path = "report.html")]
struct HtmlPage<'a> {
    document: &'a ReportDocument,
    style: &'static str,
}

/// The page.
///
/// # Errors
/// When the template fails, which would be a bug.
pub(super) fn render(document: &ReportDocument) -> askama::Result<String> {
    HtmlPage { document, style: include_str!("../templates/report.css") }.render()
}
