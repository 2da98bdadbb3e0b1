//! What a stranger can hand over, as functions of bytes.
//!
//! A target passes its input to readers and asserts what must hold for any bytes: an answer or an error, never a panic;
//! what is written is read back equal; nothing is read outside of the folder at hand. Readers of the same kind of thing share
//! a target: each gets the whole input. `cargo test` runs every target on its corpus; `cargo fuzz` on new inputs, guided by
//! coverage (CONTRIBUTING.md).

#![expect(clippy::unwrap_used, reason = "a target reports what it finds by panicking")]

mod files;
mod input;
mod targets;

use targets::{folders, models, texts, wire, worlds};

/// A reader of bytes from outside: its name, which is also that of its folder in `corpus`, and the functions that read an
/// input. They panic when something does not hold.
pub type Target = (&'static str, &'static [fn(&[u8])]);

/// All targets.
pub const TARGETS: &[Target] = &[
    // Run folders with prompts, up to scores, report and the pages of the viewer.
    ("run-folder", &[folders::run, folders::viewer_run]),
    // Shipped plans, and folders of units, merged.
    ("units", &[folders::plan, folders::merged]),
    // Paths of requests to the viewer.
    ("viewer-path", &[folders::viewer_path]),
    // Suites, prices, models.toml, .env, and the words in them.
    ("settings", &[texts::suite, texts::prices, texts::encoders, texts::env_file, texts::names]),
    // Published figures.
    ("published", &[texts::published]),
    // layout.toml, catalogue.toml, cases.toml, streams.json and elsewhere.json.
    ("assets", &[worlds::assets, worlds::streams, worlds::elsewhere]),
    // Answers of simulator, memory and policy, as the orchestrator's lanes take them.
    ("wire-orchestrator", &[wire::orchestrator]),
    // Answers and notes of an external memory, up to the recall.
    ("wire-memory", &[wire::memory]),
    // Documents, banks, handshakes and texts in messages; attach.json and description.json.
    ("wire-blocks", &[wire::blocks, texts::attach]),
    // HTTP bodies of chat servers, and the words of models in them.
    ("reply", &[models::reply, models::answer]),
    ("png", &[models::png]),
    // Documents, snapshots of memories that learn, and databases of embeddings, which travel with runs and plans.
    ("memory-files", &[models::document, models::snapshot, models::embedding_cache]),
];

/// Passes an input to every reader of a target.
pub fn run((_, readers): &Target, input: &[u8]) {
    readers.iter().for_each(|read| read(input));
}
