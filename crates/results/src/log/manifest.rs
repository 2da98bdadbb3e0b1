//! `manifest.json`: what a run is, readable without its episodes.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::Path;

use domain::ExternalName;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{LogError, system};
use crate::cost::ModelPrices;
use crate::settings::{FREE_KEYS, RunSettings};

/// Changes when programs that read the old files cannot read the new ones. Since 3, the lines of journals have checksums.
pub const FORMAT: u32 = 3;

/// The formats that this program reads.
const READABLE: RangeInclusive<u32> = 2..=FORMAT;

/// The name of the hash of the other warehouse in which tasks are demonstrated.
pub const ELSEWHERE_HASH: &str = "elsewhere";

/// The name of the hash of the streams.
pub const STREAMS_HASH: &str = "streams";

/// The name of the hash of the case book.
pub const CASE_BOOK_HASH: &str = "case-book";

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
    /// The builder.
    pub builder: String,
    /// Hash of everything that it depends on; absent in the manifests of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub address: Option<String>,
    /// Bytes of its text.
    pub bytes: u64,
    /// Words of its text.
    pub words: u64,
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

/// The files that both have and whose hashes differ, with the hashes.
fn changed_files<'a>(
    ours: &'a BTreeMap<String, String>,
    theirs: &'a BTreeMap<String, String>,
) -> impl Iterator<Item = (&'a String, &'a str, &'a str)> {
    let short = |hash: &'a String| hash.get(..SHOWN_DIGITS).unwrap_or(hash);
    ours.iter().filter_map(move |(file, hash)| {
        let other = theirs.get(file).filter(|other| *other != hash)?;
        Some((file, short(hash), short(other)))
    })
}

