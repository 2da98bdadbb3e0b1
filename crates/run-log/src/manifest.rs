//! `manifest.json`: what a run is, readable without its episodes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use domain::ExternalName;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{LogError, system};
use crate::usage::UsageTotals;
use conditions::cost::ModelPrices;
use conditions::settings::{Key, RunSettings};

/// Changes when programs that read the old files cannot read the new ones. Since 4, what only the world
/// understands is one object of a record.
pub const FORMAT: u32 = 4;

/// The name of the hash of the other warehouse in which tasks are demonstrated.
pub const ELSEWHERE_HASH: &str = "elsewhere";

/// The name of the hash of the streams.
pub const STREAMS_HASH: &str = "streams";

/// The name of the hash of a user's template of the prompt.
pub const PROMPT_HASH: &str = "prompt";

/// The name of the hash of the case book.
pub const CASE_BOOK_HASH: &str = "case-book";
/// The name of the hash of what a world's cases are made from, where the world has one.
pub(super) const CASES_HASH: &str = "cases";

/// The name of the hash of the demonstrations.
pub const DEMONSTRATIONS_HASH: &str = "demonstrations";

/// Name of the file in a run folder.
pub(super) const MANIFEST_FILE: &str = "manifest.json";

/// What a run is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`] of the folder.
    pub format: u32,
    /// Version of the program.
    pub version: String,
    /// Version of the wire.
    pub wire_version: u32,
    /// Commit that the program was built from, if it was built in a checkout; `+` when that had changes.
    pub commit: Option<String>,
    /// The settings, resolved.
    pub settings: RunSettings,
    /// BLAKE3 hashes of layout, catalogue, cases, ... by name.
    pub hashes: BTreeMap<String, String>,
    /// The types of the tasks of all cases, by the case's id, in runs with banks: a bank holds demonstrations of cases that
    /// the run does not have.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tasks: BTreeMap<String, u8>,
    /// The documents that memory supplies, by name: `summary/4`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub documents: BTreeMap<String, DocumentFacts>,
    /// The external memories, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub memories: BTreeMap<ExternalName, ExternalMemoryFacts>,
    /// The files that the policy's command names, with their BLAKE3 hashes; empty in the manifests of earlier versions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub policy_files: BTreeMap<String, String>,
    /// The files that the command of another world names, with their BLAKE3 hashes.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub world_files: BTreeMap<String, String>,
    /// Whether the world is not deterministic: the same actions may lead elsewhere.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub world_varies: bool,
    /// The prices of the model's tokens, if they were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prices: Option<ModelPrices>,
    /// Episodes of the whole run.
    pub episodes: u32,
    /// The unit of a plan that the run is, if it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<UnitId>,
    /// The facts that each process reported when the run began: adapter, encoder and its hash, policy, ... Empty until
    /// then.
    pub processes: BTreeMap<String, BTreeMap<String, String>>,
}

/// A part of a run that is executed by itself, on any machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnitId {
    /// The BLAKE3 hash of the plan's file, as hexadecimal digits.
    pub plan: String,
    /// Its number, from 0.
    pub number: u32,
}

/// A document that memory supplies.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DocumentFacts {
    /// SHA-256 of its text, as hexadecimal digits.
    pub sha256: String,
    /// The builder: `extractive` or `model`.
    pub builder: String,
    /// The model that wrote it, by the name under which it was asked; absent for other builders, and in the manifests of
    /// earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// What it took of the model; absent as `model` is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usage: Option<DocumentUsage>,
    /// Whether the run had it built. Otherwise it was there before.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub built: bool,
    /// Hash of everything that it depends on; absent in the manifests of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub address: Option<String>,
    /// Bytes of its text.
    pub bytes: u64,
    /// Words of its text.
    pub words: u64,
}

/// The requests to a model that a document took. What the server did not report is absent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DocumentUsage {
    /// Answered requests.
    pub requests: u64,
    /// Tokens of all prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_tokens: Option<u64>,
    /// Tokens of all answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completion_tokens: Option<u64>,
}

