//! Layers on top of each other, and whether the outcome can be.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use domain::Representation;
use results::conditions::{PolicyKind, Variation};
use results::settings::{Group, RunSettings, SuiteName};
use serde_json::{Map, Value, json};
use shm_types::message::{MAX_SEGMENT, MAX_WINDOW};

use super::images::check_images;
use super::{GROUP_KEYS, Layer, MAX_IMAGES, MODEL_KEYS, TooManyImages};

/// Where a setting comes from, weakest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// Nobody said anything.
    Default,
    /// The suite.
    Suite,
    /// The policy, to which what is varied makes no difference.
    Policy,
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
            Self::Policy => "policy",
            Self::Environment => "environment",
            Self::CommandLine => "command line",
        })
    }
}

/// Settings, and where each comes from.
#[derive(Debug, Clone)]
pub struct Resolved {
    /// The settings.
    pub settings: RunSettings,
    /// Of the keys that are not a group's.
    origins: Origins,
    /// Of each group's keys.
    group_origins: Vec<Origins>,
}

type Origins = BTreeMap<String, Origin>;

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
    /// A flag that is for another policy.
    #[error("--{key} is for --policy {only_for}, and the policy is {policy}")]
    OtherPolicy {
        /// The flag.
        key: &'static str,
        /// The policy it is for.
        only_for: PolicyKind,
        /// The policy there is.
        policy: PolicyKind,
    },
    /// Nobody said which model.
    #[error(
        "--policy openai needs a model: say --model NAME, by the name that the server knows it by"
    )]
    NoModel,
    /// Nothing is left to run.
    #[error(
        "no condition is left: a blocked route needs the new start (add `new` to --starts), a memory of \
         demonstrations needs some (--demos), and each list needs an entry"
    )]
    NoCondition,
    /// A request could hold more images than a prompt does.
    #[error(transparent)]
    Images(#[from] TooManyImages),
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
    let mut origins = Origins::new();
    for (origin, layer) in layers {
        let Value::Object(said) = serde_json::to_value(layer)? else { continue };
        origins.extend(said.keys().map(|key| (key.clone(), origin)));
        merged.extend(said);
    }
    let policy = choose_policy(&mut merged, &mut origins)?;
    if !merged.contains_key("out") {
        let out = PathBuf::from(format!("runs/{}", folder_name(&merged, policy)?));
        merged.insert("out".to_owned(), serde_json::to_value(out)?);
        origins.insert("out".to_owned(), Origin::Default);
    }
    let said = match merged.remove("group") {
        Some(Value::Array(groups)) => groups,
        // Without groups there is one, of the top-level keys.
        _ => vec![Value::Object(Map::new())],
    };
    let common: Vec<(&str, Value, Origin)> = GROUP_KEYS
        .iter()
        .filter_map(|key| Some((*key, merged.remove(*key)?, origins.remove(*key)?)))
        .collect();
    origins.remove("group");
    let (mut groups, mut group_origins) = (Vec::new(), Vec::new());
    for group in said {
        let Value::Object(mut group) = group else { continue };
        group_origins.push(complete(&mut group, &common, policy));
        groups.push(Value::Object(group));
    }
    merged.insert("group".to_owned(), Value::Array(groups));
    let settings: RunSettings = serde_json::from_value(Value::Object(merged))?;
    check(&settings)?;
    Ok(Resolved { settings, origins, group_origins })
}

/// Which policy the layers come to. Takes away what is not for it; what somebody asked for and cannot have is an
/// error.
fn choose_policy(
    merged: &mut Map<String, Value>,
    origins: &mut Origins,
) -> Result<PolicyKind, SettingsError> {
    let asked_for = |origins: &Origins, key| origins.get(key) >= Some(&Origin::Environment);
    if merged.contains_key("policy-cmd") && !asked_for(origins, "policy") {
        merged.insert("policy".to_owned(), PolicyKind::External.name().into());
        origins.insert("policy".to_owned(), origins["policy-cmd"]);
    }
    let policy = serde_json::from_value(merged.get("policy").cloned().unwrap_or_default())?;
    let only_for = |key, only_for| SettingsError::OtherPolicy { key, only_for, policy };
    if policy != PolicyKind::External && merged.contains_key("policy-cmd") {
        return Err(only_for("policy-cmd", PolicyKind::External));
    }
    if policy == PolicyKind::Openai {
        return if merged.contains_key("model") { Ok(policy) } else { Err(SettingsError::NoModel) };
    }
    for key in MODEL_KEYS {
        // A variable may be there for other runs.
        if origins.get(*key) == Some(&Origin::CommandLine) {
            return Err(only_for(key, PolicyKind::Openai));
        }
        merged.remove(*key);
        origins.remove(*key);
    }
    Ok(policy)
}

