//! What a run is to do: read as layers, then resolved once.
//!
//! A [`Layer`] holds what one source says; its fields are at the same time the flags of
//! `memtransfer run`, the MEMTRANSFER_* variables and the keys of a suite file, so the three cannot
//! disagree about a name. [`resolve`] puts the layers on top of each other, defaults < suite file <
//! environment < command line, and checks the outcome: [`Settings`] is complete and possible.
//!
//! What a run varies is in [`Group`]s, each a product; a suite file may have several, and what flags and
//! variables say of a group's keys holds for all of them.

mod cases;
mod documents;
mod group;
mod images;
mod layer;
mod model;
mod resolve;
mod suite;

pub use cases::{CaseSelector, select_cases};
pub use documents::{Documents, UnknownDocuments};
pub use group::{GROUP_KEYS, Group};
pub use images::{MAX_IMAGES, TooManyImages};
pub use layer::Layer;
pub use model::{Amount, MODEL_KEYS, ModelSettings, ResponseCache};
pub use resolve::{Origin, Resolved, SettingsError, resolve};
pub use suite::{SuiteError, SuiteName, load_suite, shipped_suites};

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::conditions::{Condition, Frames, PolicyKind};

/// A run's settings, complete and checked. Every field is described where it is written: [`Layer`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each field is documented once, as a flag in `Layer`")]
pub struct Settings {
    pub suite: SuiteName,
    pub policy: PolicyKind,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_cmd: Option<String>,
    /// What is varied, one group at least.
    #[serde(rename = "group")]
    pub groups: Vec<Group>,
    pub cases: Vec<CaseSelector>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
    pub seed: u64,
    pub max_steps: u32,
    pub horizon: u32,
    pub keyframes: u32,
    pub documents: Documents,
    pub frame_size: u32,
    pub frames: Frames,
    pub encoder: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_file: Option<PathBuf>,
    /// What concerns a model that is asked over the network; for `--policy openai` alone.
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
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warm_views: bool,
    pub spin_us: u32,
    pub step_timeout: u32,
    pub start_timeout: u32,
}

impl Settings {
    /// The conditions that they ask for, each once, in the order of the groups.
    pub fn conditions(&self) -> Vec<Condition> {
        self.runs().into_iter().map(|(condition, _)| condition).collect()
    }

    /// The same, with how often each is run.
    pub fn runs(&self) -> Vec<(Condition, u32)> {
        group::union(&self.groups)
    }

    /// Most images that a request under `condition` can hold.
    pub const fn images(&self, condition: &Condition) -> u32 {
        condition.memory.images(condition.variation.window, self.horizon, self.keyframes)
    }
}

/// Keys that change how fast or where a run goes and never what comes out, so a run may be resumed with
/// others. Suite and assets are among them because what they *say* is compared: keys, and hashes of files.
pub const FREE_KEYS: &[&str] = &[
    "suite",
    "assets",
    "out",
    "base-url",
    "max-connections",
    "max-retries",
    "request-timeout",
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
