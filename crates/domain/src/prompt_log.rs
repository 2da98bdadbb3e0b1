//! The prompt log: every request of a policy and its answer, as files.
//!
//! The policy process writes it if the run asks for it (`--log-prompts`); `memtransfer show` and `view` read it.
//!
//! | file below the run's `prompts/` | holds |
//! |---|---|
//! | `session-1/generation-1.jsonl` | an [`PromptLogEntry`] a line, appended as requests are answered |
//! | `images/HASH.png` | every image that an entry names, once; for a view the hash is its frame's content hash |
//! | `documents/HASH.txt` | every long text that an entry names, once |
//! | `documents/HASH.json` | every demonstration that an entry names, once: an array of [`RecordedView`] |
//!
//! Hashes are the first 16 bytes of BLAKE3, as 32 hexadecimal digits. Each generation of a session has a file of its own,
//! so resuming a run adds files and changes none. An entry is found by its episode id and step; `timings.jsonl` of the run
//! has the session, generation and episode id of every finished episode. A last line without a line end was being written
//! when the process was killed.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::state::State;

/// The first 16 bytes of a BLAKE3 hash, as hexadecimal digits.
pub type Hash = String;

/// Whether a text is a hash. In a folder from elsewhere it may be any text, for example a path that leads out of the folder.
pub fn is_hash(text: &str) -> bool {
    text.len() == 32 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The folder of a session's entries below a run's `prompts` folder.
pub fn session_folder(prompts: &Path, session: u32) -> PathBuf {
    prompts.join(format!("session-{session}"))
}

/// The file of a generation's entries in its session's folder.
pub fn entries_file(session_folder: &Path, generation: u32) -> PathBuf {
    session_folder.join(format!("generation-{generation}.jsonl"))
}

/// The file of an image below a run's `prompts` folder.
pub fn image_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("images").join(format!("{hash}.png"))
}

/// The file of a text below a run's `prompts` folder.
pub fn text_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("documents").join(format!("{hash}.txt"))
}

/// The file of a demonstration below a run's `prompts` folder.
pub fn trajectory_file(prompts: &Path, hash: &str) -> PathBuf {
    prompts.join("documents").join(format!("{hash}.json"))
}

/// The episode id and the step of an entry, from the start of its line: finds it without parsing the others.
pub fn line_key(line: &str) -> Option<(u64, u32)> {
    let (episode, rest) = line.strip_prefix("{\"episode\":")?.split_once(",\"step\":")?;
    let (step, _) = rest.split_once(',')?;
    Some((episode.parse().ok()?, step.parse().ok()?))
}

/// A request and its answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PromptLogEntry {
    /// The episode's id.
    pub episode: u64,
    /// Steps taken before.
    pub step: u32,
    /// The lane.
    pub lane: u32,
    /// The request.
    pub request: RecordedRequest,
    /// The exchange with a model; absent if none was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exchange: Option<RecordedExchange>,
    /// The answer; absent if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer: Option<RecordedAnswer>,
    /// Why there was no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
    /// The cost of asking a model; absent if none was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usage: Option<RecordedUsage>,
    /// Time stamps.
    pub timing: RecordedTiming,
}

/// A request as it was given to the policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedRequest {
    /// The repetition of the run.
    pub repeat: u32,
    /// The episode's seed.
    pub seed: u64,
    /// The instruction.
    pub instruction: String,
    /// The agent's state.
    pub state: State,
    /// The feedback to the last action, in words.
    pub feedback: String,
    /// The view.
    pub frame: Hash,
    /// Whether the prompt says that a demonstration started in the episode's start pose.
    pub starts_as_demonstrated: bool,
    /// Whether the prompt said that the demonstrations took place in another warehouse.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub demonstrated_elsewhere: bool,
    /// The last steps, oldest first.
    pub window: Vec<RecordedPast>,
    /// What memory supplied, in order.
    pub items: Vec<RecordedItem>,
}

/// A past step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedPast {
    /// The view before the action.
    pub frame: Hash,
    /// The action in words; absent if the answer could not be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// The feedback to it, in words.
    pub feedback: String,
}

/// An item that memory supplied.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RecordedItem {
    /// A text.
    Text {
        /// `summary`, `semantic` or `note`.
        kind: String,
        /// The file of the text.
        text: Hash,
    },
    /// Retrieved steps of a demonstration.
    Segment {
        /// Distance between what was retrieved and the query; absent if memory told none. For episodic memory, the cosine
        /// distance between the embeddings of the first view and the current one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        distance: Option<f32>,
        /// The task of the demonstration.
        instruction: String,
        /// The steps.
        steps: Vec<RecordedView>,
    },
    /// A demonstration that was supplied whole.
    Trajectory {
        /// Its task.
        instruction: String,
        /// The file of its steps.
        steps: Hash,
    },
    /// A remembered view with a caption.
    Frame {
        /// The task of its demonstration.
        instruction: String,
        /// The view.
        frame: Hash,
        /// The file of the caption.
        caption: Hash,
    },
    /// Actions to take from this step on.
    Plan {
        /// Its parts, in order.
        parts: Vec<RecordedActions>,
    },
}

