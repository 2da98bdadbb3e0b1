//! Layers on top of each other, and whether the outcome can be.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use serde_json::{Map, Value};
use shm_types::Representation;
use shm_types::message::{MAX_SEGMENT, MAX_WINDOW};

use super::{Layer, Settings};
use crate::conditions::Condition;

/// Where a setting comes from, weakest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// Nobody said anything.
    Default,
    /// The suite.
    Suite,
    /// A MEMTRANSFER_* variable.
    Environment,
    /// A flag.
    CommandLine,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::Suite => "suite",
            Self::Environment => "environment",
            Self::CommandLine => "command line",
        })
    }
}

/// Settings, and where each comes from.
#[derive(Debug, Clone)]
pub struct Resolved {
    /// The settings.
    pub settings: Settings,
    origins: BTreeMap<String, Origin>,
}

/// Why layers make no settings.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// A value that cannot be.
    #[error("{key} is {value}, but must be {expected}")]
    Value {
        /// The flag.
        key: &'static str,
        /// What it is.
        value: String,
        /// What would be accepted.
        expected: String,
    },
    /// Nothing is left to run.
    #[error(
        "no condition is left: a blocked route needs the new start (add `new` to --starts), and --memory, \
         --starts, --routes and --demos need an entry each"
    )]
    NoCondition,
    /// The layers do not fit together: a bug.
    #[error("the settings cannot be put together: {0}")]
    Internal(#[from] serde_json::Error),
}

/// Puts layers on top of each other, weakest first, and checks the outcome.
///
/// # Errors
/// When a value cannot be, or nothing is left to run.
pub fn resolve(
    layers: impl IntoIterator<Item = (Origin, Layer)>,
) -> Result<Resolved, SettingsError> {
    let mut merged = Map::new();
    let mut origins = BTreeMap::new();
    for (origin, layer) in layers {
        let Value::Object(said) = serde_json::to_value(layer)? else { continue };
        origins.extend(said.keys().map(|key| (key.clone(), origin)));
        merged.extend(said);
    }
    if !merged.contains_key("out") {
        let word = |key| merged.get(key).and_then(Value::as_str).unwrap_or_default();
        let suite: super::SuiteName = serde_json::from_value(word("suite").into())?;
        let out = PathBuf::from(format!("runs/{}-{}", suite.word(), word("policy")));
        merged.insert("out".to_owned(), serde_json::to_value(out)?);
        origins.insert("out".to_owned(), Origin::Default);
    }
    let settings: Settings = serde_json::from_value(Value::Object(merged))?;
    settings.check()?;
    Ok(Resolved { settings, origins })
}

impl Settings {
    /// The conditions they ask for, in the order of the table.
    ///
    /// The expert asks no memory, so for it every memory is the same: the window alone.
    pub fn conditions(&self) -> Vec<Condition> {
        let memory =
            if self.policy.has_process() { &self.memory[..] } else { &[Representation::Working] };
        let mut conditions = Condition::product(memory, &self.starts, &self.routes, &self.demos);
        conditions.iter_mut().for_each(|condition| condition.variation.window = self.window);
        conditions
    }

    /// Whether every value can be.
    fn check(&self) -> Result<(), SettingsError> {
        let numbers = [
            ("--runs", self.runs, 1, 1000),
            ("--max-steps", self.max_steps, 1, 10_000),
            ("--window", self.window, 0, MAX_WINDOW as u32),
            ("--horizon", self.horizon, 0, MAX_SEGMENT as u32 - 1),
            ("--frame-size", self.frame_size, 64, 4096),
            ("--lanes", self.lanes, 1, 1024),
            ("--spin-us", self.spin_us, 0, 1_000_000),
            ("--step-timeout", self.step_timeout, 1, 86_400),
            ("--start-timeout", self.start_timeout, 1, 86_400),
        ];
        for (key, value, least, most) in numbers {
            if !(least..=most).contains(&value) {
                let expected = format!("{least} to {most}");
                return Err(SettingsError::Value { key, value: value.to_string(), expected });
            }
        }
        for (key, value) in
            [("--encoder-threads", self.encoder_threads), ("--frame-budget", self.frame_budget)]
        {
            if value == Some(0) {
                let expected = "at least 1".to_owned();
                return Err(SettingsError::Value { key, value: "0".to_owned(), expected });
            }
        }
        if !self.frame_size.is_multiple_of(64) {
            return Err(SettingsError::Value {
                key: "--frame-size",
                value: self.frame_size.to_string(),
                expected: "a multiple of 64".to_owned(),
            });
        }
        if self.conditions().is_empty() {
            return Err(SettingsError::NoCondition);
        }
        Ok(())
    }
}