/// What a run's folder is called when nobody says it: suite and policy, and which model it asks.
fn folder_name(merged: &Map<String, Value>, policy: PolicyKind) -> Result<String, SettingsError> {
    let word = |key| merged.get(key).and_then(Value::as_str).unwrap_or_default();
    let suite: SuiteName = serde_json::from_value(word("suite").into())?;
    let plain = |c: char| if c.is_ascii_alphanumeric() || ".-_".contains(c) { c } else { '-' };
    let who = match policy {
        PolicyKind::Openai => {
            format!("openai-{}", word("model").chars().map(plain).collect::<String>())
        }
        _ => policy.to_string(),
    };
    Ok(format!("{}-{who}", suite.word()))
}

/// Completes what a suite says of a group: a flag or variable replaces it, what is said at the top level holds
/// where it says nothing. Returns where each key comes from.
fn complete(
    group: &mut Map<String, Value>,
    common: &[(&str, Value, Origin)],
    policy: PolicyKind,
) -> Origins {
    let mut origins = Origins::new();
    for (key, value, origin) in common {
        let origin = match origin {
            Origin::Environment | Origin::CommandLine => *origin,
            _ if group.contains_key(*key) => Origin::Suite,
            _ => *origin,
        };
        if origin != Origin::Suite || !group.contains_key(*key) {
            group.insert((*key).to_owned(), value.clone());
        }
        origins.insert((*key).to_owned(), origin);
    }
    for (key, value) in makes_no_difference(policy) {
        let is_asked_for = origins.get(key) >= Some(&Origin::Environment);
        // A policy without a process can be given nothing, whatever is asked for.
        let is_possible = policy.has_process() || key == "runs";
        if !is_asked_for || !is_possible {
            group.insert(key.to_owned(), value);
            origins.insert(key.to_owned(), Origin::Policy);
        }
    }
    origins
}

/// What a suite need not vary for a policy that decides without looking, with the value that stands for all:
/// each start and route then is run once, not once for every memory.
fn makes_no_difference(policy: PolicyKind) -> Vec<(&'static str, Value)> {
    let Variation { window, segment, hint } = Variation::STANDARD;
    let given = vec![
        ("memory", json!([Representation::Working])),
        ("window", json!([window])),
        ("segment", json!([segment])),
        ("hint", json!([hint])),
    ];
    match policy {
        PolicyKind::Grounded | PolicyKind::Openai | PolicyKind::External => Vec::new(),
        PolicyKind::Random => given,
        // It does the same in every run.
        PolicyKind::Expert => given.into_iter().chain([("runs", json!(1))]).collect(),
    }
}

