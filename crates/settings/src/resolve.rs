//! Merges layers and checks what concerns several settings at once.

use std::collections::BTreeMap;
use std::fmt;

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use domain::memory_kind::{EXTERNAL_WORD, NONE_WORD};
use domain::representation::Trajectories;
use domain::{Arm, Representation};
use results::conditions::{Condition, Demonstrations, PolicyKind, Route, Start, Variation};
use results::settings::{Drawn, RunSettings, SuiteName};
use serde_json::{Map, Value, json};
use shm_types::message::MAX_EXTERNAL_MEMORIES;

use super::keys::{KEYS, Key, MAX_IMAGES, STREAM_KEYS, model_keys};
use super::layer::{GROUP_KEYS, Layer, Origin};
use super::load_suite;

/// A run's settings, and where each comes from.
#[derive(Debug, Clone)]
pub struct Resolved {
    /// The settings.
    pub settings: RunSettings,
    /// Of the keys outside of groups.
    origins: Origins,
    /// Of each group's keys.
    group_origins: Vec<Origins>,
}

type Origins = BTreeMap<String, Origin>;

/// Settings of the built-in defaults, the suite that `above` names, and the layers `above`, weakest first.
///
/// # Errors
/// When the suite is invalid, settings contradict each other, or nothing is left to run.
pub fn resolve(above: impl IntoIterator<Item = Layer>) -> Result<Resolved> {
    let (defaults, above) = (Layer::defaults()?, Vec::from_iter(above));
    let text = |key| above.iter().rev().find_map(|layer| layer.text(key));
    let suite = text("suite").or(defaults.text("suite")).unwrap_or_default();
    let suite: SuiteName = serde_json::from_value(suite.into())?;
    let suite = load_suite(&suite, text("assets").map(std::path::Path::new))?;
    merge([defaults, suite].into_iter().chain(above))
}

impl Resolved {
    /// Where a key outside of groups comes from; `None` if it has no value.
    pub fn origin(&self, key: &str) -> Option<Origin> {
        self.origins.get(key).copied()
    }

    /// The commands that the suite says, each with its key.
    ///
    /// # Errors
    /// As those of [`commands`].
    pub fn commands_of_suite(&self) -> Result<Vec<(&'static str, String)>> {
        let mut commands = commands(&self.settings)?;
        commands.retain(|(key, _)| self.origin(key) == Some(Origin::Suite));
        Ok(commands)
    }
}

/// The commands that a run with `settings` starts, each with its key.
///
/// # Errors
/// When the settings cannot be written as JSON, which they always can.
pub fn commands(settings: &RunSettings) -> Result<Vec<(&'static str, String)>> {
    let values = serde_json::to_value(settings)?;
    let mut commands = Vec::new();
    for key in KEYS.iter().filter(|key| key.is_command()) {
        let given = match values.get(key.name) {
            Some(Value::Array(list)) => list.iter().collect(),
            one => Vec::from_iter(one),
        };
        commands
            .extend(given.into_iter().filter_map(Value::as_str).map(|c| (key.name, c.to_owned())));
    }
    Ok(commands)
}

/// Keys that another machine may need other values of, and that change no result.
pub const MACHINE_KEYS: &[&str] = &[
    "assets",
    "elsewhere",
    "base-url",
    "max-connections",
    "endpoint-limit",
    "endpoint-limit-folder",
    "max-retries",
    "request-timeout",
    "server-patience",
    "stop-without-action",
    "response-cache",
    "lanes",
    "encoder-threads",
    "frame-budget",
    "warm-views",
    "spin-us",
    "step-timeout",
    "memory-timeout",
    "start-timeout",
];

/// The settings of a plan with the values of [`MACHINE_KEYS`] that `layers`, weakest first, give.
///
/// # Errors
/// When the merged values are not valid settings, which the checks of each layer rule out.
pub fn on_this_machine(
    settings: &RunSettings,
    layers: impl IntoIterator<Item = Layer>,
) -> Result<RunSettings> {
    let mut values = serde_json::to_value(settings)?;
    for layer in layers {
        let given = layer.values.into_iter();
        for (key, value) in given.filter(|(key, _)| MACHINE_KEYS.contains(&key.as_str())) {
            values[key] = value;
        }
    }
    serde_json::from_value(values).context("the settings cannot be put together")
}

/// Checks that every value of `settings`, which were in a file, is one that a suite file could give. Memories are names that the run
/// may have been told.
///
/// # Errors
/// Names the first key whose value is not.
pub fn check_values(settings: &RunSettings) -> Result<()> {
    let values = serde_json::to_value(settings)?;
    let groups = values["group"].as_array().into_iter().flatten();
    let tables = std::iter::once(&values).chain(groups).filter_map(Value::as_object);
    for (name, value) in tables.flatten().filter(|(name, _)| *name != "memory") {
        let checked = Key::find(name).map_or(Ok(()), |key| key.check(value));
        checked.map_err(|problem| anyhow!("{name}: {problem}"))?;
    }
    Ok(())
}

