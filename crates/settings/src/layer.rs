//! What each source of settings says: defaults, suite, environment, command line.

use std::ffi::OsString;
use std::fmt;

use anyhow::{Result, anyhow, ensure};
use conditions::settings::{KEYS, Key, STREAM_TABLE, Scope, StreamSettings, VARIABLE_PREFIX};
use domain::names::{UnknownName, nearest};
use serde_json::{Map, Value};

/// Variables with the prefix that are not settings: folders, the user's own ONNX Runtime, the program that the Python package starts,
/// and what tests use.
const OTHER_VARIABLES: [&str; 7] =
    ["CACHE", "RUN_DIR", "ATTACH", "WORLD_INDEX", "REGENERATE", "ONNXRUNTIME", "PROGRAM"];
const TEST_VARIABLES: &str = "TEST_";

/// Where a setting comes from, weakest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// The built-in default.
    Default,
    /// The suite.
    Suite,
    /// The policy, which needs the value, for which the setting makes no difference, or on which its default depends.
    Policy,
    /// A `MEMTRANSFER_*` variable.
    Environment,
    /// A flag.
    CommandLine,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::Suite => "suite",
            Self::Policy => "policy",
            Self::Environment => "environment",
            Self::CommandLine => "command line",
        })
    }
}

/// The settings of one source, by key. Every value has been checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    pub(super) origin: Origin,
    pub(super) values: Map<String, Value>,
}

impl Layer {
    /// The built-in defaults.
    ///
    /// # Errors
    /// When a setting cannot have its default; a test rules that out.
    pub fn defaults() -> Result<Self> {
        let mut values = Map::new();
        for key in KEYS {
            let Some(default) = key.default else { continue };
            let value = key
                .read(default)
                .map_err(|problem| anyhow!("default of {}: {problem}", key.name))?;
            values.insert(key.name.to_owned(), value);
        }
        Ok(Self { origin: Origin::Default, values })
    }

