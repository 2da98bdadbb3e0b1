//! What a run is to do: read as layers, then resolved once.
//!
//! A [`Layer`] holds what one source says; its fields are at the same time the flags of
//! `memtransfer run`, the MEMTRANSFER_* variables and the keys of a suite file, so the three cannot
//! disagree about a name. [`resolve`] puts the layers on top of each other, defaults < suite file <
//! environment < command line, and checks the outcome: [`Settings`] is complete and possible.

mod cases;
mod layer;
mod resolve;
mod suite;

pub use cases::{CaseSelector, select_cases};
pub use layer::Layer;
pub use resolve::{Origin, Resolved, SettingsError, resolve};
pub use suite::{SuiteError, SuiteName, load_suite, shipped_suites};

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use shm_types::Representation;

use crate::conditions::{Demonstrations, Frames, PolicyKind, Route, Start};

/// A run's settings, complete and checked. Every field is described where it is written: [`Layer`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(missing_docs, reason = "each field is documented once, as a flag in `Layer`")]
pub struct Settings {
    pub suite: SuiteName,
    pub policy: PolicyKind,
    pub memory: Vec<Representation>,
    pub starts: Vec<Start>,
    pub routes: Vec<Route>,
    pub demos: Vec<Demonstrations>,
    pub cases: Vec<CaseSelector>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
    pub runs: u32,
    pub seed: u64,
    pub max_steps: u32,
    pub window: u32,
    pub horizon: u32,
    pub frame_size: u32,
    pub frames: Frames,
    pub encoder: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_file: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<PathBuf>,
    pub out: PathBuf,
    pub lanes: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_threads: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_budget: Option<u32>,
    pub spin_us: u32,
    pub step_timeout: u32,
    pub start_timeout: u32,
}

/// Keys that change how fast or where a run goes and never what comes out, so a run may be resumed with
/// others. Suite and assets are among them because what they *say* is compared: keys, and hashes of files.
pub const FREE_KEYS: &[&str] = &[
    "suite",
    "assets",
    "out",
    "lanes",
    "encoder-threads",
    "frame-budget",
    "spin-us",
    "step-timeout",
    "start-timeout",
];