/// Whether every value can be.
fn check(settings: &RunSettings) -> Result<(), SettingsError> {
    let numbers = [
        ("--max-steps", settings.max_steps, 1, 10_000),
        ("--horizon", settings.horizon, 0, MAX_SEGMENT as u32 - 1),
        ("--keyframes", settings.keyframes, 1, MAX_IMAGES),
        ("--frame-size", settings.frame_size, 64, 4096),
        ("--lanes", settings.lanes, 1, 1024),
        ("--spin-us", settings.spin_us, 0, 1_000_000),
        ("--step-timeout", settings.step_timeout, 1, 86_400),
        ("--start-timeout", settings.start_timeout, 1, 86_400),
    ];
    let model = settings.model.iter().flat_map(|model| {
        [
            ("--image-budget", model.image_budget, 0, 1000),
            ("--answer-tokens", model.answer_tokens, 1, 100_000),
            ("--max-connections", model.max_connections, 1, 1024),
            ("--max-retries", model.max_retries, 0, 100),
            ("--request-timeout", model.request_timeout, 1, 86_400),
        ]
    });
    let varied = settings.groups.iter().flat_map(|group: &Group| {
        let windows = group.window.iter();
        let windows = windows.map(|&window| ("--window", window, 0, MAX_WINDOW as u32));
        windows.chain([("--runs", group.runs, 1, 1000)])
    });
    for (key, value, least, most) in numbers.into_iter().chain(model).chain(varied) {
        if !(least..=most).contains(&value) {
            let expected = format!("{least} to {most}");
            return Err(SettingsError::Value { key, value: value.to_string(), expected });
        }
    }
    for (key, value) in
        [("--encoder-threads", settings.encoder_threads), ("--frame-budget", settings.frame_budget)]
    {
        if value == Some(0) {
            let expected = "at least 1".to_owned();
            return Err(SettingsError::Value { key, value: "0".to_owned(), expected });
        }
    }
    if !settings.frame_size.is_multiple_of(64) {
        return Err(SettingsError::Value {
            key: "--frame-size",
            value: settings.frame_size.to_string(),
            expected: "a multiple of 64".to_owned(),
        });
    }
    let words = settings.policy_cmd.as_deref().map(|command| (command, shlex::split(command)));
    if let Some((command, words)) = words
        && words.is_none_or(|words| words.is_empty())
    {
        let expected = "a program and its arguments, every quote closed".to_owned();
        let value = format!("{command:?}");
        return Err(SettingsError::Value { key: "--policy-cmd", value, expected });
    }
    if settings.conditions().is_empty() {
        return Err(SettingsError::NoCondition);
    }
    Ok(check_images(settings)?)
}

impl Resolved {
    /// The groups that a suite file gave a name, with where each key comes from.
    fn named_groups(&self) -> impl Iterator<Item = (&Group, &Origins)> {
        let groups = self.settings.groups.iter().zip(&self.group_origins);
        groups.filter(|(group, _)| group.name.is_some())
    }
}

impl fmt::Display for Resolved {
    /// As a suite file would say it, each line with where it comes from. JSON scalars and arrays are TOML.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Ok(Value::Object(mut values)) = serde_json::to_value(&self.settings) else {
            return Err(fmt::Error);
        };
        let mut origins = self.origins.clone();
        if self.named_groups().next().is_none()
            && let Some(Value::Array(groups)) = values.remove("group")
            && let Some(Value::Object(only)) = groups.into_iter().next()
        {
            values.extend(only);
            origins.extend(self.group_origins.iter().flatten().map(|(k, o)| (k.clone(), *o)));
        }
        for key in Layer::keys() {
            match (values.get(&key), origins.get(&key)) {
                // A suite file does not name a suite.
                (Some(value), Some(origin)) if key == "suite" => {
                    writeln!(f, "{:<44} # {origin}", format!("# suite = {value}"))?;
                }
                (Some(value), Some(origin)) => write_line(f, &key, value, *origin)?,
                _ if GROUP_KEYS.contains(&key.as_str()) => {}
                _ => writeln!(f, "# {key}: not set")?,
            }
        }
        for (group, origins) in self.named_groups() {
            let Ok(Value::Object(values)) = serde_json::to_value(group) else {
                return Err(fmt::Error);
            };
            writeln!(f, "\n[[group]]")?;
            for key in ["name"].iter().chain(GROUP_KEYS) {
                let origin = origins.get(*key).copied().unwrap_or(Origin::Suite);
                if let Some(value) = values.get(*key) {
                    write_line(f, key, value, origin)?;
                }
            }
        }
        Ok(())
    }
}