/// Settings of `layers`, weakest first, and of nothing else.
pub(super) fn merge(layers: impl IntoIterator<Item = Layer>) -> Result<Resolved> {
    let mut merged = Map::new();
    let mut origins = Origins::new();
    for Layer { origin, values } in layers {
        origins.extend(values.keys().map(|key| (key.clone(), origin)));
        merged.extend(values);
    }
    let policy = choose_policy(&mut merged, &mut origins)?;
    if !merged.contains_key("out") {
        let out = format!("runs/{}", folder_name(&merged, policy)?);
        merged.insert("out".to_owned(), out.into());
        origins.insert("out".to_owned(), Origin::Default);
    }
    await_external_memory(&mut merged, &mut origins, policy);
    complete_stream(&mut merged, &mut origins)?;
    let groups = match merged.remove("group") {
        Some(Value::Array(groups)) => groups,
        // Without groups there is one, of the top-level keys.
        _ => vec![Value::Object(Map::new())],
    };
    let common: Vec<(&str, Value, Origin)> = GROUP_KEYS
        .iter()
        .filter_map(|key| Some((*key, merged.remove(*key)?, origins.remove(*key)?)))
        .collect();
    origins.remove("group");
    let (mut completed, mut group_origins) = (Vec::new(), Vec::new());
    for group in groups {
        let Value::Object(mut group) = group else { continue };
        group_origins.push(complete(&mut group, &common, policy));
        completed.push(Value::Object(group));
    }
    merged.insert("group".to_owned(), completed.into());
    let settings: RunSettings = serde_json::from_value(Value::Object(merged))
        .context("the settings cannot be put together")?;
    settings.check_size().map_err(Error::msg)?;
    check(&settings)?;
    ensure!(
        origins.get("elsewhere") != Some(&Origin::CommandLine) || settings.demonstrates_elsewhere(),
        "--elsewhere is the warehouse of --demos elsewhere, and no condition has these demonstrations"
    );
    Ok(Resolved { settings, origins, group_origins })
}

/// The run's policy. Removes the settings of other policies; a flag for another policy is an error.
fn choose_policy(merged: &mut Map<String, Value>, origins: &mut Origins) -> Result<PolicyKind> {
    let is_given = |origins: &Origins, key| origins.get(key) >= Some(&Origin::Environment);
    if merged.contains_key("policy-cmd") && !is_given(origins, "policy") {
        merged.insert("policy".to_owned(), PolicyKind::External.name().into());
        origins.insert("policy".to_owned(), origins["policy-cmd"]);
    }
    let policy = serde_json::from_value(merged.get("policy").cloned().unwrap_or_default())?;
    ensure!(
        policy != PolicyKind::Openai || merged.contains_key("model"),
        "--policy openai needs --model NAME: the model, by the name that the server knows"
    );
    let of_openai = model_keys().map(|key| (key, PolicyKind::Openai));
    for (key, only_for) in of_openai.chain([("policy-cmd", PolicyKind::External)]) {
        if policy == only_for {
            continue;
        }
        // A variable may be set for other runs.
        ensure!(
            origins.remove(key) != Some(Origin::CommandLine),
            "--{key} is for --policy {only_for}, and the policy is {policy}"
        );
        merged.remove(key);
    }
    Ok(policy)
}

/// Takes the words that name no built-in memory out of every list of memories. That for an external memory that the user
/// starts is a setting of the whole run. A policy without memory, or one to which it makes no difference, has no external
/// memory either, unless the command line asks for it.
fn await_external_memory(
    merged: &mut Map<String, Value>,
    origins: &mut Origins,
    policy: PolicyKind,
) {
    let mut is_awaited = false;
    let mut take = |memory: Option<&mut Value>| {
        let Some(list) = memory.and_then(Value::as_array_mut) else { return };
        is_awaited |= list.iter().any(|name| name == EXTERNAL_WORD);
        list.retain(|name| name != EXTERNAL_WORD && name != NONE_WORD);
    };
    take(merged.get_mut("memory"));
    let groups = merged.get_mut("group").and_then(Value::as_array_mut);
    for group in groups.into_iter().flatten() {
        take(group.get_mut("memory"));
    }
    let is_given = |key: &str| origins.get(key) >= Some(&Origin::Environment);
    let ignores = irrelevant_to(policy).iter().any(|(key, _)| *key == "memory");
    let (memory, commands) = (is_given("memory"), is_given("memory-cmd"));
    if !policy.has_process() || (ignores && !commands) {
        merged.remove("memory-cmd");
        origins.remove("memory-cmd");
    }
    if is_awaited && policy.has_process() && (!ignores || memory) {
        merged.insert("external-memory".to_owned(), true.into());
    }
}

