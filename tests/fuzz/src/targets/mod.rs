//! The targets, by what they read.

mod folders;
mod models;
mod texts;
mod wire;
mod worlds;

use crate::Target;

macro_rules! targets {
    ($($name:literal $run:path: $reads:literal,)*) => {
        &[$(Target { name: $name, reads: $reads, run: $run },)*]
    };
}

pub(crate) const ALL: &[Target] = targets! {
    "wire-orchestrator" wire::orchestrator: "answers of simulator, memory and policy, as the orchestrator's lanes take them",
    "wire-sim" wire::sim: "commands to the simulator",
    "wire-policy" wire::policy: "episode configs, observations and recalls, as a policy joins them",
    "wire-memory" wire::memory: "answers and notes of an external memory, up to the recall",
    "wire-blocks" wire::blocks: "documents, banks, handshakes and texts in messages",
    "attach" texts::attach: "attach.json and description.json",
    "names" texts::names: "keys of episodes, conditions and words of settings",
    "suite" texts::suite: "suite files, resolved to settings",
    "models-toml" texts::encoders: "models.toml",
    "prices" texts::prices: "price files",
    "reply" models::reply: "HTTP bodies of chat servers",
    "reply-cache" models::reply_cache: "entries of the reply cache",
    "answer" models::answer: "answers of models in words",
    "png" models::png: "PNG images",
    "embedding-cache" models::embedding_cache: "database files of the embedding cache",
    "document" models::document: "document files",
    "snapshot" models::snapshot: "snapshots of memories that learn",
    "assets" worlds::assets: "layout.toml, catalogue.toml and cases.toml",
    "streams" worlds::streams: "streams.json",
    "elsewhere" worlds::elsewhere: "elsewhere.json",
    "run-folder" folders::run: "run folders, up to scores, tables and report",
    "plan" folders::plan: "plans of units",
    "merge" folders::merged: "folders of units, merged",
    "viewer-run" folders::viewer_run: "run folders with prompts, up to the pages of the viewer",
    "viewer-path" folders::viewer_path: "paths of requests to the viewer",
};
