//! Runs as files for other programs.
//!
//! | format | for | file |
//! |---|---|---|
//! | MCAP | Foxglove, Rerun | `mcap.rs` |
//! | MP4 | any player | `video.rs` |
//! | CSV, Parquet | pandas, DuckDB, spreadsheets | `tables.rs` |
//! | YAML of results | a hub of models | `hub.rs` |
//!
//! The first two show episodes with their views, which `sim-proc views`, a child process, renders again; they and the table of
//! steps are views of [`world_client::EpisodeTimeline`]. The others are computed from the log. The same log gives the same files, except for a video, which is ffmpeg's.

mod episodes;
mod files;
mod hub;
mod mcap;
mod moments;
mod tables;
mod video;

pub use episodes::{EpisodeFormat, Episodes};
pub use hub::{HubDataset, write_results};
pub use moments::Timing;
pub use report::TableFormat;
pub use tables::write_tables;
