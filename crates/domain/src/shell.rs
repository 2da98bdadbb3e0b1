//! Words of a command line for a user to copy.

use std::ffi::OsStr;

/// A word as a POSIX shell reads it: in single quotes, unless it has none but harmless characters.
pub fn shell_word(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=+:".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_words_that_a_shell_would_split_or_change_are_quoted() {
        for (word, expected) in [
            ("runs/a-1_b", "runs/a-1_b"),
            ("t01-01..t04-10,t05", "t01-01..t04-10,t05"),
            ("", "''"),
            ("my run", "'my run'"),
            ("it's $1", r"'it'\''s $1'"),
            ("Läufe", "'Läufe'"),
        ] {
            assert_eq!(shell_word(word), expected);
        }
    }
}
