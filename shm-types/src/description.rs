//! What an external memory tells about itself before it joins a run: `description.json` in its folder.
//!
//! The external memory with index i of a run has the folder `memory-<i>` in the run's folder. It writes the file before it
//! waits for `attach.json`, because the orchestrator plans with its name.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use domain::ExternalName;

use crate::attach::{AttachError, write_json};
use crate::message::MAX_EXTERNAL_MEMORIES;

/// Name of the file in the folder of an external memory.
pub const DESCRIPTION_FILE: &str = "description.json";

/// Maximum length of the file, in bytes.
pub const MAX_DESCRIPTION_BYTES: u64 = 64 << 10;

/// Maximum length of each text of a description but its name, in bytes.
pub const MAX_DESCRIPTION_TEXT: usize = 100;

/// An external memory's description of itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MemoryDescription {
    /// Its name in conditions, logs and tables: 1 to 24 lower-case letters, digits and hyphens.
    pub name: String,
    /// Its version.
    #[serde(default)]
    pub version: String,
    /// The demonstrations that one instance of it remembers.
    #[serde(default)]
    pub scope: Scope,
    /// Whether it uses embeddings of views.
    #[serde(default)]
    pub embeddings: bool,
    /// Whether it looks at the pixels of remembered views. With [`Scope::All`] there are none.
    #[serde(default)]
    pub frames: bool,
    /// Whether equal queries have equal answers, whatever else it was asked before.
    #[serde(default)]
    pub deterministic: bool,
    /// Whether it learns from episodes of streams. Otherwise it has no arm `learning`.
    #[serde(default)]
    pub learns: bool,
    /// The SDK and its version.
    #[serde(default)]
    pub sdk: String,
    /// The files that its code is in, with their hashes, so that changed code is known: any text. Empty: it does not tell.
    #[serde(default)]
    pub code: String,
}

/// The demonstrations that one instance of an external memory remembers.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Those of one case.
    #[default]
    Case,
    /// Those of all cases.
    All,
}

/// The folder of the external memory with this index, in the run's folder `run`.
pub fn memory_folder(run: &Path, index: u8) -> PathBuf {
    run.join(format!("memory-{index}"))
}

/// The run's folder and the index that the folder of an external memory names; `None` if it is not such a folder.
pub fn run_of_memory_folder(folder: &Path) -> Option<(&Path, u8)> {
    let index = folder.file_name()?.to_str()?.strip_prefix("memory-")?.parse().ok()?;
    let run = folder.parent()?;
    (usize::from(index) < MAX_EXTERNAL_MEMORIES).then_some((run, index))
}

impl MemoryDescription {
    /// What `now` says otherwise, key by key; empty if nothing.
    pub fn changes(&self, now: &Self) -> String {
        let [before, now] = [self, now].map(|one| serde_json::to_value(one).unwrap_or_default());
        let keys = before.as_object().into_iter().flat_map(|all| all.keys());
        let changed = keys.filter(|key| before[*key] != now[*key]);
        let told = changed.map(|key| format!("`{key}` was {} and is {}", before[key], now[key]));
        told.collect::<Vec<_>>().join(", ")
    }

    /// Reads and checks the description in the folder of an external memory.
    ///
    /// # Errors
    /// When the file is missing or not the expected JSON, or a value is not valid.
    pub fn read(folder: &Path) -> Result<Self, AttachError> {
        let path = folder.join(DESCRIPTION_FILE);
        let mut text = String::new();
        let read = File::open(&path)
            .and_then(|file| file.take(MAX_DESCRIPTION_BYTES + 1).read_to_string(&mut text));
        let read = read.map_err(|cause| AttachError::File { path: path.clone(), cause })?;
        if read as u64 > MAX_DESCRIPTION_BYTES {
            let bytes = fs::metadata(&path).map_or(read as u64, |file| file.len());
            return Err(AttachError::Value {
                field: DESCRIPTION_FILE,
                value: format!("a file of {bytes} bytes"),
                expected: format!("at most {MAX_DESCRIPTION_BYTES}"),
            });
        }
        let description: Self =
            serde_json::from_str(&text).map_err(|cause| AttachError::Json { path, cause })?;
        description.check()?;
        Ok(description)
    }

    /// Checks the description and writes it into the folder of an external memory, atomically.
    ///
    /// # Errors
    /// When a value is not valid, or the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), AttachError> {
        self.check()?;
        write_json(folder, DESCRIPTION_FILE, self)
    }

    /// Checks the name, the length of the other texts, and that no pixels are expected where there are none.
    ///
    /// # Errors
    /// When a value is not valid.
    pub fn check(&self) -> Result<(), AttachError> {
        if self.frames && self.scope == Scope::All {
            return Err(AttachError::Value {
                field: "frames",
                value: "true".to_owned(),
                expected: "false with the scope `all`: only memories of one case get pixels"
                    .to_owned(),
            });
        }
        for (field, text) in [("version", &self.version), ("sdk", &self.sdk), ("code", &self.code)]
        {
            if text.len() > MAX_DESCRIPTION_TEXT {
                return Err(AttachError::Value {
                    field,
                    value: format!("a text of {} bytes", text.len()),
                    expected: format!("at most {MAX_DESCRIPTION_TEXT}"),
                });
            }
        }
        let checked = self.name.parse::<ExternalName>();
        checked.map(drop).map_err(|error| AttachError::Value {
            field: "name",
            value: format!("{:?}", self.name),
            expected: format!("a name that no other memory can have: {error}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_round_trips_and_its_name_is_checked() {
        let folder = tempfile::tempdir().unwrap();
        let description = MemoryDescription {
            name: "top-3".to_owned(),
            version: "1".to_owned(),
            scope: Scope::All,
            embeddings: true,
            frames: false,
            deterministic: true,
            learns: true,
            sdk: "test".to_owned(),
            code: "memory.py=0123456789abcdef".to_owned(),
        };
        description.write(folder.path()).unwrap();
        assert_eq!(MemoryDescription::read(folder.path()).unwrap(), description);
        for name in ["", "Top", "top 3", "external", "episodic", "a-name-of-twenty-five-byte"] {
            let bad = MemoryDescription { name: name.to_owned(), ..description.clone() };
            assert!(bad.check().unwrap_err().to_string().starts_with("name is "), "{name}");
        }
        let long = MemoryDescription { version: "1".repeat(101), ..description.clone() };
        let error = long.check().unwrap_err().to_string();
        assert_eq!(error, "version is a text of 101 bytes, but must be at most 100");
        fs::write(folder.path().join(DESCRIPTION_FILE), " ".repeat(70_000)).unwrap();
        let error = MemoryDescription::read(folder.path()).unwrap_err().to_string();
        assert_eq!(error, "description.json is a file of 70000 bytes, but must be at most 65536");
        let newer = MemoryDescription { version: "2".to_owned(), ..description.clone() };
        assert_eq!(description.changes(&newer), "`version` was \"1\" and is \"2\"");
        assert_eq!(description.changes(&description), "");
        let blind = MemoryDescription { frames: true, ..description };
        assert!(blind.check().unwrap_err().to_string().starts_with("frames is true"));
    }

    #[test]
    fn a_folder_names_its_run_and_index() {
        let folder = memory_folder("/run".as_ref(), 3);
        assert_eq!(run_of_memory_folder(&folder), Some(("/run".as_ref(), 3)));
        for folder in ["/run", "/run/memory-8", "/run/memory-x"] {
            assert_eq!(run_of_memory_folder(folder.as_ref()), None);
        }
    }
}
