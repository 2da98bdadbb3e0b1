//! A leaderboard as one page that needs no other file and no network.

use anyhow::{Context, Result};
use askama::Template;

use super::Board;

#[derive(Template)]
#[template(path = "leaderboard.html")]
struct BoardPage<'a> {
    board: &'a Board,
    style: &'static str,
    script: &'static str,
}

/// The page.
///
/// # Errors
/// When the template fails, which would be a bug.
pub(super) fn render(board: &Board) -> Result<String> {
    let page = BoardPage {
        board,
        style: include_str!("../../templates/leaderboard.css"),
        script: include_str!("../../templates/leaderboard.js"),
    };
    page.render()
        .context("cannot make the page; this is a mistake in the program, please report it")
}

#[cfg(test)]
mod tests {
    use results::log::testing::{log, record};

    use super::super::Entry;
    use super::*;

    #[test]
    fn names_of_runs_are_text_and_nothing_is_loaded() {
        let mut log = log(vec![record("t01-01", true)]);
        log.dir = "<script>alert(1)<".into();
        let page = render(&Board::new(&[Entry::of(&log).unwrap()])).unwrap();
        assert!(!page.contains("<script>alert"), "{page}");
        assert!(page.contains("default-src 'none'"));
        for word in ["http:", "https:", "url("] {
            assert!(!page.contains(word), "{word}");
        }
    }
}
