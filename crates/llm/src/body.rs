//! The JSON in the body of a response, whatever servers and proxies put around it: compression that was not asked for, a byte
//! order mark, blank lines, the end mark of a stream, a stream of one answer, and numbers that JSON lacks.

use std::borrow::Cow;
use std::io::Read;

use flate2::read::{DeflateDecoder, MultiGzDecoder, ZlibDecoder};
use serde_json::{Map, Value, json};

/// Maximum number of bytes of an answer, as it comes and after decompression.
pub(crate) const LARGEST_ANSWER: u64 = 16 << 20;

/// Bytes of a body that a message shows.
const SHOWN: usize = 60;

/// Numbers that Python writes and JSON lacks.
const NO_NUMBERS: [&[u8]; 3] = [b"NaN", b"Infinity", b"-Infinity"];

/// The body without its compression. Its first bytes tell whether it is compressed; `encoding` is that of its header.
///
/// # Errors
/// When it cannot be decompressed.
pub(crate) fn decompressed(body: Vec<u8>, encoding: &str) -> Result<Vec<u8>, String> {
    let encoding = encoding.trim().to_ascii_lowercase();
    let mut content = Vec::new();
    let limit = LARGEST_ANSWER + 1;
    let read = match (&body[..], &*encoding) {
        ([0x1f, 0x8b, ..], _) => MultiGzDecoder::new(&*body).take(limit).read_to_end(&mut content),
        ([0x78, flags, ..], _) if (0x7800 + u16::from(*flags)) % 31 == 0 => {
            ZlibDecoder::new(&*body).take(limit).read_to_end(&mut content)
        }
        _ if is_text(&body) || matches!(&*encoding, "" | "identity") => return Ok(body),
        (_, "deflate") => DeflateDecoder::new(&*body).take(limit).read_to_end(&mut content),
        _ => return Err(format!("it is compressed in a way that was not asked for ({encoding})")),
    };
    match read {
        Err(error) => Err(format!("its compressed bytes are damaged: {error}")),
        Ok(_) if content.len() as u64 > LARGEST_ANSWER => {
            Err(format!("it has more than {LARGEST_ANSWER} bytes"))
        }
        Ok(_) => Ok(content),
    }
}

/// Whether a body begins as text does.
fn is_text(body: &[u8]) -> bool {
    let begin = without_mark(body).trim_ascii_start();
    begin.is_empty() || begin.starts_with(b"{") || begin.starts_with(b"[") || is_page(body)
}

fn without_mark(body: &[u8]) -> &[u8] {
    body.strip_prefix(b"\xef\xbb\xbf").unwrap_or(body)
}

/// Whether a body is a web page.
pub(crate) fn is_page(body: &[u8]) -> bool {
    let begin = without_mark(body).trim_ascii_start();
    let begin = &begin[..begin.len().min(SHOWN)];
    let begin = String::from_utf8_lossy(begin).to_ascii_lowercase();
    begin.starts_with("<!doctype html") || begin.starts_with("<html") || begin.starts_with("<head")
}

/// The JSON in a body.
///
/// # Errors
/// What is wrong with the bytes.
pub(crate) fn json(body: &[u8]) -> Result<Value, String> {
    let body = without_mark(body).trim_ascii();
    if body.is_empty() {
        return Err("it is empty".to_owned());
    }
    if ["data:", "event:", "id:", "retry:", ":"].iter().any(|it| body.starts_with(it.as_bytes())) {
        return of_stream(&String::from_utf8_lossy(body));
    }
    first_value(body).or_else(|error| {
        let begin = String::from_utf8_lossy(&body[..body.len().min(SHOWN)]);
        first_value(&with_null_numbers(body))
            .map_err(|_| format!("it is not JSON: {error}; it begins with {begin:?}"))
    })
}

/// The value that a text begins with, if nothing but the end mark of a stream follows.
fn first_value(text: &[u8]) -> Result<Value, String> {
    let mut values = serde_json::Deserializer::from_slice(text).into_iter::<Value>();
    let value = match values.next() {
        Some(value) => value.map_err(|error| error.to_string())?,
        None => return Err("nothing is there".to_owned()),
    };
    let rest = text.get(values.byte_offset()..).unwrap_or_default().trim_ascii();
    let rest = rest.strip_prefix(b"data:").unwrap_or(rest).trim_ascii();
    if rest.is_empty() || rest == b"[DONE]" {
        Ok(value)
    } else {
        let rest = String::from_utf8_lossy(&rest[..rest.len().min(SHOWN)]);
        Err(format!("it goes on with {rest:?}"))
    }
}