/// A part of a plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedActions {
    /// The task of the demonstration that the actions are taken from; absent if memory chose them itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instruction: Option<String>,
    /// The actions in words, in order.
    pub actions: Vec<String>,
}

/// A view of a segment or demonstration, with the expert's action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedView {
    /// The view before the action; absent if it is not a keyframe.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Hash>,
    /// The action in words; absent at the end, and in a segment without actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
}

/// The messages sent to a model, and its reply.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedExchange {
    /// The messages, in order.
    pub messages: Vec<RecordedMessage>,
    /// The text of the reply; absent if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reply: Option<String>,
    /// Why no action could be read from it; absent if one could.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unread: Option<String>,
}

/// A message to a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedMessage {
    /// `system` or `user`.
    pub role: String,
    /// Its parts, in order.
    pub parts: Vec<RecordedPart>,
}

/// A part of a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RecordedPart {
    /// Text.
    Text(String),
    /// A long text, by its file.
    Stored(Hash),
    /// An image, by its file.
    Image(Hash),
    /// An image as the bytes of a PNG file. The log stores it and writes [`Image`](Self::Image) instead.
    #[serde(skip)]
    Png(Vec<u8>),
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedAnswer {
    /// `acted`, `unreadable`, `empty`, `refused` or `cut-off`.
    pub outcome: String,
    /// The action in words; absent if none could be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Images that the request held.
    pub images_asked: u32,
    /// Images that the policy used.
    pub images: u32,
}

/// The cost of asking a model. A count that is not known is absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedUsage {
    /// Tokens of the prompt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_tokens: Option<u32>,
    /// Tokens of the answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server took from its cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are memory; an estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_tokens: Option<u32>,
    /// Tokens of the prompt that a server can reuse, since the previous prompt of the episode began with them too; an
    /// estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reusable_tokens: Option<u32>,
    /// Requests sent, including failed ones.
    pub attempts: u32,
    /// Whether the reply came from the response cache.
    pub replayed: bool,
    /// Why the reply ended, in the server's terms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish_reason: Option<String>,
    /// Whether the model reasoned before it answered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reasoned: Option<bool>,
    /// The model that the reply names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

/// Time stamps in CLOCK_MONOTONIC nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedTiming {
    /// Observation and recall had both been received.
    pub received_ns: u64,
    /// The policy was called.
    pub started_ns: u64,
    /// The prompt was built; 0 without one.
    pub prompted_ns: u64,
    /// The last request was sent to the model's server; 0 without one.
    pub sent_ns: u64,
    /// The policy had decided.
    pub decided_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hex;

    #[test]
    fn a_hash_is_32_hexadecimal_digits() {
        assert!(is_hash(&hex(&[0xa7; 16])));
        for text in
            ["", "../../../../etc/passwd", &"0".repeat(31), &"g".repeat(32), &"/".repeat(32)]
        {
            assert!(!is_hash(text), "{text}");
        }
    }

    #[test]
    fn the_line_of_an_entry_starts_with_its_key() {
        let entry = PromptLogEntry {
            episode: 57,
            step: 12,
            lane: 3,
            request: RecordedRequest {
                repeat: 1,
                seed: 5,
                instruction: "Visit a blue barrel.".to_owned(),
                state: State::new(&[3.0, 12.0, 0.0]).unwrap(),
                feedback: "You moved.".to_owned(),
                frame: hex(&[0xab; 16]),
                starts_as_demonstrated: false,
                demonstrated_elsewhere: false,
                window: Vec::new(),
                items: vec![RecordedItem::Trajectory {
                    instruction: "Visit a cone.".to_owned(),
                    steps: hex(&[1; 16]),
                }],
            },
            exchange: None,
            answer: None,
            failed: Some("gone".to_owned()),
            usage: None,
            timing: RecordedTiming::default(),
        };
        let line = serde_json::to_string(&entry).unwrap();
        assert_eq!(line_key(&line), Some((57, 12)), "{line}");
        assert_eq!(line_key("{\"episode\":57,\"lane\":1}"), None);
        assert_eq!(serde_json::from_str::<PromptLogEntry>(&line).unwrap(), entry);
        assert_eq!(entry.request.frame, "ab".repeat(16));
    }
}
