//! Answers as models write them, with the action that they choose: `answers/*.tsv`.

use prompt::read_answer;
use warehouse::declaration;

/// How many of the phrases give an action that was not chosen, and how many that choose one give none.
fn check(file: &str) -> (usize, usize) {
    let world = declaration();
    let (mut wrong, mut unread) = (0, 0);
    for line in file.lines() {
        let (expected, phrase) = line.split_once('\t').unwrap();
        let phrase = phrase.replace("\\n", "\n");
        let chosen = world.action_named(expected);
        match read_answer(&world, &phrase).ok() {
            read if read == chosen => continue,
            Some(_) => wrong += 1,
            None => unread += 1,
        }
        println!("{expected}: {phrase:?} is read as {:?}", read_answer(&world, &phrase).map(|code| world.action_words(code).to_owned()));
    }
    (wrong, unread)
}

#[test]
fn answers_are_read_as_they_are_meant() {
    let counts = check(include_str!("answers/development.tsv"));
    assert_eq!(counts, (0, 0));
}