/// Puts what flags and variables say about streams into the suite's `[stream]` table.
fn complete_stream(merged: &mut Map<String, Value>, origins: &mut Origins) -> Result<()> {
    let mut stream = merged.remove("stream");
    let mut table = stream.as_mut().and_then(Value::as_object_mut);
    for key in STREAM_KEYS {
        let Some(value) = merged.remove(*key) else { continue };
        if let Some(table) = &mut table {
            table.insert((*key).to_owned(), value);
            continue;
        }
        // A variable may be set for other runs.
        ensure!(
            origins.remove(*key) != Some(Origin::CommandLine),
            "--{key} is for a suite of streams, such as --suite stream"
        );
    }
    merged.extend(stream.map(|stream| ("stream".to_owned(), stream)));
    Ok(())
}

/// The default name of a run's folder: suite and policy, and the model of `openai`.
fn folder_name(merged: &Map<String, Value>, policy: PolicyKind) -> Result<String> {
    let text = |key| merged.get(key).and_then(Value::as_str).unwrap_or_default();
    let suite: SuiteName = serde_json::from_value(text("suite").into())?;
    let plain = |c: char| if c.is_ascii_alphanumeric() || ".-_".contains(c) { c } else { '-' };
    let policy = match policy {
        PolicyKind::Openai => {
            format!("openai-{}", text("model").chars().map(plain).collect::<String>())
        }
        _ => policy.to_string(),
    };
    Ok(format!("{}-{policy}", suite.word()))
}

/// Completes a suite's group: a flag or variable replaces what it says, the suite's top level holds where
/// it says nothing. Returns where each key comes from.
fn complete(
    group: &mut Map<String, Value>,
    common: &[(&str, Value, Origin)],
    policy: PolicyKind,
) -> Origins {
    let mut origins = Origins::new();
    for (key, value, origin) in common {
        if *origin >= Origin::Environment || !group.contains_key(*key) {
            group.insert((*key).to_owned(), value.clone());
            origins.insert((*key).to_owned(), *origin);
        } else {
            origins.insert((*key).to_owned(), Origin::Suite);
        }
    }
    for (key, value) in irrelevant_to(policy) {
        let is_given = origins.get(key) >= Some(&Origin::Environment);
        // A policy without a process uses no memory, whatever is asked for.
        let is_possible = policy.has_process() || key == "runs";
        if !is_given || !is_possible {
            group.insert(key.to_owned(), value);
            origins.insert(key.to_owned(), Origin::Policy);
        }
    }
    origins
}

/// The keys that make no difference to a policy that ignores what it is given, each with the value that
/// stands for all.
fn irrelevant_to(policy: PolicyKind) -> Vec<(&'static str, Value)> {
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
        // Every repetition is the same.
        PolicyKind::Expert => given.into_iter().chain([("runs", json!(1))]).collect(),
    }
}

/// Checks what concerns several settings at once. Before external memories have told their names, their conditions are
/// not there yet.
///
/// # Errors
/// For settings that contradict each other, or leave nothing to run.
pub fn check(settings: &RunSettings) -> Result<()> {
    let given = settings.memory_cmd.len() + usize::from(settings.external_memory);
    ensure!(
        given <= MAX_EXTERNAL_MEMORIES,
        "the run has {given} external memories (--memory-cmd, and `external` in --memory), and at most \
         {MAX_EXTERNAL_MEMORIES} run side by side"
    );
    ensure!(
        settings.adapter.is_none() || settings.backend.as_deref() != Some("cpu"),
        "--adapter chooses a graphics adapter, and --backend cpu uses none: give one of them"
    );
    check_arms(settings)?;
    let conditions = settings.conditions();
    if settings.plates == Drawn::Off {
        check_without_plates(settings.policy, &conditions)?;
    }
    let is_complete = !settings.has_external_memories() || !settings.external_names().is_empty();
    if conditions.is_empty() && is_complete {
        let groups = &settings.groups;
        let learns = |arms: &[Arm]| arms == [Arm::Learning];
        ensure!(
            groups.iter().any(|group| !group.memory.is_empty()),
            "no memory is left: `--memory none` is for a memory of your own (--memory-cmd, or `external` in --memory)"
        );
        ensure!(
            !groups.iter().all(|group| learns(&group.arms)),
            "no memory is left that learns: the arm `learning` needs `adaptive`, or a memory of your own that says that \
             it learns"
        );
        bail!(
            "no condition is left: a blocked route needs the new start (add `new` to --starts), and a memory of \
             demonstrations needs some (--demos)"
        );
    }
    // With a model, what exceeds --image-budget is left out and counted.
    if settings.model.is_some() {
        return Ok(());
    }
    for condition in conditions {
        let (images, window) = (settings.images(&condition), condition.variation.window);
        if images > MAX_IMAGES {
            let flags = match condition.memory.describe().map(|info| info.trajectories) {
                Some(Trajectories::Segment) => "--window, --hits or --horizon",
                Some(Trajectories::Whole | Trajectories::Nothing) => "--window or --keyframes",
                None => "--window or --memory-images",
            };
            let remembered = images - 1 - window;
            // Paper, Experimental Setup.
            bail!(
                "a request under {condition} may need {images} images (the current view, {window} of the window, \
                 {remembered} of memory), and a prompt holds at most {MAX_IMAGES}: lower {flags}"
            );
        }
    }
    Ok(())
}

