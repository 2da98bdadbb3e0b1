//! Where the run's figures come from: program, settings, contents, processes.

use serde_json::Value;

use super::overview::facts_table;
use crate::log::SessionEvent;
use crate::report::document::{Block, Cell, Missing};
use crate::report::view::View;

pub(super) fn blocks(view: &View<'_>) -> Vec<Block> {
    let (log, manifest) = (view.log, &view.log.manifest);
    let failures = log
        .sessions
        .iter()
        .filter(|record| matches!(record.event, SessionEvent::Failed { .. }))
        .count();
    let sessions = log.sessions.iter().map(|record| record.session).max();
    let commit = manifest.commit.clone();
    let mut facts = vec![
        ("run folder".to_owned(), Cell::Value(log.dir.display().to_string())),
        ("program version".to_owned(), Cell::Value(manifest.version.clone())),
        (
            "commit".to_owned(),
            commit.map_or(
                Cell::Missing(Missing::NotMeasured("the program did not lie in a checkout")),
                Cell::Value,
            ),
        ),
        ("wire version".to_owned(), Cell::Value(manifest.wire_version.to_string())),
        (
            "sessions".to_owned(),
            sessions.map_or(
                Cell::Missing(Missing::NotMeasured("the log holds no sessions")),
                |sessions| {
                    Cell::Value(format!("{sessions}, with {failures} restarts after a fault"))
                },
            ),
        ),
    ];
    if let Ok(Value::Object(settings)) = serde_json::to_value(&manifest.settings) {
        let shown = |value: Value| match value {
            Value::String(text) => text,
            Value::Array(words) => words
                .iter()
                .map(|word| word.as_str().map_or_else(|| word.to_string(), str::to_owned))
                .collect::<Vec<_>>()
                .join(" "),
            other => other.to_string(),
        };
        facts.extend(settings.into_iter().map(|(key, value)| {
            let shown = shown(value);
            let shown = if shown.is_empty() { "none".to_owned() } else { shown };
            (format!("setting {key}"), Cell::Value(shown))
        }));
    }
    let hash =
        |(name, hash): (&String, &String)| (format!("BLAKE3 of {name}"), Cell::Value(hash.clone()));
    facts.extend(manifest.hashes.iter().map(hash));
    for (role, said) in &manifest.processes {
        let fact = |(fact, value): (&String, &String)| {
            let value = if value.is_empty() { "nothing" } else { value };
            (format!("{role} {fact}"), Cell::Value(value.to_owned()))
        };
        facts.extend(said.iter().map(fact));
    }
    let caption = "What the run depended on, from its manifest.";
    vec![Block::Table(facts_table(view.id("provenance"), caption, facts))]
}