fn write_line(f: &mut fmt::Formatter<'_>, key: &str, value: &Value, origin: Origin) -> fmt::Result {
    writeln!(f, "{:<44} # {origin}", format!("{key} = {value}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::load_suite;
    use results::conditions::{Route, Start};

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
        let dir = tempfile::tempdir().unwrap();
        let shown = |resolved: &Resolved| {
            let path = dir.path().join("shown.toml");
            std::fs::write(&path, resolved.to_string()).unwrap();
            let suite: SuiteName = path.display().to_string().parse().unwrap();
            let layer = load_suite(&suite, None).unwrap();
            resolve([(Origin::Default, Layer::defaults()), (Origin::Suite, layer)]).unwrap()
        };
        assert_eq!(shown(&resolved).settings.lanes, 4);
        let layers = [
            (Origin::Default, Layer::defaults()),
            (Origin::Suite, toml::from_str(GROUPS).unwrap()),
        ];
        let resolved = resolve(layers).unwrap();
        insta::assert_snapshot!("groups-as-a-suite-file", resolved);
        assert_eq!(shown(&resolved).settings, resolved.settings);
    }

    const GROUPS: &str = r#"
runs = 3
memory = ["working"]
out = "elsewhere"

[[group]]
name = "one"
starts = ["original"]

[[group]]
name = "two"
memory = ["episodic", "summary"]
demos = ["4"]
window = [0, 6]
runs = 5
"#;

    fn in_groups(policy: PolicyKind, said: Layer) -> String {
        let suite = Layer { policy: Some(policy), ..toml::from_str(GROUPS).unwrap() };
        let layers = [
            (Origin::Default, Layer::defaults()),
            (Origin::Suite, suite),
            (Origin::CommandLine, said),
        ];
        let conditions = resolve(layers).unwrap().settings.runs();
        let shown = conditions.iter().map(|(condition, runs)| format!("{condition} x{runs}"));
        shown.collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn what_is_said_at_the_top_holds_in_groups_and_flags_replace_both() {
        insta::assert_snapshot!(in_groups(PolicyKind::Grounded, Layer::default()), @"
        working/original/unchanged/none x3
        episodic/original/unchanged/4/h0 x5
        episodic/original/unchanged/4 x5
        episodic/new/unchanged/4/h0 x5
        episodic/new/unchanged/4 x5
        summary/original/unchanged/4/h0 x5
        summary/original/unchanged/4 x5
        summary/new/unchanged/4/h0 x5
        summary/new/unchanged/4 x5
        ");
        let flags = Layer {
            memory: Some(vec![Representation::Episodic]),
            starts: Some(vec![Start::New]),
            runs: Some(2),
            ..Layer::default()
        };
        insta::assert_snapshot!(in_groups(PolicyKind::Grounded, flags), @"
        episodic/new/unchanged/original x2
        episodic/new/unchanged/4/h0 x2
        episodic/new/unchanged/4 x2
        ");
    }

    #[test]
    fn a_policy_that_does_not_look_is_run_once_for_all_memories() {
        insta::assert_snapshot!(in_groups(PolicyKind::Expert, Layer::default()), @"
        working/original/unchanged/none x1
        working/new/unchanged/none x1
        ");
        insta::assert_snapshot!(in_groups(PolicyKind::Random, Layer::default()), @"
        working/original/unchanged/none x5
        working/new/unchanged/none x5
        ");
        // Asked for, to see what memory costs.
        let episodic = Layer { memory: Some(vec![Representation::Episodic]), ..Layer::default() };
        insta::assert_snapshot!(in_groups(PolicyKind::Random, episodic.clone()), @"
        episodic/original/unchanged/original x3
        episodic/original/unchanged/4 x5
        episodic/new/unchanged/4 x5
        ");
        insta::assert_snapshot!(in_groups(PolicyKind::Expert, episodic), @"
        working/original/unchanged/none x1
        working/new/unchanged/none x1
        ");
    }

    #[test]
    fn requests_with_too_many_images_are_refused() {
        let error = |layer| with(layer).unwrap_err().to_string();
        let window = |window| Layer { window: Some(vec![6, window]), ..Layer::default() };
        insta::assert_snapshot!(error(window(20)), @"a request under full-context/original/unchanged/original/h20 may need 61 images (the current view, 20 of the window, 40 remembered), and a prompt holds at most 50: lower --window or --keyframes");
        let long = Layer { horizon: Some(30), keyframes: Some(20), ..window(20) };
        insta::assert_snapshot!(error(long), @"a request under episodic/original/unchanged/original/h20 may need 52 images (the current view, 20 of the window, 31 remembered), and a prompt holds at most 50: lower --window or --horizon");
        assert!(with(Layer { keyframes: Some(43), ..Layer::default() }).is_ok(), "50 images");
        assert!(error(window(33)).starts_with("--window is 33, but must be 0 to 32"));
    }
}
