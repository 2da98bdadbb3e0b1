//! What the pages show, as data: everything is computed here, and the front end draws it.

mod episode;
mod prompts;
mod run;

pub use episode::{DemonstrationData, EpisodeData, FailureData, LoggedEpisode};
pub use prompts::{PromptData, image_hashes, prompts};
pub use run::{EpisodeCell, RunData, row};

use domain::{Cell, Pose};

/// A pose: column, row, code of the heading (clockwise from north).
type PoseData = (u8, u8, u8);

fn pose_data(pose: &Pose) -> PoseData {
    (pose.cell.x, pose.cell.y, pose.heading as u8)
}

fn cell_data(cell: &Cell) -> (u8, u8) {
    (cell.x, cell.y)
}
