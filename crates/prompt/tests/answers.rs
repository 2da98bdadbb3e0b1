//! Answers as models write them, with the action that they choose. A line of `answers/*.tsv` has the action's words, `ambiguous`
//! or `unreadable`, a tab, and the answer, with `\n` for a line's end. `development.tsv` was written before the rule that
//! reads answers, `held-out.tsv` after it.

#![expect(clippy::unwrap_used, reason = "what fails here fails the test")]

use prompt::{UnreadAnswer, read_answer};
use warehouse::declaration;

/// The answers of a file that are read otherwise than they are meant.
fn misread(file: &str) -> Vec<String> {
    let world = declaration();
    let lines = file.lines().map(|line| line.split_once('\t').unwrap());
    let read = lines.map(|(expected, answer)| {
        let read = match read_answer(&world, &answer.replace("\\n", "\n")) {
            Ok(action) => world.action_words(action).to_owned(),
            Err(UnreadAnswer::Ambiguous) => "ambiguous".to_owned(),
            Err(_) => "unreadable".to_owned(),
        };
        (expected, answer, read)
    });
    let misread = read.filter(|(expected, _, read)| expected != read);
    misread
        .map(|(expected, answer, read)| format!("{expected}, read as {read}: {answer}"))
        .collect()
}

#[test]
fn answers_are_read_as_they_are_meant() {
    for file in [include_str!("answers/development.tsv"), include_str!("answers/held-out.tsv")] {
        assert_eq!(misread(file), [] as [String; 0]);
    }
}
