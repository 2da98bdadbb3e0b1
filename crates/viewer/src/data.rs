//! What the pages show, as data: everything is computed here, and the front end draws it.

mod episode;
mod prompts;
mod run;

pub use episode::{DemonstrationData, EpisodeData, FailureData, LoggedEpisode};
pub use prompts::{PromptData, image_hashes, prompts};
pub use run::{EpisodeCell, RunData, row};

use domain::{Cell, Heading, Pose};

/// A pose: column, row, heading as its place clockwise from north.
type PoseData = (u8, u8, u8);

fn pose_data(pose: &Pose) -> PoseData {
    let heading = Heading::ALL.iter().position(|heading| *heading == pose.heading);
    (pose.cell.x, pose.cell.y, heading.unwrap_or(0) as u8)
}

fn cell_data(cell: &Cell) -> (u8, u8) {
    (cell.x, cell.y)
}