impl fmt::Display for Resolved {
    /// As a suite file would say it, each line with where it comes from. JSON scalars and arrays are TOML.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Ok(Value::Object(values)) = serde_json::to_value(&self.settings) else {
            return Err(fmt::Error);
        };
        for key in Layer::keys() {
            match (values.get(&key), self.origins.get(&key)) {
                (Some(value), Some(origin)) => {
                    writeln!(f, "{:<44} # {origin}", format!("{key} = {value}"))?
                }
                _ => writeln!(f, "# {key}: not set")?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::{Route, Start};
    use crate::settings::{SuiteName, load_suite};

    fn lanes(n: u32) -> Layer {
        Layer { lanes: Some(n), ..Layer::default() }
    }

    fn with(layer: Layer) -> Result<Resolved, SettingsError> {
        resolve([(Origin::Default, Layer::defaults()), (Origin::CommandLine, layer)])
    }

    #[test]
    fn the_strongest_source_wins_whatever_the_others_say() {
        use Origin::{CommandLine, Default, Environment, Suite};
        let base = [(Default, Layer::defaults())];
        for (said, expected, origin) in [
            (vec![], 16, Default),
            (vec![(Suite, lanes(2))], 2, Suite),
            (vec![(Suite, lanes(2)), (Environment, lanes(3))], 3, Environment),
            (
                vec![(Suite, lanes(2)), (Environment, lanes(3)), (CommandLine, lanes(4))],
                4,
                CommandLine,
            ),
            (vec![(Suite, lanes(2)), (CommandLine, Layer::default())], 2, Suite),
        ] {
            let resolved = resolve(base.iter().cloned().chain(said)).unwrap();
            assert_eq!((resolved.settings.lanes, resolved.origins["lanes"]), (expected, origin));
        }
    }

    #[test]
    fn the_folder_follows_from_suite_and_policy() {
        let out = |layer| with(layer).unwrap().settings.out.display().to_string();
        let suite = |name: &str| Layer { suite: name.parse().ok(), ..Layer::default() };
        assert_eq!(out(Layer::default()), "runs/quick-grounded");
        assert_eq!(out(suite("mine/small.toml")), "runs/small-grounded");
        let own = Layer { out: Some("elsewhere".into()), ..suite("quick") };
        assert_eq!(out(own), "elsewhere");
    }

    #[test]
    fn impossible_values_are_named_with_what_would_do() {
        let error = |layer| with(layer).unwrap_err().to_string();
        let size = |n| Layer { frame_size: Some(n), ..Layer::default() };
        assert_eq!(error(lanes(0)), "--lanes is 0, but must be 1 to 1024");
        assert_eq!(error(size(100)), "--frame-size is 100, but must be a multiple of 64");
        let nothing = Layer {
            starts: Some(vec![Start::Original]),
            routes: Some(vec![Route::Blocked]),
            ..Layer::default()
        };
        assert!(error(nothing).contains("a blocked route needs the new start"));
    }

    #[test]
    fn settings_are_shown_as_a_suite_file() {
        let quick = load_suite(&SuiteName::quick(), None).unwrap();
        let layers = [
            (Origin::Default, Layer::defaults()),
            (Origin::Suite, quick),
            (Origin::CommandLine, lanes(4)),
        ];
        let resolved = resolve(layers).unwrap();
        insta::assert_snapshot!(resolved);
        let mut table: toml::Table = resolved.to_string().parse().unwrap();
        table.remove("suite");
        let layer: Layer = table.try_into().unwrap();
        assert_eq!(layer.lanes, Some(4));
    }
}