impl DocumentUsage {
    /// As totals. Those of a document whose tokens are unknown are in no sum.
    pub fn totals(&self) -> UsageTotals {
        let Self { requests, prompt_tokens, completion_tokens } = *self;
        let tokens = prompt_tokens.zip(completion_tokens);
        let (prompt_tokens, completion_tokens) = tokens.unwrap_or_default();
        let unknown = if tokens.is_some() { 0 } else { requests };
        UsageTotals {
            requests,
            attempts: requests,
            unknown,
            prompt_tokens,
            completion_tokens,
            ..UsageTotals::default()
        }
    }
}

/// An external memory, as it describes itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExternalMemoryFacts {
    /// Its index on the wire.
    pub index: u8,
    /// Its version.
    pub version: String,
    /// The command that started it; absent if the user did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// The demonstrations that one instance of it remembers: those of a `case`, or of `all` cases.
    pub scope: String,
    /// Whether it uses embeddings of views.
    pub embeddings: bool,
    /// Whether it looks at the pixels of remembered views.
    pub frames: bool,
    /// Whether equal queries have equal answers, whatever else it was asked before.
    pub deterministic: bool,
    /// Whether it learns from episodes of streams.
    #[serde(default)]
    pub learns: bool,
    /// Its SDK and that one's version.
    pub sdk: String,
    /// The files that its code is in, with their hashes, as it tells them; empty if it does not, and in the manifests of earlier
    /// versions.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub code: String,
    /// The files that its command names, with their BLAKE3 hashes; empty in the manifests of earlier versions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
}

/// A key in which two manifests differ.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The key.
    pub key: String,
    /// The value in the folder's manifest; of the first run when runs are compared.
    pub there: String,
    /// The value of this command; of the second run.
    pub here: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} there, {} now", self.key, self.there, self.here)
    }
}

/// The role of the policy among the processes, and the fact that tells its code.
pub(super) const POLICY: &str = "policy";
pub(super) const CODE: &str = "code";

/// The key of the policy's code among the [differences](Manifest::differences).
pub(super) const CODE_OF_POLICY: &str = "code of the policy";

/// Hexadecimal digits of a file's hash that a message shows.
const SHOWN_DIGITS: usize = 16;

/// A fact of a run that determines the outcome of its episodes.
struct Fact {
    value: Value,
    /// Whether a run that lacks it can be the same run: it is told later, or programs of earlier versions did not record it.
    may_be_absent: bool,
}

impl Fact {
    fn required(value: impl Into<Value>) -> Self {
        Self { value: value.into(), may_be_absent: false }
    }

    fn optional(value: impl Into<Value>) -> Self {
        Self { value: value.into(), may_be_absent: true }
    }
}

/// Facts by name.
type Facts = BTreeMap<String, Fact>;

/// The facts of the files of a program, which is `of` a memory or policy: their hashes.
fn file_facts<'a>(
    files: &'a BTreeMap<String, String>,
    of: &'a str,
) -> impl Iterator<Item = (String, Fact)> + 'a {
    files.iter().map(move |(file, hash)| {
        let shown = hash.get(..SHOWN_DIGITS).unwrap_or(hash);
        (format!("file {file} of {of}"), Fact::optional(shown))
    })
}

/// The key of a hash among the [differences](Manifest::differences).
pub(super) fn contents_of(name: &str) -> String {
    format!("contents of {name}")
}

/// The program that wrote a manifest, as it names itself there.
fn writer(manifest: &Value) -> String {
    let text = |name: &str| manifest.get(name).and_then(Value::as_str);
    let version = text("version").unwrap_or("of an unknown version");
    let commit = text("commit").map(|commit| format!(" (commit {commit})"));
    format!("memtransfer {version}{}", commit.unwrap_or_default())
}

