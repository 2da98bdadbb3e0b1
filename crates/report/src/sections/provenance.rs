//! The origin of the run's figures: program, settings, contents, processes.

use run_log::SessionEvent;
use serde_json::Value;

use super::overview::facts_table;
use crate::document::{Missing, ReportBlock, TableCell};
use crate::view::ScoredRun;

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let (log, manifest) = (view.log, &view.log.manifest);
    let failures = log
        .sessions
        .iter()
        .filter(|record| matches!(record.event, SessionEvent::Failed { .. }))
        .count();
    let sessions = log.sessions.iter().map(|record| record.session).max();
    let commit = manifest.commit.clone();
    let mut facts = vec![
        ("run folder".to_owned(), TableCell::Value(log.dir.display().to_string())),
        ("program version".to_owned(), TableCell::Value(manifest.version.clone())),
        (
            "commit".to_owned(),
            commit.map_or(
                TableCell::Missing(Missing::NotMeasured("the program was not run from a checkout")),
                TableCell::Value,
            ),
        ),
        ("wire version".to_owned(), TableCell::Value(manifest.wire_version.to_string())),
        (
            "sessions".to_owned(),
            sessions.map_or(
                TableCell::Missing(Missing::NotMeasured("the log holds no sessions")),
                |sessions| {
                    TableCell::Value(format!("{sessions}, with {failures} restarts after a fault"))
                },
            ),
        ),
    ];
    if let Ok(Value::Object(settings)) = serde_json::to_value(&manifest.settings) {
        for (key, value) in settings {
            // Each group of a suite has a row of its own.
            match value {
                Value::Array(groups) if key == "group" => {
                    facts.extend(groups.iter().map(group_fact))
                }
                value => facts.push((format!("setting {key}"), TableCell::Value(words(&value)))),
            }
        }
    }
    let hash = |(name, hash): (&String, &String)| {
        (format!("BLAKE3 of {name}"), TableCell::Value(hash.clone()))
    };
    facts.extend(manifest.hashes.iter().map(hash));
    for (name, memory) in &manifest.memories {
        if let Ok(Value::Object(said)) = serde_json::to_value(memory) {
            let fact = |(fact, value): (&String, &Value)| {
                (format!("memory {name} {fact}"), TableCell::Value(words(value)))
            };
            facts.extend(said.iter().map(fact));
        }
    }
    for (role, said) in &manifest.processes {
        let fact = |(fact, value): (&String, &String)| {
            let value = if value.is_empty() { "nothing" } else { value };
            (format!("{role} {fact}"), TableCell::Value(value.to_owned()))
        };
        facts.extend(said.iter().map(fact));
    }
    let caption = "What the run depended on, from its manifest.";
    vec![ReportBlock::Table(facts_table(view.id("provenance"), caption, facts))]
}

fn group_fact(group: &Value) -> (String, TableCell) {
    let mut others = group.clone();
    let name = others.as_object_mut().and_then(|fields| fields.remove("name"));
    let name = name.map_or(String::new(), |name| format!(" {}", words(&name)));
    (format!("setting group{name}"), TableCell::Value(words(&others)))
}

/// A value of a setting in readable form.
fn words(value: &Value) -> String {
    match value {
        Value::String(text) if text.is_empty() => "none".to_owned(),
        Value::String(text) => text.clone(),
        Value::Array(all) if all.is_empty() => "none".to_owned(),
        Value::Array(all) => all.iter().map(words).collect::<Vec<_>>().join(" "),
        Value::Object(fields) => {
            let said = fields.iter().map(|(key, value)| format!("{key}: {}", words(value)));
            said.collect::<Vec<_>>().join("; ")
        }
        other => other.to_string(),
    }
}
