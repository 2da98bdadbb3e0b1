//! Lines of a journal with a checksum, which tells a line that was changed from one that was written.
//!
//! The checksum is the last field of the line's JSON object, so that the line stays one for every reader of JSON: the first
//! 4 bytes of the BLAKE3 hash of the object's text without that field, as 8 hexadecimal digits. It follows from the record
//! alone: equal records have equal lines. Lines of earlier versions have none, and are read as they are. It finds damage; it
//! is no signature, and who edits a line can compute it anew.

use std::borrow::Cow;

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The text before the digits.
const FIELD: &[u8] = b",\"checksum\":\"";
/// The text after them.
const END: &[u8] = b"\"}";
/// Number of digits.
const DIGITS: usize = 8;
/// Bytes that a checksum adds to an object without its last brace.
const LENGTH: usize = FIELD.len() + DIGITS + END.len();

/// The line of `entry`, with its checksum and its end. An entry that is not an object, or an empty one, has no checksum.
///
/// # Errors
/// When the entry cannot be written as JSON.
pub(super) fn line(entry: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut text = serde_json::to_vec(entry)?;
    if text.starts_with(b"{") && text.len() > 2 {
        let checksum = checksum(&text);
        text.pop();
        text.extend([FIELD, &checksum, END].concat());
    }
    text.push(b'\n');
    Ok(text)
}

/// Reads the entry of a line.
///
/// # Errors
/// What is wrong with the line.
pub(super) fn read<T: DeserializeOwned>(line: &[u8]) -> Result<T, String> {
    let (text, is_sound) = unsealed(line);
    // A text that is no entry says more than that it was changed.
    let entry = serde_json::from_slice(&text).map_err(|error| error.to_string())?;
    match is_sound {
        false => Err("it was changed after it was written: its checksum does not fit".to_owned()),
        true => Ok(entry),
    }
}

/// Whether `text`, which has no line end, holds a whole line with a checksum that fits, and something after it.
pub(super) fn is_line_and_more(text: &[u8]) -> bool {
    let field = text.windows(FIELD.len()).rposition(|part| part == FIELD);
    let end = field.map(|at| at + LENGTH).filter(|end| *end < text.len());
    end.is_some_and(|end| matches!(unsealed(&text[..end]), (Cow::Owned(_), true)))
}

/// The text of a line without its checksum, and whether that fits; without one it does.
fn unsealed(line: &[u8]) -> (Cow<'_, [u8]>, bool) {
    let text = line.trim_ascii();
    let field = text.len().checked_sub(LENGTH).and_then(|at| text.split_at_checked(at));
    match field {
        Some((object, field)) if field.starts_with(FIELD) && field.ends_with(END) => {
            let object = [object, b"}"].concat();
            let is_sound = field[FIELD.len()..].starts_with(&checksum(&object));
            (Cow::Owned(object), is_sound)
        }
        _ => (Cow::Borrowed(line), true),
    }
}

/// The checksum of an object's text, as digits.
fn checksum(object: &[u8]) -> [u8; DIGITS] {
    let hash = blake3::hash(object).to_hex();
    let digits = hash.as_bytes().first_chunk::<DIGITS>();
    digits.copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Entry {
        name: String,
        count: u32,
    }

    #[test]
    fn every_changed_character_is_noticed() {
        let entry = Entry { name: "a}\n\"".to_owned(), count: 12 };
        let written = line(&entry).unwrap();
        insta::assert_snapshot!(String::from_utf8_lossy(&written), @r#"{"name":"a}\n\"","count":12,"checksum":"b27619b3"}"#);
        assert_eq!(read::<Entry>(&written), Ok(entry));
        for place in 0..written.len() - 1 {
            for character in [b' ', b'0', b'1', b'a', b'"', b'}', b'\n', 0, 0xff] {
                let mut changed = written.clone();
                if std::mem::replace(&mut changed[place], character) == character {
                    continue;
                }
                let text = String::from_utf8_lossy(&changed);
                assert!(read::<Entry>(&changed).is_err(), "{text}");
            }
        }
        // The line end, in another file system or by an editor.
        assert!(read::<Entry>(&[&written[..written.len() - 1], b"\r\n"].concat()).is_ok());
    }

    #[test]
    fn a_line_without_a_checksum_is_read() {
        let entry = Entry { name: "a".to_owned(), count: 1 };
        let text = serde_json::to_vec(&entry).unwrap();
        assert_eq!(read::<Entry>(&text), Ok(entry));
        assert_eq!(line(&[1, 2]).unwrap(), b"[1,2]\n");
        assert_eq!(read::<[u32; 2]>(b"[1,2]\n"), Ok([1, 2]));
    }

    #[test]
    fn a_line_whose_end_was_changed_is_more_than_a_line() {
        let written = line(&Entry { name: "a".to_owned(), count: 1 }).unwrap();
        let (text, _) = written.split_at(written.len() - 1);
        assert!((0..=text.len()).all(|length| !is_line_and_more(&text[..length])));
        assert!(is_line_and_more(&[text, b"x"].concat()));
    }
}