impl Manifest {
    /// Reads the manifest in the run folder `dir`.
    ///
    /// # Errors
    /// When it is missing or cannot be understood.
    pub fn read(dir: &Path) -> Result<Self, LogError> {
        let path = dir.join(MANIFEST_FILE);
        let text = durable::read(&path).map_err(system("read", &path))?;
        let broken = |problem: String| LogError::BrokenManifest { path: path.clone(), problem };
        let value: Value = serde_json::from_slice(&text).map_err(|e| broken(e.to_string()))?;
        // The format comes first: a manifest of another format may have other fields.
        match value.get("format").and_then(Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => {
                let (path, writer) = (path.clone(), writer(&value));
                return Err(LogError::OtherFormat { path, format, writer });
            }
            None => {
                return Err(broken("it is not the manifest of a run: it has no format".to_owned()));
            }
        }
        let manifest: Self = serde_json::from_value(value).map_err(|e| broken(e.to_string()))?;
        manifest.settings.check_size().map_err(broken)?;
        Ok(manifest)
    }

    /// Writes it into the run folder `dir`: all of it or nothing, and durably.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn write(&self, dir: &Path) -> Result<(), LogError> {
        let path = dir.join(MANIFEST_FILE);
        let draft = dir.join(format!("{MANIFEST_FILE}.new"));
        let write = || {
            let mut text = serde_json::to_vec_pretty(self)?;
            text.push(b'\n');
            durable::replace(&path, &draft, &text)?;
            durable::sync_path(dir)
        };
        write().map_err(system("write", &path))
    }

    /// The manifest of a run that this one continues, which was `there` so far. Settings that may change have this session's
    /// values. Adds a note if the commit is another.
    pub(super) fn continuing(self, there: Self, notes: &mut Vec<String>) -> Self {
        if self.commit != there.commit {
            let commit = |commit: &Option<String>| commit.clone().unwrap_or("unknown".to_owned());
            notes.push(format!(
                "the run began with commit {} and continues with {}",
                commit(&there.commit),
                commit(&self.commit)
            ));
        }
        let mut documents = there.documents;
        for (name, mut document) in self.documents {
            // A session that builds nothing uses the copies of the one that did.
            document.built |= documents.get(&name).is_some_and(|before| before.built);
            documents.insert(name, document);
        }
        let mut memories = there.memories;
        memories.extend(self.memories);
        let (processes, commit, prices) =
            (there.processes, there.commit, self.prices.or(there.prices));
        Self { processes, commit, prices, documents, memories, ..self }
    }

    /// What the documents took that the run has had its model write.
    pub fn built_usage(&self) -> UsageTotals {
        let mut sum = UsageTotals::default();
        let built = self.documents.values().filter(|document| document.built);
        built.filter_map(|document| document.usage).for_each(|usage| sum.merge(&usage.totals()));
        sum
    }

    /// The name that the policy reported, for example a model's; `None` before it has.
    pub fn policy_name(&self) -> Option<&str> {
        self.processes.get("policy")?.get("policy").map(String::as_str)
    }

    /// The files that the policy's code is in, with their hashes, as it tells them; `None` if it does not.
    pub fn policy_code(&self) -> Option<&str> {
        self.processes.get(POLICY)?.get(CODE).map(String::as_str)
    }

    /// The keys whose values make an episode of one run differ from the same episode of the other. Which episodes a run
    /// has is not among them: a run can grow.
    pub fn differences(&self, there: &Self) -> Vec<Difference> {
        let (mut ours, mut theirs) = (self.facts(), there.facts());
        // Another policy is another setting; this is the code of the same one.
        if self.settings.policy_cmd == there.settings.policy_cmd {
            ours.extend(self.policy_facts());
            theirs.extend(there.policy_facts());
        }
        ours.extend(self.world_facts());
        theirs.extend(there.world_facts());
        // A run can grow: by demonstrations in another warehouse, and its books by cases and conditions.
        let selected = |of: &Self| {
            let RunSettings { cases, limit, groups, .. } = &of.settings;
            (cases.clone(), *limit, groups.clone())
        };
        if selected(self) != selected(there) {
            for key in [CASE_BOOK_HASH, DEMONSTRATIONS_HASH].map(contents_of) {
                ours.remove(&key);
                theirs.remove(&key);
            }
        }
        let differs = |key: &&String| match (ours.get(*key), theirs.get(*key)) {
            (Some(ours), Some(theirs)) => ours.value != theirs.value,
            (Some(fact), None) | (None, Some(fact)) => !fact.may_be_absent,
            (None, None) => false,
        };
        let shown = |fact: Option<&Fact>| {
            fact.map_or_else(|| "not set".to_owned(), |fact| fact.value.to_string())
        };
        let keys: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
        keys.into_iter()
            .filter(differs)
            .map(|key| Difference {
                key: key.clone(),
                there: shown(theirs.get(key)),
                here: shown(ours.get(key)),
            })
            .collect()
    }

    /// What two runs must have in common for their figures to be comparable: the suite, the world and how it looks, the
    /// cases, the seed, the limits of an episode, and the version of the program. Policy and memory are not among it, because
    /// they are what is compared; neither are conditions and repetitions, which a figure names.
    pub(super) fn protocol(&self) -> BTreeMap<String, Value> {
        const CONTENTS: [&str; 4] = ["layout", "catalogue", CASES_HASH, ELSEWHERE_HASH];
        let settings = self.settings_by_key().into_iter();
        let mut protocol: BTreeMap<String, Value> =
            settings.filter(|(key, _)| Key::is_of_protocol(key)).collect();
        let contents = self.hashes.iter().filter(|(name, _)| CONTENTS.contains(&name.as_str()));
        protocol.extend(contents.map(|(name, hash)| (contents_of(name), hash.clone().into())));
        protocol.insert("suite".to_owned(), self.settings.suite.word().into());
        protocol.insert("version".to_owned(), self.version.clone().into());
        protocol
    }

    fn settings_by_key(&self) -> Map<String, Value> {
        match serde_json::to_value(&self.settings) {
            Ok(Value::Object(settings)) => settings,
            _ => Map::new(),
        }
    }

    /// The facts that determine the outcome of an episode, but for those of the policy's code.
    fn facts(&self) -> Facts {
        let mut facts = Facts::new();
        for (key, value) in self.settings_by_key() {
            if Key::changes_outcome(&key) {
                facts.insert(key, Fact::required(value));
            }
        }
        facts.insert("version".to_owned(), Fact::required(self.version.clone()));
        if let Some(UnitId { plan, number }) = &self.unit {
            facts.insert("unit".to_owned(), Fact::required(format!("{number} of {plan}")));
        }
        for (name, hash) in &self.hashes {
            // A run can grow by demonstrations in another warehouse.
            let may_be_absent =
                [ELSEWHERE_HASH, CASE_BOOK_HASH, DEMONSTRATIONS_HASH].contains(&name.as_str());
            facts.insert(contents_of(name), Fact { value: hash.clone().into(), may_be_absent });
        }
        for (name, document) in &self.documents {
            let hash = Fact::optional(document.sha256.clone());
            facts.insert(format!("document {name}"), hash);
        }
        for (name, memory) in &self.memories {
            facts.extend(memory.facts(&format!("memory {name}")));
        }
        facts
    }

    /// The facts of the world's code.
    fn world_facts(&self) -> Facts {
        file_facts(&self.world_files, "the world").collect()
    }

    /// The facts of the policy's code.
    fn policy_facts(&self) -> Facts {
        let mut facts: Facts = file_facts(&self.policy_files, "the policy").collect();
        let code = self.policy_code().map(|code| (CODE_OF_POLICY.to_owned(), Fact::optional(code)));
        facts.extend(code);
        facts
    }
}

impl ExternalMemoryFacts {
    /// What makes it answer as it does; `name` says which memory it is. Index and SDK may change, and who starts it.
    fn facts(&self, name: &str) -> Facts {
        let mut facts: Facts = file_facts(&self.files, name).collect();
        let described: [(&str, Value); 6] = [
            ("version", self.version.clone().into()),
            ("scope", self.scope.clone().into()),
            ("embeddings", self.embeddings.into()),
            ("frames", self.frames.into()),
            ("deterministic", self.deterministic.into()),
            ("learning", self.learns.into()),
        ];
        let command = self.command.clone().map(|command| ("command", command.into()));
        // One that does not tell it, as the SDK of an earlier version, is not another.
        let code = (!self.code.is_empty()).then(|| ("code", self.code.clone().into()));
        for (fact, value) in described.into_iter().chain(command).chain(code) {
            facts.insert(format!("{fact} of {name}"), Fact::optional(value));
        }
        facts
    }
}
