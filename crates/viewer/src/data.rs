//! What the pages show, as data: everything is computed here, and the front end draws it.

mod episode;
mod prompts;
mod run;

pub use episode::{DemonstrationData, EpisodeData, FailureData, LoggedEpisode};
pub use prompts::{PromptData, image_hashes, prompts};
pub use run::{EpisodeCell, RunData, row};

use domain::{Cell, Pose, State};

/// A pose: column, row, code of the heading (clockwise from north).
type PoseData = (u8, u8, u8);

fn pose_data(state: &State) -> PoseData {
    let pose = Pose::try_from(*state);
    pose.map_or((0, 0, 0), |pose| (pose.cell.x, pose.cell.y, pose.heading as u8))
}

fn cell_of(state: &State) -> Option<(u8, u8)> {
    Pose::try_from(*state).ok().map(|pose| cell_data(&pose.cell))
}

fn cell_data(cell: &Cell) -> (u8, u8) {
    (cell.x, cell.y)
}