/// The key of a hash among the [differences](Manifest::differences).
fn contents_of(name: &str) -> String {
    format!("contents of {name}")
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
            Some(format) if u32::try_from(format).is_ok_and(|one| READABLE.contains(&one)) => {}
            Some(format) => {
                let (first, last) = READABLE.into_inner();
                return Err(broken(format!(
                    "format {format}, this program reads {first} to {last}"
                )));
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
        documents.extend(self.documents);
        let mut memories = there.memories;
        memories.extend(self.memories);
        let (processes, commit, prices) =
            (there.processes, there.commit, self.prices.or(there.prices));
        Self { processes, commit, prices, documents, memories, ..self }
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
        let (mut here, mut of_there) = (self.identity(), there.identity());
        for (name, document) in &self.documents {
            if let Some(other) = there.documents.get(name) {
                here.insert(format!("document {name}"), document.sha256.clone().into());
                of_there.insert(format!("document {name}"), other.sha256.clone().into());
            }
        }
        for (name, memory) in &self.memories {
            let Some(other) = there.memories.get(name) else { continue };
            // Index and SDK may change, and who starts it.
            let said = |memory: &ExternalMemoryFacts| -> [(&str, Value); 6] {
                [
                    ("version", memory.version.clone().into()),
                    ("scope", memory.scope.clone().into()),
                    ("embeddings", memory.embeddings.into()),
                    ("frames", memory.frames.into()),
                    ("deterministic", memory.deterministic.into()),
                    ("learning", memory.learns.into()),
                ]
            };
            for ((fact, ours), (_, theirs)) in said(memory).into_iter().zip(said(other)) {
                here.insert(format!("{fact} of memory {name}"), ours);
                of_there.insert(format!("{fact} of memory {name}"), theirs);
            }
            if let (Some(ours), Some(theirs)) = (&memory.command, &other.command) {
                here.insert(format!("command of memory {name}"), ours.clone().into());
                of_there.insert(format!("command of memory {name}"), theirs.clone().into());
            }
            for (file, ours, theirs) in changed_files(&memory.files, &other.files) {
                here.insert(format!("file {file} of memory {name}"), ours.into());
                of_there.insert(format!("file {file} of memory {name}"), theirs.into());
            }
            // One that tells it as the SDK of an earlier version did is not another.
            if !memory.code.is_empty() && !other.code.is_empty() {
                here.insert(format!("code of memory {name}"), memory.code.clone().into());
                of_there.insert(format!("code of memory {name}"), other.code.clone().into());
            }
        }
        // Another policy is another setting; this is the code of the same one.
        if self.settings.policy_cmd == there.settings.policy_cmd {
            for (file, ours, theirs) in changed_files(&self.policy_files, &there.policy_files) {
                here.insert(format!("file {file} of the policy"), ours.into());
                of_there.insert(format!("file {file} of the policy"), theirs.into());
            }
            if let (Some(ours), Some(theirs)) = (self.policy_code(), there.policy_code()) {
                here.insert(CODE_OF_POLICY.to_owned(), ours.into());
                of_there.insert(CODE_OF_POLICY.to_owned(), theirs.into());
            }
        }
        // A run can grow: by demonstrations in another warehouse, and its books by cases and conditions.
        let is_grown = |name| {
            let selected = |of: &Self| {
                let RunSettings { cases, limit, groups, .. } = &of.settings;
                (cases.clone(), *limit, groups.clone())
            };
            name != ELSEWHERE_HASH && selected(self) != selected(there)
        };
        for name in [ELSEWHERE_HASH, CASE_BOOK_HASH, DEMONSTRATIONS_HASH] {
            let key = contents_of(name);
            if is_grown(name) || !(here.contains_key(&key) && of_there.contains_key(&key)) {
                here.remove(&key);
                of_there.remove(&key);
            }
        }
        let shown = |value: Option<&Value>| value.map_or("not set".to_owned(), Value::to_string);
        let mut keys: Vec<&String> = here.keys().chain(of_there.keys()).collect();
        keys.sort();
        keys.dedup();
        keys.into_iter()
            .filter(|key| here.get(*key) != of_there.get(*key))
            .map(|key| Difference {
                key: key.clone(),
                there: shown(of_there.get(key)),
                here: shown(here.get(key)),
            })
            .collect()
    }

    /// What two runs must have in common for their figures to be comparable: the suite, the world and how it looks, the
    /// cases, the seed, the limits of an episode, and the version of the program. Policy and memory are not among it, because
    /// they are what is compared; neither are conditions and repetitions, which a figure names.
    pub fn protocol(&self) -> BTreeMap<String, Value> {
        const SETTINGS: [&str; 10] = [
            "cases",
            "limit",
            "seed",
            "max-steps",
            "frame-size",
            "frames",
            "plates",
            "labels",
            "appearance-seed",
            "stream",
        ];
        const CONTENTS: [&str; 4] = ["layout", "catalogue", "cases", ELSEWHERE_HASH];
        let mut settings = self.settings_by_key();
        let mut protocol: BTreeMap<String, Value> = SETTINGS
            .iter()
            .filter_map(|key| Some(((*key).to_owned(), settings.remove(*key)?)))
            .collect();
        let contents = self.hashes.iter().filter(|(name, _)| CONTENTS.contains(&name.as_str()));
        protocol.extend(contents.map(|(name, hash)| (contents_of(name), hash.clone().into())));
        protocol.insert("suite".to_owned(), self.settings.suite.word().into());
        protocol.insert("version".to_owned(), self.version.clone().into());
        protocol
    }

    /// The first eight digits of the hash of the [protocol](Self::protocol), which stand for it.
    pub fn protocol_id(&self) -> String {
        let protocol = serde_json::Value::from_iter(self.protocol()).to_string();
        blake3::hash(protocol.as_bytes()).to_hex()[..8].to_owned()
    }

    fn settings_by_key(&self) -> Map<String, Value> {
        match serde_json::to_value(&self.settings) {
            Ok(Value::Object(settings)) => settings,
            _ => Map::new(),
        }
    }

    /// The settings and contents that determine the outcome of an episode, by name.
    fn identity(&self) -> Map<String, Value> {
        let mut identity = self.settings_by_key();
        // `cases`, `limit` and `group` determine which episodes the run has.
        for key in FREE_KEYS.iter().chain(&["cases", "limit", "group"]) {
            identity.remove(*key);
        }
        identity.insert("version".to_owned(), self.version.clone().into());
        if let Some(UnitId { plan, number }) = &self.unit {
            identity.insert("unit".to_owned(), format!("{number} of {plan}").into());
        }
        for (name, hash) in &self.hashes {
            identity.insert(contents_of(name), hash.clone().into());
        }
        identity
    }
}
