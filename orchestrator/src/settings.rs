//! The settings of a run, put together from layers.
//!
//! A [`Layer`] holds the settings of one source; its fields are at the same time the flags of `memtransfer run`,
//! the MEMTRANSFER_* variables and the keys of a suite file. [`resolve`] puts the layers on top of each other
//! (defaults < suite file < environment < command line) and checks the result.
//!
//! Conditions are listed in [`Group`](results::settings::Group)s. Flags and variables apply to all groups.

mod cases;
mod images;
mod layer;
mod resolve;
mod suite;

pub use cases::select_cases;
pub use images::{MAX_IMAGES, TooManyImages};
pub use layer::Layer;
pub use resolve::{Origin, Resolved, SettingsError, resolve};
pub use suite::{SuiteError, load_suite, shipped_suites};

/// The keys that a `[[group]]` of a suite file may have beside its name.
pub const GROUP_KEYS: &[&str] =
    &["memory", "starts", "routes", "demos", "window", "segment", "hint", "runs"];

/// The keys of [`ModelSettings`](results::settings::ModelSettings): for `--policy openai` only.
pub const MODEL_KEYS: &[&str] = &[
    "model",
    "base-url",
    "image-format",
    "image-budget",
    "answer-tokens",
    "max-connections",
    "max-retries",
    "request-timeout",
    "response-cache",
    "prices",
    "max-tokens-total",
    "max-cost",
];
