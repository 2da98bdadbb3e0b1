//! The prompt log: what a policy was given and what it answered, step by step, as files.
//!
//! The policy process writes it where [`Attach::prompts`](crate::Attach::prompts) asks for it, `memtransfer show`
//! reads it.
//!
//! | file below the run's `prompts/` | holds |
//! |---|---|
//! | `session-1/generation-1.jsonl` | an [`Entry`] a line, appended as requests are answered |
//! | `images/HASH.png` | every view that an entry names, once; the hash is its frame's content hash |
//! | `documents/HASH.txt` | every long text that an entry names, once |
//! | `documents/HASH.json` | the demonstrations that an entry names: arrays of [`Seen`] |
//!
//! Hashes are the first 16 bytes of BLAKE3, as 32 hexadecimal digits. A generation of a session has a file of its
//! own, so a run that is resumed adds files and changes none. An entry is found by its episode's ticket and its
//! step; `timings.jsonl` of the run says for every finished episode under which session, generation and ticket it
//! was walked. A last line without its end was being written when the process was killed.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::pose::Pose;

/// First bytes of a BLAKE3 hash, as hexadecimal digits.
pub type Hash = String;

/// How a content hash is written.
pub fn hex(hash: [u8; 16]) -> Hash {
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The folder of a session's entries, below the folder of a run's prompt logs.
pub fn session_folder(prompts: &Path, session: u32) -> PathBuf {
    prompts.join(format!("session-{session}"))
}

/// The file of a generation's entries, in its session's folder.
pub fn entries_file(session_folder: &Path, generation: u32) -> PathBuf {
    session_folder.join(format!("generation-{generation}.jsonl"))
}

/// The file of an image, below the folder of a run's prompt logs.
pub fn image_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("images").join(format!("{hash}.png"))
}

/// The file of a text, likewise.
pub fn text_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("documents").join(format!("{hash}.txt"))
}

/// The file of demonstrations, likewise.
pub fn trajectories_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("documents").join(format!("{hash}.json"))
}

/// What begins the line of an entry, so that it is found without reading all others.
pub fn line_start(episode: u64, step: u32) -> String {
    format!("{{\"episode\":{episode},\"step\":{step},")
}

/// A request and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// The episode's ticket.
    pub episode: u64,
    /// Steps taken before.
    pub step: u32,
    /// The lane.
    pub lane: u32,
    /// What was asked.
    pub request: Asked,
    /// What was said to a model and what it said; absent where none was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exchange: Option<Exchange>,
    /// The answer; absent where there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer: Option<Answered>,
    /// Why there was no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
    /// What asking a model took; absent where none was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usage: Option<Usage>,
    /// When what happened.
    pub timing: Timing,
}

/// A request: all that a policy may use to decide the step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Which repetition of the run.
    pub repeat: u32,
    /// The episode's seed.
    pub seed: u64,
    /// The instruction.
    pub instruction: String,
    /// Where the agent is.
    pub pose: Pose,
    /// What the world said to the last action, in words.
    pub feedback: String,
    /// The view.
    pub frame: Hash,
    /// Whether the policy is told that the demonstration started where the episode does.
    pub starts_as_demonstrated: bool,
    /// The last steps, oldest first.
    pub window: Vec<Past>,
    /// What memory retrieved; absent where nothing was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<Retrieved>,
    /// The documents that memory supplied, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub documents: Vec<Supplied>,
    /// The demonstrations that memory supplied whole: a file. Absent where it supplied none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectories: Option<Hash>,
}

/// A past step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Past {
    /// The view before the action.
    pub frame: Hash,
    /// The action in words; absent where the answer could not be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// What the world said to it.
    pub feedback: String,
}

/// A retrieved segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Retrieved {
    /// Cosine distance of its first view to the current one.
    pub distance: f32,
    /// The matched view, then those that the expert's actions led to.
    pub steps: Vec<Seen>,
}

/// A step of a demonstration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// The view before the action; absent where it is no keyframe.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Hash>,
    /// The action in words; absent at the end, and in a segment of images alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
}

/// A document.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supplied {
    /// `summary` or `semantic`.
    pub kind: String,
    /// Its text: a file.
    pub text: Hash,
}

/// What was said to a model and what it said.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exchange {
    /// The messages, in order.
    pub messages: Vec<Message>,
    /// The reply, as it came; absent where none did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reply: Option<String>,
    /// Why no action could be read in it; absent where one could.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unread: Option<String>,
}

/// A message to a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Message {
    /// `system` or `user`.
    pub role: String,
    /// What it says, in order.
    pub parts: Vec<Part>,
}

/// A part of a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Text.
    Text(String),
    /// A long text, which is in a file.
    Stored(Hash),
    /// An image.
    Image(Hash),
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answered {
    /// `acted`, `unreadable`, `empty` or `refused`.
    pub outcome: String,
    /// The action in words; absent where none could be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Images that the request held.
    pub images_asked: u32,
    /// Images that the policy was shown.
    pub images: u32,
}

/// What asking a model took. An absent count was told by nobody.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Usage {
    /// Tokens of the prompt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_tokens: Option<u32>,
    /// Tokens of the answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server took from its own cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are injected memory, an estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_tokens: Option<u32>,
    /// Requests that were sent, failed ones included.
    pub attempts: u32,
    /// Whether the reply was one that had been kept: it cost nothing this time.
    pub replayed: bool,
}

/// When what happened: CLOCK_MONOTONIC nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Observation and recall were both there.
    pub received_ns: u64,
    /// The policy began to decide.
    pub started_ns: u64,
    /// The prompt was built; 0 where none was.
    pub prompted_ns: u64,
    /// The request went to the model's server, the last time; 0 where none did.
    pub sent_ns: u64,
    /// It was decided.
    pub decided_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Heading;

    #[test]
    fn an_entry_begins_with_what_it_is_found_by() {
        let entry = Entry {
            episode: 57,
            step: 12,
            lane: 3,
            request: Asked {
                repeat: 1,
                seed: 5,
                instruction: "Visit a blue barrel.".to_owned(),
                pose: Pose::new(3, 12, Heading::N),
                feedback: "You moved.".to_owned(),
                frame: hex([0xab; 16]),
                starts_as_demonstrated: false,
                window: Vec::new(),
                segment: None,
                documents: Vec::new(),
                trajectories: None,
            },
            exchange: None,
            answer: None,
            failed: Some("gone".to_owned()),
            usage: None,
            timing: Timing::default(),
        };
        let line = serde_json::to_string(&entry).unwrap();
        assert!(line.starts_with(&line_start(57, 12)), "{line}");
        assert_eq!(serde_json::from_str::<Entry>(&line).unwrap(), entry);
        assert_eq!(entry.request.frame, "ab".repeat(16));
    }
}