/// Checks that arms are those of a suite of streams, whose episodes all begin alike.
fn check_arms(settings: &RunSettings) -> Result<()> {
    let groups = &settings.groups;
    if settings.stream.is_none() {
        ensure!(
            groups.iter().all(|group| group.arms == [Arm::Frozen]),
            "--arms is for a suite of streams, such as --suite stream: outside of streams every memory is frozen"
        );
        return Ok(());
    }
    let is_standard = |condition: &Condition| {
        condition.start == Start::New
            && condition.route == Route::Unchanged
            && [Demonstrations::NONE, Demonstrations::ORIGINAL].contains(&condition.demonstrations)
    };
    if let Some(other) = settings.conditions().iter().find(|condition| !is_standard(condition)) {
        bail!(
            "{other}: in a suite of streams every episode begins at the new start, on the unchanged route, with the \
             original demonstrations: starts = [\"new\"], routes = [\"unchanged\"], demos = [\"original\"]"
        );
    }
    Ok(())
}

/// Checks that nothing in the run reads plates.
fn check_without_plates(policy: PolicyKind, conditions: &[Condition]) -> Result<()> {
    ensure!(
        policy != PolicyKind::Grounded,
        "--policy grounded sees nothing but plates, so it cannot run with --plates off: leave that out, or choose another \
         --policy"
    );
    let reads = |condition: &&Condition| {
        condition.memory.describe().is_some_and(|info| !info.documents.is_empty())
    };
    if let Some(condition) = conditions.iter().find(reads) {
        bail!(
            "the documents of {} memory are built from the plates in frames, and with --plates off there are none: leave \
             that out, or choose memories without documents (--memory working,full-context,episodic)",
            condition.memory
        );
    }
    Ok(())
}

impl fmt::Display for Resolved {
    /// As a suite file, each line with where it comes from. JSON scalars and arrays are TOML.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let object = |value: serde_json::Result<Value>| match value {
            Ok(Value::Object(object)) => Ok(object),
            _ => Err(fmt::Error),
        };
        let mut values = object(serde_json::to_value(&self.settings))?;
        let mut origins = self.origins.clone();
        let groups = values.get_mut("group").and_then(Value::as_array_mut);
        for group in groups.into_iter().flatten() {
            match group.get_mut("memory").and_then(Value::as_array_mut) {
                Some(list) if self.settings.external_memory => list.push(EXTERNAL_WORD.into()),
                Some(list) if list.is_empty() => list.push(NONE_WORD.into()),
                _ => {}
            }
        }
        let groups = values.get("group").cloned().unwrap_or_default();
        if self.settings.groups.iter().all(|group| group.name.is_none())
            && let Some(Value::Array(groups)) = values.remove("group")
            && let Some(Value::Object(only)) = groups.into_iter().next()
        {
            values.extend(only);
            origins.extend(self.group_origins.iter().flatten().map(|(k, o)| (k.clone(), *o)));
        }
        for key in KEYS.iter().map(|key| key.name) {
            match (values.get(key), origins.get(key)) {
                // A suite file does not name a suite.
                (Some(value), Some(origin)) if key == "suite" => {
                    writeln!(f, "{:<44} # {origin}", format!("# suite = {value}"))?;
                }
                (Some(value), Some(origin)) => write_line(f, key, value, *origin)?,
                _ if GROUP_KEYS.contains(&key) || STREAM_KEYS.contains(&key) => {}
                _ => writeln!(f, "# {key}: not set")?,
            }
        }
        if let Some(stream) = values.get("stream").and_then(Value::as_object) {
            writeln!(f, "\n[stream]")?;
            for (key, value) in stream {
                let origin = self.origins.get(key).copied().unwrap_or(Origin::Suite);
                write_line(f, key, value, origin)?;
            }
        }
        let all = groups.as_array().into_iter().flatten().zip(&self.group_origins);
        for (group, origins) in all.filter(|(group, _)| group.get("name").is_some()) {
            let Some(values) = group.as_object() else { continue };
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
mod tests;