/// The text with `null` for each number that JSON lacks.
fn with_null_numbers(text: &[u8]) -> Vec<u8> {
    let mut written = Vec::with_capacity(text.len());
    let (mut in_string, mut escaped) = (false, false);
    let mut rest = text;
    while let Some((&byte, after)) = rest.split_first() {
        let number = NO_NUMBERS.iter().find(|number| !in_string && rest.starts_with(number));
        if let Some(number) = number {
            written.extend_from_slice(b"null");
            rest = &rest[number.len()..];
            continue;
        }
        in_string ^= byte == b'"' && !escaped;
        escaped = in_string && byte == b'\\' && !escaped;
        written.push(byte);
        rest = after;
    }
    written
}

/// The reply in a stream of events, put together as if it had not been streamed.
fn of_stream(text: &str) -> Result<Value, String> {
    let mut message = Map::from_iter([("content".to_owned(), Value::Null)]);
    let (mut reply, mut finish_reason) = (Map::new(), Value::Null);
    let (mut ended, mut begun) = (false, false);
    for line in text.lines() {
        // Each event of these servers is one line.
        let Some(data) = line.trim_end().strip_prefix("data:") else { continue };
        if data.trim() == "[DONE]" {
            ended = true;
            break;
        }
        let event = first_value(data.trim().as_bytes())
            .map_err(|error| format!("an event of its stream is not JSON: {error}"))?;
        let is_whole = event.pointer("/choices/0/message").is_some_and(Value::is_object);
        if is_whole || event.get("error").is_some_and(|error| !error.is_null()) {
            return Ok(event);
        }
        for field in ["model", "usage", "timings"] {
            if let Some(value) = event.get(field).filter(|value| !value.is_null()) {
                reply.insert(field.to_owned(), value.clone());
            }
        }
        if let Some(choice) = event.pointer("/choices/0") {
            begun = true;
            if let Some(delta) = choice.get("delta").and_then(Value::as_object) {
                delta.iter().for_each(|(field, value)| append(&mut message, field, value));
            }
            if let Some(reason) = choice.get("finish_reason").filter(|reason| !reason.is_null()) {
                (finish_reason, ended) = (reason.clone(), true);
            }
        }
    }
    if !begun || !ended {
        let problem = if begun { "breaks off" } else { "has no choices" };
        return Err(format!("its stream {problem}"));
    }
    reply.insert(
        "choices".to_owned(),
        json!([{"message": message, "finish_reason": finish_reason}]),
    );
    Ok(Value::Object(reply))
}

/// Adds a piece of a field to what came of it before.
fn append(message: &mut Map<String, Value>, field: &str, piece: &Value) {
    match (message.get_mut(field), piece) {
        (_, Value::Null) => {}
        (Some(Value::String(begun)), Value::String(piece)) => begun.push_str(piece),
        (Some(Value::Array(begun)), Value::Array(pieces)) => begun.extend_from_slice(pieces),
        _ => drop(message.insert(field.to_owned(), piece.clone())),
    }
}

