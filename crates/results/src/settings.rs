//! The settings of a run, as the manifest records them.
//!
//! The orchestrator merges them from flags, environment variables and suite files, and checks them. A key has the same
//! name in all of those places.

mod cases;
mod documents;
mod group;
mod model;
mod suite;

pub use cases::CaseSelector;
pub use documents::DocumentSource;
pub use group::Group;
pub use model::{ModelSettings, ResponseCache};
pub use suite::SuiteName;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::conditions::{Condition, Frames, PolicyKind};

/// The settings of a run, complete. `memtransfer run --help` describes each field under the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each field is documented once, as a flag of `memtransfer run`")]
pub struct RunSettings {
    pub suite: SuiteName,
    pub policy: PolicyKind,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_cmd: Option<String>,
    /// The groups of conditions, at least one.
    #[serde(rename = "group")]
    pub groups: Vec<Group>,
    pub cases: Vec<CaseSelector>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
    pub seed: u64,
    pub max_steps: u32,
    pub horizon: u32,
    pub keyframes: u32,
    pub documents: DocumentSource,
    pub frame_size: u32,
    pub frames: Frames,
    pub encoder: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_file: Option<PathBuf>,
    /// How the model is asked; with `--policy openai` only.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelSettings>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<PathBuf>,
    pub out: PathBuf,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub log_prompts: bool,
    pub lanes: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_threads: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_budget: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provider: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warm_views: bool,
    pub spin_us: u32,
    pub step_timeout: u32,
    pub start_timeout: u32,
}

impl RunSettings {
    /// The conditions of all groups, each once, in the order of the groups.
    pub fn conditions(&self) -> Vec<Condition> {
        self.runs().into_iter().map(|(condition, _)| condition).collect()
    }

    /// The conditions with the number of repetitions of each.
    pub fn runs(&self) -> Vec<(Condition, u32)> {
        group::union(&self.groups)
    }

    /// The largest number of images that a request under `condition` can hold.
    pub const fn images(&self, condition: &Condition) -> u32 {
        condition.memory.images(condition.variation.window, self.horizon, self.keyframes)
    }
}

/// Keys that do not change any result, so that a run may be resumed with other values of them. `suite` and `assets` are
/// among them because their contents are compared instead: settings, and hashes of files.
pub const FREE_KEYS: &[&str] = &[
    "suite",
    "assets",
    "out",
    "base-url",
    "max-connections",
    "max-retries",
    "request-timeout",
    "server-patience",
    "response-cache",
    "prices",
    "max-tokens-total",
    "max-cost",
    "log-prompts",
    "lanes",
    "encoder-threads",
    "frame-budget",
    "warm-views",
    "spin-us",
    "step-timeout",
    "start-timeout",
];
