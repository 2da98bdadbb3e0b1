//! Merges layers and checks what concerns several settings at once.

use std::collections::BTreeMap;
use std::fmt;

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use conditions::settings::{
    DocumentSource, Drawn, KEYS, Key, MAX_IMAGES, RunSettings, STREAM_TABLE, Scope, SuiteName,
    WorldStart,
};
use conditions::{
    Condition, Demonstrations, Frames, Mismatch, PolicyKind, Route, Start, Variation,
};
use domain::limits::MAX_EXTERNAL_MEMORIES;
use domain::memory_kind::{EXTERNAL_WORD, NONE_WORD};
use domain::representation::Trajectories;
use domain::{Arm, Representation};
use serde_json::{Map, Value, json};

use super::layer::{Layer, Origin};
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

/// The settings of a plan with the values that `layers`, weakest first, give to [those of a machine](Key::of_machine).
///
/// # Errors
/// When the merged values are not valid settings, which the checks of each layer rule out.
pub fn on_this_machine(
    settings: &RunSettings,
    layers: impl IntoIterator<Item = Layer>,
) -> Result<RunSettings> {
    let mut values = serde_json::to_value(settings)?;
    for layer in layers {
        for key in Key::of_machine() {
            if let Some(value) = layer.values.get(key.name) {
                values[key.name] = value.clone();
            }
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
    let mut merged = MergedLayers::of(layers);
    let policy = merged.choose_policy()?;
    merged.set_default("documents", default_documents(policy).to_string());
    merged.choose_world()?;
    if !merged.values.contains_key("out") {
        let out = format!("runs/{}", merged.folder_name(policy)?);
        merged.set("out", out, Origin::Default);
    }
    merged.choose_plates(policy);
    merged.await_external_memory(policy);
    merged.complete_stream()?;
    let group_origins = merged.complete_groups(policy);
    let MergedLayers { values, origins } = merged;
    let settings: RunSettings = serde_json::from_value(Value::Object(values))
        .context("the settings cannot be put together")?;
    settings.check_size().map_err(Error::msg)?;
    check(&settings)?;
    ensure!(
        origins.get("elsewhere") != Some(&Origin::CommandLine) || settings.demonstrates_elsewhere(),
        "--elsewhere is the warehouse of --demos elsewhere, and of documents in the arm `wrong`; no condition has either"
    );
    Ok(Resolved { settings, origins, group_origins })
}

/// The strongest value of each key, and where it comes from.
#[derive(Debug, Default)]
struct MergedLayers {
    values: Map<String, Value>,
    origins: Origins,
}

impl MergedLayers {
    fn of(layers: impl IntoIterator<Item = Layer>) -> Self {
        let mut merged = Self::default();
        for Layer { origin, values } in layers {
            for (key, value) in values {
                merged.set(&key, value, origin);
            }
        }
        merged
    }

    fn set(&mut self, key: &str, value: impl Into<Value>, origin: Origin) {
        self.values.insert(key.to_owned(), value.into());
        self.origins.insert(key.to_owned(), origin);
    }

    /// Gives `key` the value that it has with the run's policy where nothing sets it.
    fn set_default(&mut self, key: &str, value: impl Into<Value>) {
        if !self.origins.contains_key(key) {
            self.set(key, value, Origin::Policy);
        }
    }

    fn remove(&mut self, key: &str) -> Option<(Value, Origin)> {
        Some((self.values.remove(key)?, self.origins.remove(key)?))
    }

    fn text(&self, key: &str) -> &str {
        self.values.get(key).and_then(Value::as_str).unwrap_or_default()
    }

    /// Whether a variable or flag gives the key.
    fn is_given(&self, key: &str) -> bool {
        self.origins.get(key) >= Some(&Origin::Environment)
    }

    /// The run's policy. Removes the settings of other policies; a flag for another policy is an error.
    fn choose_policy(&mut self) -> Result<PolicyKind> {
        if let Some(&origin) = self.origins.get("policy-cmd")
            && !self.is_given("policy")
        {
            self.set("policy", PolicyKind::External.name(), origin);
        }
        let policy = self.values.get("policy").cloned().unwrap_or_default();
        let policy: PolicyKind = serde_json::from_value(policy)?;
        ensure!(
            policy != PolicyKind::Openai || self.values.contains_key("model"),
            "--policy openai needs --model NAME: the model, by the name that the server knows"
        );
        let of_openai = Key::of_scope(Scope::Model).map(|key| (key.name, PolicyKind::Openai));
        for (key, owner) in of_openai.chain([("policy-cmd", PolicyKind::External)]) {
            if policy == owner {
                continue;
            }
            let removed = self.remove(key);
            // A variable may be set for other runs.
            ensure!(
                !matches!(removed, Some((_, Origin::CommandLine))),
                "--{key} is for --policy {owner}, and the policy is {policy}"
            );
        }
        Ok(policy)
    }

    /// Plates, where nothing says whether there are any: for a policy that needs them.
    fn choose_plates(&mut self, policy: PolicyKind) {
        if !self.values.contains_key("plates") {
            let plates = if policy.needs_plates() { Drawn::On } else { Drawn::Off };
            self.set("plates", plates.name(), Origin::Policy);
        }
    }

    /// A world that a command starts, or one that the user starts, whichever the stronger source says.
    fn choose_world(&mut self) -> Result<()> {
        let origin = |key: &str| self.origins.get(key).copied();
        let (command, book) = (origin("world-cmd"), origin("world-book"));
        ensure!(
            origin("world").is_none() || book.is_some(),
            "--world external needs --world-book DIR, the folder that `your-program book --out DIR` has written the case book to"
        );
        let Some(from) = book else { return Ok(()) };
        ensure!(
            book != command,
            "--world-cmd starts a world, and --world-book is of one that you start: give one of them"
        );
        if book > command {
            self.remove("world-cmd");
            self.set("world", WorldStart::External.name(), from);
        } else {
            self.remove("world");
            self.remove("world-book");
        }
        Ok(())
    }

    /// The default name of a run's folder: suite and policy, and the model of `openai`.
    fn folder_name(&self, policy: PolicyKind) -> Result<String> {
        let suite: SuiteName = serde_json::from_value(self.text("suite").into())?;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        let policy = match policy {
            PolicyKind::Openai => {
                let model = self.text("model").replace(|c| !is_plain(c), "-");
                format!("openai-{model}")
            }
            _ => policy.to_string(),
        };
        Ok(format!("{}-{policy}", suite.word()))
    }

    /// Takes the words that name no built-in memory out of every list of memories. That for an external memory that the user
    /// starts is a setting of the whole run. A policy without memory, or one to which it makes no difference, has no external
    /// memory either, unless the command line asks for it.
    fn await_external_memory(&mut self, policy: PolicyKind) {
        let is_awaited = self.take_memory_words();
        let ignores_memory = irrelevant_to(policy).iter().any(|(key, _)| *key == "memory");
        let uses_commands = !ignores_memory || self.is_given("memory-cmd");
        if !policy.has_process() || !uses_commands {
            self.remove("memory-cmd");
        }
        let uses_awaited = !ignores_memory || self.is_given("memory");
        if is_awaited && policy.has_process() && uses_awaited {
            self.values.insert("external-memory".to_owned(), true.into());
        }
    }

    /// Removes the words that name no built-in memory from the lists of memories. Returns whether one asks for an external memory.
    fn take_memory_words(&mut self) -> bool {
        let mut lists: Vec<&mut Value> = Vec::new();
        for (key, value) in &mut self.values {
            match (key.as_str(), value) {
                ("memory", list) => lists.push(list),
                ("group", Value::Array(groups)) => {
                    lists.extend(groups.iter_mut().filter_map(|group| group.get_mut("memory")));
                }
                _ => {}
            }
        }
        let mut is_awaited = false;
        for list in lists.into_iter().filter_map(Value::as_array_mut) {
            is_awaited |= list.iter().any(|name| name == EXTERNAL_WORD);
            list.retain(|name| name != EXTERNAL_WORD && name != NONE_WORD);
        }
        is_awaited
    }

    /// Puts what flags and variables say about streams into the suite's `[stream]` table.
    fn complete_stream(&mut self) -> Result<()> {
        for key in Key::of_scope(Scope::Stream) {
            let Some(value) = self.values.remove(key.name) else { continue };
            if let Some(Value::Object(table)) = self.values.get_mut(STREAM_TABLE) {
                table.insert(key.name.to_owned(), value);
                continue;
            }
            // A variable may be set for other runs.
            ensure!(
                self.origins.remove(key.name) != Some(Origin::CommandLine),
                "--{} is for a suite of streams, such as --suite stream",
                key.name
            );
        }
        Ok(())
    }

    /// Completes the groups of the suite, or makes the only one of a suite without groups, from the keys of the top level.
    /// Returns where the keys of each come from.
    fn complete_groups(&mut self, policy: PolicyKind) -> Vec<Origins> {
        let mut common = Vec::new();
        for key in Key::of_scope(Scope::Group) {
            if let Some((value, origin)) = self.remove(key.name) {
                common.push((key.name, value, origin));
            }
        }
        let mut groups = match self.remove("group") {
            Some((Value::Array(groups), _)) => groups,
            _ => vec![Value::Object(Map::new())],
        };
        let tables = groups.iter_mut().filter_map(Value::as_object_mut);
        let origins = tables.map(|group| complete(group, &common, policy)).collect();
        self.values.insert("group".to_owned(), groups.into());
        origins
    }
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

/// The documents of a run with this policy where nothing sets them: those of a model are by that model, as in the paper.
fn default_documents(policy: PolicyKind) -> DocumentSource {
    match policy {
        PolicyKind::Openai => DocumentSource::Model(None),
        PolicyKind::Grounded
        | PolicyKind::Imitate
        | PolicyKind::External
        | PolicyKind::Random
        | PolicyKind::Expert => DocumentSource::Extractive,
    }
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
        ("mismatch", json!([Mismatch::None])),
    ];
    match policy {
        PolicyKind::Grounded | PolicyKind::Imitate | PolicyKind::Openai | PolicyKind::External => {
            Vec::new()
        }
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
    check_mismatches(settings)?;
    let conditions = settings.conditions();
    if let Some(flag) = settings.own_world() {
        check_own_world(settings, flag)?;
    }
    ensure!(
        settings.worlds == 1 || settings.stream.is_none(),
        "--worlds is {}, and a suite of streams has one: only the world of an episode can show its views later",
        settings.worlds
    );
    ensure!(
        settings.plates == Drawn::On || !settings.policy.needs_plates(),
        "--policy {} sees nothing but plates, so it cannot run with --plates off: leave that out, or choose another \
         --policy",
        settings.policy
    );
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

/// Checks that memories learn in a suite of streams only, whose episodes all begin alike.
fn check_arms(settings: &RunSettings) -> Result<()> {
    let groups = &settings.groups;
    if settings.stream.is_none() {
        ensure!(
            !groups.iter().any(|group| group.arms.contains(&Arm::Learning)),
            "--arms learning is for a suite of streams, such as --suite stream: outside of streams no memory learns"
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

/// Checks that every mismatch can be one.
fn check_mismatches(settings: &RunSettings) -> Result<()> {
    let Some(first) = settings.mismatches().next() else { return Ok(()) };
    ensure!(
        settings.stream.is_none(),
        "--mismatch {first}, and this is a suite of streams, whose worlds change on their own: leave one of them out"
    );
    ensure!(
        settings.labels == Drawn::On || !settings.mismatches().any(|one| one == Mismatch::Labels),
        "--mismatch labels leaves out labels in the test, and with --labels off demonstrations have none: leave one of \
         them out"
    );
    Ok(())
}

/// Checks that nothing in a run in another world is of the warehouse.
fn check_own_world(settings: &RunSettings, flag: &str) -> Result<()> {
    ensure!(
        settings.policy != PolicyKind::Grounded,
        "--policy grounded reads the plates of the warehouse, and {flag} names another world: choose another --policy, \
         for example imitate"
    );
    let of_warehouse = [
        ("assets", settings.assets.is_some()),
        ("elsewhere", settings.elsewhere.is_some()),
        ("plates", settings.plates == Drawn::On),
        ("labels", settings.labels == Drawn::Off),
        ("appearance-seed", settings.appearance_seed != 0),
        ("frames swapped", settings.frames == Frames::Swapped),
        ("warm-views", settings.warm_views),
        ("adapter", settings.adapter.is_some()),
        ("backend", settings.backend.is_some()),
    ];
    let conditions = settings.conditions();
    let is_wrong_document = |condition: &&Condition| {
        condition.arm == Arm::Wrong && settings.demonstrations_of(condition).take_place_elsewhere()
    };
    if let Some(condition) = conditions.iter().find(is_wrong_document) {
        let memory = condition.memory;
        bail!(
            "{condition}: the documents of {memory} memory are of all cases, so wrong ones are those of another warehouse, and \
             {flag} names a world that has none: leave `wrong` out of --arms, or {memory} out of --memory"
        );
    }
    if let Some((setting, _)) = of_warehouse.into_iter().find(|(_, is_given)| *is_given) {
        bail!(
            "--{setting} is about the warehouse, and {flag} names another world: leave one of them out"
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
        for Key { name, scope, .. } in KEYS {
            match (values.get(*name), origins.get(*name)) {
                // A suite file does not name a suite.
                (Some(value), Some(origin)) if *name == "suite" => {
                    writeln!(f, "{:<44} # {origin}", format!("# suite = {value}"))?;
                }
                (Some(value), Some(origin)) => write_line(f, name, value, *origin)?,
                _ if matches!(scope, Scope::Group | Scope::Stream) => {}
                _ => writeln!(f, "# {name}: not set")?,
            }
        }
        if let Some(stream) = values.get(STREAM_TABLE).and_then(Value::as_object) {
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
            let keys = Key::of_scope(Scope::Group).map(|key| key.name);
            for key in ["name"].into_iter().chain(keys) {
                let origin = origins.get(key).copied().unwrap_or(Origin::Suite);
                if let Some(value) = values.get(key) {
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