    /// The flags `given`, each with its text; one that can be repeated may come several times.
    ///
    /// # Errors
    /// For a value that a flag cannot have; the message names the flag.
    pub fn flags<'a>(given: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self> {
        let mut values = Map::new();
        for (name, text) in given {
            let key = Key::find(name).ok_or_else(|| anyhow!("--{name}: there is no such flag"))?;
            let value = key.read(text).map_err(|problem| anyhow!("--{name}: {problem}"))?;
            match (values.get_mut(name).and_then(Value::as_array_mut), value) {
                (Some(before), Value::Array(more)) if key.is_repeated() => before.extend(more),
                (_, value) => drop(values.insert(name.to_owned(), value)),
            }
        }
        Ok(Self { origin: Origin::CommandLine, values })
    }

    /// The variables among `variables` that set something. An empty one sets nothing.
    ///
    /// # Errors
    /// For a variable that has the prefix and names no setting, and for a value that a setting
    /// cannot have; the message names the variable.
    pub fn environment(variables: impl IntoIterator<Item = (OsString, OsString)>) -> Result<Self> {
        let mut values = Map::new();
        for (variable, text) in variables {
            let Some(variable) = variable.to_str().filter(|name| name.starts_with(VARIABLE_PREFIX))
            else {
                continue;
            };
            let word = &variable[VARIABLE_PREFIX.len()..];
            if OTHER_VARIABLES.contains(&word) || word.starts_with(TEST_VARIABLES) {
                continue;
            }
            ensure!(
                word != "ALLOW_COMMANDS",
                "{variable}: no variable allows the commands of a file, since it would hold for every file: give \
                 --allow-commands"
            );
            let Some(key) = KEYS.iter().find(|key| key.variable() == variable) else {
                let known: Vec<String> = KEYS.iter().map(Key::variable).collect();
                return Err(UnknownName::new("environment variable", variable, known).into());
            };
            if text.is_empty() {
                continue;
            }
            let value = text.to_str().ok_or_else(|| "is not UTF-8".to_owned());
            let value = value.and_then(|text| key.read(text));
            let value = value.map_err(|problem| anyhow!("{variable}: {problem}"))?;
            values.insert(key.name.to_owned(), value);
        }
        Ok(Self { origin: Origin::Environment, values })
    }

    /// The suite in `text`; `file` names it in messages.
    ///
    /// # Errors
    /// For text that is not TOML, for an unknown key, and for a value that a key cannot have.
    pub(super) fn suite(file: &str, text: &str) -> Result<Self> {
        let invalid = |place: &str, problem: &str| anyhow!("suite {file}{place}: {problem}");
        let values: Map<String, Value> = toml::from_str(text)
            .map_err(|error: toml::de::Error| invalid("", error.to_string().trim_end()))?;
        let top: Vec<&str> = KEYS
            .iter()
            .filter(|key| key.name != "suite" && key.scope != Scope::Stream)
            .map(|key| key.name)
            .chain([STREAM_TABLE, "group"])
            .collect();
        let check = |table: &Map<String, Value>, known: &[&str], place: &str| {
            for (name, value) in table {
                if !known.contains(&name.as_str()) {
                    let hint = match nearest(name, known) {
                        Some(nearest) => format!(": did you mean `{nearest}`?"),
                        None => format!(" (known: {})", known.join(", ")),
                    };
                    return Err(invalid(place, &format!("unknown key `{name}`{hint}")));
                }
                let checked = Key::find(name).map_or(Ok(()), |key| key.check(value));
                checked.map_err(|problem| invalid(place, &format!("{name}: {problem}")))?;
            }
            Ok(())
        };
        check(&values, &top, "")?;
        if let Some(stream) = values.get(STREAM_TABLE) {
            serde_json::from_value::<StreamSettings>(stream.clone())
                .map_err(|error| invalid(", stream", &error.to_string()))?;
        }
        let groups = match values.get("group") {
            None => Vec::new(),
            Some(Value::Array(groups)) => groups.iter().filter_map(Value::as_object).collect(),
            Some(_) => return Err(invalid("", "`group` is not a list of tables")),
        };
        let of_group = Key::of_scope(Scope::Group).map(|key| key.name);
        let of_group: Vec<&str> = ["name"].into_iter().chain(of_group).collect();
        let mut names = Vec::new();
        for (number, group) in (1..).zip(groups) {
            check(group, &of_group, &format!(", group {number}"))?;
            match group.get("name").and_then(Value::as_str) {
                Some(name) if !names.contains(&name) => names.push(name),
                _ => return Err(invalid("", "every [[group]] needs its own `name`")),
            }
        }
        Ok(Self { origin: Origin::Suite, values })
    }

    /// Whether the layer has a key.
    pub fn has(&self, key: &str) -> bool {
        self.values.contains_key(key)
    }

    /// The text of a key, if the layer has it.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.values.get(key)?.as_str()
    }

    /// Removes a key and returns its text, if the layer has it.
    pub fn take_text(&mut self, key: &str) -> Option<String> {
        self.values.remove(key)?.as_str().map(str::to_owned)
    }
}

