//! Memories by name: the built-in representations, and external ones.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::representation::{Representation, RepresentationInfo, Trajectories};
use crate::serde_as_text;

/// Most bytes of the name of an external memory.
pub const MAX_MEMORY_NAME: usize = 24;

/// The word that stands for an external memory before it has told its name.
pub const EXTERNAL_WORD: &str = "external";

/// The word for no built-in memory, beside external ones.
pub const NONE_WORD: &str = "none";

/// The memory of an episode. Written as its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum MemoryKind {
    /// One of the built-in representations.
    BuiltIn(Representation),
    /// A memory in a process of its own, by the name that it tells.
    External(ExternalName),
}

/// The name of an external memory: 1 to [`MAX_MEMORY_NAME`] lower-case letters, digits and hyphens.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ExternalName {
    /// The name, then zeros.
    bytes: [u8; MAX_MEMORY_NAME],
}

/// A text that is not the name of an external memory.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadMemoryName {
    /// It has other characters, or too many, or none.
    #[error(
        "{0:?} is not a name of a memory: 1 to {MAX_MEMORY_NAME} lower-case letters, digits and hyphens"
    )]
    Malformed(String),
    /// It means something else.
    #[error("{0:?} is the name of a built-in memory, or reserved: choose another name")]
    Taken(String),
}

impl ExternalName {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        let len = self.bytes.iter().position(|&byte| byte == 0).unwrap_or(MAX_MEMORY_NAME);
        std::str::from_utf8(&self.bytes[..len]).unwrap_or_default()
    }
}

impl FromStr for ExternalName {
    type Err = BadMemoryName;

    fn from_str(text: &str) -> Result<Self, BadMemoryName> {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        if text.is_empty() || text.len() > MAX_MEMORY_NAME || !text.bytes().all(plain) {
            return Err(BadMemoryName::Malformed(text.to_owned()));
        }
        if [EXTERNAL_WORD, NONE_WORD].contains(&text) || text.parse::<Representation>().is_ok() {
            return Err(BadMemoryName::Taken(text.to_owned()));
        }
        let mut bytes = [0; MAX_MEMORY_NAME];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        Ok(Self { bytes })
    }
}

impl fmt::Display for ExternalName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for ExternalName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

serde_as_text!(ExternalName);

impl MemoryKind {
    /// The built-in representation, if it is one.
    pub const fn built_in(self) -> Option<Representation> {
        match self {
            Self::BuiltIn(representation) => Some(representation),
            Self::External(_) => None,
        }
    }

    /// The name of the external memory, if it is one.
    pub const fn external(self) -> Option<ExternalName> {
        match self {
            Self::BuiltIn(_) => None,
            Self::External(name) => Some(name),
        }
    }

    /// The properties of a built-in representation.
    pub fn describe(self) -> Option<RepresentationInfo> {
        self.built_in().map(Representation::describe)
    }

    /// The name on the command line, in files and in tables.
    pub fn name(&self) -> &str {
        match self {
            Self::BuiltIn(representation) => representation.name(),
            Self::External(name) => name.as_str(),
        }
    }

    /// Whether it is built from demonstrations.
    pub const fn uses_demonstrations(self) -> bool {
        match self {
            Self::BuiltIn(representation) => representation.uses_demonstrations(),
            Self::External(_) => true,
        }
    }

    /// Whether it may supply parts of demonstrations.
    pub fn supplies_trajectories(self) -> bool {
        self.describe().is_none_or(|info| info.trajectories != Trajectories::Nothing)
    }

    /// Whether it supplies a part that it retrieves at each step.
    pub fn retrieves(self) -> bool {
        self.describe().is_none_or(|info| info.trajectories == Trajectories::Segment)
    }
}

impl fmt::Display for MemoryKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for MemoryKind {
    type Err = BadMemoryName;

    /// Any name that an external memory can have is one: whether there is such a memory is for the caller to know.
    fn from_str(text: &str) -> Result<Self, BadMemoryName> {
        match text.parse() {
            Ok(representation) => Ok(Self::BuiltIn(representation)),
            Err(_) => text.parse().map(Self::External),
        }
    }
}

serde_as_text!(MemoryKind);

impl From<Representation> for MemoryKind {
    fn from(representation: Representation) -> Self {
        Self::BuiltIn(representation)
    }
}

impl From<ExternalName> for MemoryKind {
    fn from(name: ExternalName) -> Self {
        Self::External(name)
    }
}

impl PartialEq<Representation> for MemoryKind {
    fn eq(&self, other: &Representation) -> bool {
        self.built_in() == Some(*other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written_and_built_in_ones_come_first() {
        let mut memories: Vec<MemoryKind> = ["top-3", "episodic", "a", "working", "bm25"]
            .iter()
            .map(|name| name.parse().unwrap())
            .collect();
        memories.sort();
        let names: Vec<&str> = memories.iter().map(MemoryKind::name).collect();
        assert_eq!(names, ["working", "episodic", "a", "bm25", "top-3"]);
        for memory in memories {
            let text = serde_json::to_string(&memory).unwrap();
            assert_eq!(text, format!("{:?}", memory.name()));
            assert_eq!(serde_json::from_str::<MemoryKind>(&text).unwrap(), memory);
        }
        let longest = "a".repeat(MAX_MEMORY_NAME);
        assert_eq!(longest.parse::<ExternalName>().unwrap().as_str(), longest);
    }

    #[test]
    fn what_is_no_name_is_refused() {
        for text in ["", "Top", "top 3", "top_3", "t\u{f6}p", &"a".repeat(MAX_MEMORY_NAME + 1)] {
            let bad = Err(BadMemoryName::Malformed(text.to_owned()));
            assert_eq!(text.parse::<MemoryKind>(), bad);
        }
        for text in ["external", "none", "episodic"] {
            assert_eq!(text.parse::<ExternalName>(), Err(BadMemoryName::Taken(text.to_owned())));
        }
    }
}