/// The words of a web page, as far as a message needs them: its title, else its first heading, else its text.
pub(crate) fn words_of_page(page: &str) -> Cow<'_, str> {
    let lower = page.to_ascii_lowercase();
    let of_element = |name: &str| {
        let begin = lower.find(&format!("<{name}"))?;
        let begin = begin + lower[begin..].find('>')? + 1;
        let end = begin + lower[begin..].find(&format!("</{name}"))?;
        page.get(begin..end).filter(|text| !text.trim().is_empty())
    };
    let text = ["title", "h1", "h2", "body"].into_iter().find_map(of_element).unwrap_or(page);
    let mut words = String::new();
    for part in text.split('<') {
        let text = part.split_once('>').map_or(part, |(_, text)| text);
        words.push_str(text);
        words.push(' ');
    }
    Cow::Owned(words)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::{DeflateEncoder, GzEncoder, ZlibEncoder};

    use super::*;

    #[test]
    fn json_is_found_in_what_is_around_it() {
        let whole = json!({"a": "NaN \" NaN", "b": [1, null]});
        for text in [
            r#"{"a": "NaN \" NaN", "b": [1, null]}"#,
            "\u{feff}{\"a\": \"NaN \\\" NaN\", \"b\": [1, null]}",
            "\n\n \r\n{\"a\": \"NaN \\\" NaN\", \"b\": [1, NaN]}\n",
            r#"{"a": "NaN \" NaN", "b": [1, -Infinity]}"#,
            "{\"a\": \"NaN \\\" NaN\", \"b\": [1, null]}\n\ndata: [DONE]\n\n",
            "{\"a\": \"NaN \\\" NaN\", \"b\": [1, null]}[DONE]",
        ] {
            assert_eq!(json(text.as_bytes()).as_ref(), Ok(&whole), "{text}");
        }
    }

    #[test]
    fn what_is_wrong_with_the_bytes_is_said() {
        for (body, expected) in [
            (&b" \n"[..], "it is empty"),
            (
                b"Bad Gateway",
                "it is not JSON: expected value at line 1 column 1; it begins with \"Bad Gateway\"",
            ),
            (
                b"{\"a\": 1} {",
                "it is not JSON: it goes on with \"{\"; it begins with \"{\\\"a\\\": 1} {\"",
            ),
            (
                b"\xff\xfe{\0",
                "it is not JSON: expected value at line 1 column 1; it begins with \"\u{fffd}\u{fffd}{\\0\"",
            ),
            (
                b"data: {\"choices\": [{\"delta\": {\"content\": \"mov\"}}]}\n\n",
                "its stream breaks off",
            ),
            (
                b"data: {\"choices\"\n\n",
                "an event of its stream is not JSON: EOF while parsing an object at line 1 column 10",
            ),
            (b": waiting\n\n", "its stream has no choices"),
        ] {
            assert_eq!(json(body).as_ref().map_err(String::as_str), Err(expected));
        }
    }

    #[test]
    fn a_stream_is_put_together() {
        let stream = "event: x\ndata: {\"model\": \"m\", \"choices\": [{\"delta\": {\"role\": \"assistant\", \"content\": \"move \"}}]}\n\n\
                      : still here\n\n\
                      data: {\"choices\": [{\"delta\": {\"content\": \"on\"}, \"finish_reason\": \"stop\"}]}\r\n\r\n\
                      data: {\"choices\": [], \"usage\": {\"prompt_tokens\": 7}}\n\ndata: [DONE]\n\n";
        let reply = json(stream.as_bytes()).unwrap();
        assert_eq!(reply.pointer("/choices/0/message/content"), Some(&json!("move on")));
        assert_eq!(reply.pointer("/choices/0/finish_reason"), Some(&json!("stop")));
        assert_eq!(reply.pointer("/usage/prompt_tokens"), Some(&json!(7)));
        let whole =
            json(b"data: {\"choices\": [{\"message\": {\"content\": \"a\"}}]}\n\n").unwrap();
        assert_eq!(whole.pointer("/choices/0/message/content"), Some(&json!("a")));
        let failed = json(b"data: {\"error\": {\"message\": \"died\"}}\n\n").unwrap();
        assert_eq!(failed.pointer("/error/message"), Some(&json!("died")));
    }

    #[test]
    fn compressed_bodies_are_recognised_with_and_without_a_header() {
        let text = br#"{"choices": []}"#;
        let level = Compression::default();
        let (mut gzip, mut zlib) =
            (GzEncoder::new(Vec::new(), level), ZlibEncoder::new(Vec::new(), level));
        let mut raw = DeflateEncoder::new(Vec::new(), level);
        gzip.write_all(text).unwrap();
        zlib.write_all(text).unwrap();
        raw.write_all(text).unwrap();
        let (gzip, zlib, raw) =
            (gzip.finish().unwrap(), zlib.finish().unwrap(), raw.finish().unwrap());
        for (body, encoding) in [
            (&text[..], ""),
            (text, "gzip"),
            (&gzip, "gzip"),
            (&gzip, ""),
            (&zlib, "deflate"),
            (&zlib, ""),
            (&raw, "Deflate"),
        ] {
            assert_eq!(decompressed(body.to_vec(), encoding).as_deref(), Ok(&text[..]));
        }
        let damaged = decompressed(gzip[..gzip.len() - 9].to_vec(), "gzip").unwrap_err();
        assert!(damaged.starts_with("its compressed bytes are damaged: "), "{damaged}");
        let other = decompressed(b"\x0b\x07\x80".to_vec(), "br").unwrap_err();
        assert_eq!(other, "it is compressed in a way that was not asked for (br)");
    }

    #[test]
    fn a_page_is_its_title_or_its_words() {
        for (page, expected) in [
            ("<html><head><title>413 Too Large</title></head><h1>x</h1>", "413 Too Large"),
            ("<html><h1>502 Bad\nGateway</h1></html>", "502 Bad Gateway"),
            ("<!doctype html><p>Sign <b>in</b>", "Sign in"),
        ] {
            let words = words_of_page(page);
            let words: Vec<&str> = words.split_whitespace().collect();
            assert_eq!(words.join(" "), expected);
            assert!(is_page(page.as_bytes()));
        }
        assert!(!is_page(b"{\"a\": \"<html>\"}"));
    }
}