/// The value that the environment gives to the one setting called `name`, for verbs that have few.
///
/// # Errors
/// When the variable has a value that the setting cannot have; the message names the variable.
pub fn variable(name: &str) -> Result<Option<Value>> {
    let Some(key) = Key::find(name) else { return Ok(None) };
    let variable = key.variable();
    let Some(text) = std::env::var_os(&variable) else { return Ok(None) };
    let layer = Layer::environment([(variable.into(), text)])?;
    Ok(layer.values.get(name).cloned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(variable: &str, value: &str) -> Result<Layer, String> {
        Layer::environment([(variable.into(), value.into())]).map_err(|error| error.to_string())
    }

    #[test]
    fn a_variable_that_is_wrong_is_named_itself() {
        insta::assert_snapshot!(environment("MEMTRANSFER_LANES", "abc").unwrap_err(), @"MEMTRANSFER_LANES: abc is not a whole number from 1 to 1024");
        let unknown = environment("MEMTRANSFER_LANS", "3").unwrap_err();
        assert!(
            unknown.starts_with(
                "unknown environment variable `MEMTRANSFER_LANS`: did you mean `MEMTRANSFER_LANES`?"
            ),
            "{unknown}"
        );
        insta::assert_snapshot!(environment("MEMTRANSFER_ALLOW_COMMANDS", "1").unwrap_err(), @"MEMTRANSFER_ALLOW_COMMANDS: no variable allows the commands of a file, since it would hold for every file: give --allow-commands");
        for (other, value) in
            [("MEMTRANSFER_PROGRAM", "x"), ("LANES", "abc"), ("MEMTRANSFER_LANES", "")]
        {
            assert!(environment(other, value).unwrap().values.is_empty(), "{other}");
        }
        let layer = environment("MEMTRANSFER_LOG_PROMPTS", "1").unwrap();
        assert_eq!(layer.values["log-prompts"], Value::Bool(true));
    }

    #[test]
    fn a_flag_that_is_wrong_is_named() {
        let error = |name, text| Layer::flags([(name, text)]).unwrap_err().to_string();
        insta::assert_snapshot!(error("lanes", "0"), @"--lanes: 0 is not a whole number from 1 to 1024");
        insta::assert_snapshot!(error("frame-size", "100"), @"--frame-size: 100 is not a multiple of 64 from 64 to 4096");
        insta::assert_snapshot!(error("window", "6,40"), @"--window: 40 is not a whole number from 0 to 32");
        insta::assert_snapshot!(error("max-cost", "free"), @"--max-cost: free is not an amount of money, such as 0.25");
        insta::assert_snapshot!(error("policy", "ground"), @"--policy: unknown policy `ground`: did you mean `grounded`? (known: grounded, imitate, openai, external, random, expert)");
        insta::assert_snapshot!(error("policy-cmd", "a 'b"), @"--policy-cmd: `a 'b` is not a program and its arguments, with every quote closed");
    }

    #[test]
    fn defaults_are_values_that_keys_can_have() {
        let defaults = Layer::defaults().unwrap();
        assert_eq!(defaults.values["max-steps"], domain::MAX_STEPS);
        assert_eq!(defaults.values["image-budget"], conditions::settings::MAX_IMAGES);
    }

    #[test]
    fn errors_in_a_suite_name_its_file() {
        let error = |text: &str| Layer::suite("my.toml", text).unwrap_err().to_string();
        insta::assert_snapshot!(error("memry = []"), @"suite my.toml: unknown key `memry`: did you mean `memory`?");
        insta::assert_snapshot!(error("runs = 1\nmemory = [\"episodik\"]"), @"suite my.toml: memory: unknown memory `episodik`: did you mean `episodic`? (known: working, full-context, summary, semantic, hybrid, episodic, adaptive)");
        insta::assert_snapshot!(error("[[group]]\nname = \"a\"\n[[group]]\nstart = []"), @"suite my.toml, group 2: unknown key `start`: did you mean `starts`?");
        insta::assert_snapshot!(error("[[group]]\nname = \"a\"\nlanes = 3"), @"suite my.toml, group 1: unknown key `lanes` (known: name, memory, starts, routes, demos, arms, runs, window, segment, hint, mismatch)");
        insta::assert_snapshot!(error("[[group]]\nname = \"a\"\nruns = 0"), @"suite my.toml, group 1: runs: 0 is not a whole number from 1 to 1000");
        for nameless in ["[[group]]\nruns = 3", "[[group]]\nname = \"a\"\n[[group]]\nname = \"a\""]
        {
            assert_eq!(error(nameless), "suite my.toml: every [[group]] needs its own `name`");
        }
        assert!(error("suite = \"quick\"").contains("unknown key `suite`"));
        assert!(error("runs = = 3").starts_with("suite my.toml: TOML parse error at line 1"));
    }
}
