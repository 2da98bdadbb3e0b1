//! What of a text is the answer: reasoning taken off, the field of a JSON object, what follows `Action:`.

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::Value;

use super::clauses::{COLON, Sentence, sentences};

/// Words that announce the answer, before a colon or as the last word of a field's name (`next_action`).
const ANNOUNCING: [&str; 7] =
    ["action", "answer", "decision", "choice", "command", "response", "output"];

const REASONING: [(&str, &str); 2] = [("<think>", "</think>"), ("<thinking>", "</thinking>")];

/// `text` without reasoning; `None` when there is nothing but the beginning of some.
pub(super) fn without_reasoning(text: &str) -> Option<String> {
    let mut text = text.to_owned();
    for (begin, end) in REASONING {
        // Lower case in ASCII keeps every position.
        let find = |text: &str, what: &str| text.to_ascii_lowercase().find(what);
        while let Some(from) = find(&text, begin)
            && let Some(length) = find(&text[from..], end)
        {
            text.replace_range(from..from + length + end.len(), "\n");
        }
        // One that was begun before the answer, by the server's template, or that is only mentioned at its end.
        while let Some(at) = find(&text, end) {
            let (before, after) = (&text[..at], &text[at + end.len()..]);
            text = if after.trim().is_empty() { before } else { after }.to_owned();
        }
        if let Some(at) = find(&text, begin) {
            text.truncate(at);
            if text.trim().is_empty() {
                return None;
            }
        }
    }
    Some(text)
}

/// What the JSON object in `text` says in the field that announces the answer; `None` without such a one.
pub(super) fn field(text: &str) -> Option<String> {
    let (from, to) = (text.find('{')?, text.rfind('}')?);
    let Fields(fields) = serde_json::from_str(text.get(from..=to)?).ok()?;
    let announced: Vec<_> = fields.iter().filter(|(name, _)| announces(name)).collect();
    let values = announced.iter().map(|(_, value)| match value {
        Value::String(value) => value.clone(),
        other => other.to_string(),
    });
    let values = values.collect::<Vec<_>>().join("\n");
    // {"action": "move", "direction": "left"}
    let direction = fields.iter().find_map(|(name, value)| match value {
        Value::String(value) if name.eq_ignore_ascii_case("direction") => Some(value),
        _ => None,
    });
    match (announced.as_slice(), direction) {
        ([], _) => None,
        ([_], Some(direction)) => Some(format!("{values} {direction}")),
        _ => Some(values),
    }
}

fn announces(name: &str) -> bool {
    let last = sentences(name).pop().and_then(|mut sentence| sentence.clauses.pop());
    last.and_then(|mut words| words.pop()).is_some_and(|word| ANNOUNCING.contains(&word.as_str()))
}

/// What follows the first marker, where something does; all of it without one.
pub(super) fn after_marker(mut sentences: Vec<Sentence>) -> Vec<Sentence> {
    let marker = sentences.iter().enumerate().find_map(|(s, sentence)| {
        sentence.clauses.iter().enumerate().find_map(|(c, clause)| {
            let at = clause
                .windows(2)
                .position(|two| ANNOUNCING.contains(&two[0].as_str()) && two[1] == COLON)?;
            Some((s, c, at + 2))
        })
    });
    let Some((s, c, at)) = marker else { return sentences };
    let mut after = sentences.split_off(s);
    if let Some(first) = after.first_mut() {
        first.clauses.drain(..c);
        first.clauses[0].drain(..at);
        first.clauses.retain(|clause| !clause.is_empty());
    }
    after.retain(|sentence| !sentence.clauses.is_empty());
    after
}

/// The fields of a JSON object, each as often as it stands there.
struct Fields(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Fields {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct All;

        impl<'de> Visitor<'de> for All {
            type Value = Fields;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an object")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Fields, M::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(Fields(fields))
            }
        }

        deserializer.deserialize_map(All)
    }
}
