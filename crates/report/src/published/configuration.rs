//! What was configured: the facts of a run that a publication may state.

use std::collections::BTreeMap;

use conditions::settings::{Effect, KEYS, Key, Scope};
use domain::names::UnknownName;
use run_log::RunLog;
use serde_json::Value;

/// The number of cases of each condition.
pub(crate) const CASES: &str = "cases";
/// The number of repetitions of each condition.
pub(crate) const RUNS: &str = "runs";
/// The past steps that the policy is shown; part of a condition's name where it is not the standard.
pub(crate) const WINDOW: &str = "window";

/// Facts that are no settings of the whole run.
const OTHERS: [&str; 6] = [CASES, RUNS, WINDOW, "suite", "version", "world"];

/// The hashes of what cases are made of, by the name of the fact and of the hash in a manifest.
const HASHES: [(&str, &str); 3] =
    [("layout-hash", "layout"), ("catalogue-hash", "catalogue"), ("cases-hash", "cases")];

/// Hexadecimal digits of a hash in a file.
const HASH_DIGITS: usize = 16;

/// The names of all facts.
pub(crate) fn known() -> impl Iterator<Item = &'static str> {
    let settings = KEYS.iter().filter(|key| is_stated(key)).map(|key| key.name);
    OTHERS.into_iter().chain(HASHES.map(|(fact, _)| fact)).chain(settings)
}

/// Whether a setting changes what episodes lead to. The policy is named by itself.
fn is_stated(key: &Key) -> bool {
    matches!(key.effect, Effect::Protocol | Effect::Outcome)
        && matches!(key.scope, Scope::Run | Scope::Model)
        && !["policy", "policy-cmd"].contains(&key.name)
}

/// Checks a fact of a file.
///
/// # Errors
/// When there is no such fact, or the number of cases or runs is none.
pub(super) fn check(name: &str, value: &str) -> Result<(), String> {
    if !known().any(|known| known == name) {
        return Err(UnknownName::new("fact", name, known()).to_string());
    }
    let is_count = value.parse::<u32>().is_ok_and(|count| count > 0);
    match name {
        CASES | RUNS if !is_count => {
            Err(format!("{name}: `{value}` is not a whole number from 1 on"))
        }
        _ => Ok(()),
    }
}

/// The facts of a run, by name, except those that its conditions may have differently: cases, runs and window.
pub(crate) fn facts(log: &RunLog) -> BTreeMap<String, String> {
    let manifest = &log.manifest;
    let mut facts = BTreeMap::from([
        ("suite".to_owned(), manifest.settings.suite.to_string()),
        ("version".to_owned(), manifest.version.clone()),
        ("world".to_owned(), log.world.declaration.name.clone()),
    ]);
    for (fact, name) in HASHES {
        let shown = |hash: &String| hash.get(..HASH_DIGITS).unwrap_or(hash).to_owned();
        facts.extend(manifest.hashes.get(name).map(|hash| (fact.to_owned(), shown(hash))));
    }
    if let Ok(Value::Object(settings)) = serde_json::to_value(&manifest.settings) {
        let stated =
            settings.into_iter().filter(|(name, _)| Key::find(name).is_some_and(is_stated));
        facts.extend(stated.filter_map(|(name, value)| {
            let text = match value {
                Value::Null => return None,
                Value::String(text) => text,
                value => value.to_string(),
            };
            Some((name, text))
        }));
    }
    facts
}
