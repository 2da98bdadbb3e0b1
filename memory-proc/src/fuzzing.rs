//! Readers of bytes from outside without queues, for the fuzz targets in `tests/fuzz`. Not part of the program.

use peer::memory::MemoryItem;
use shm_types::message::ExternalAnswer;

use crate::demonstrations::ReplayedDemonstration;
use crate::sequences::StoredExperience;
use crate::worlds::WorldStates;

/// The items of an external memory's answer with the note `note`, whose references are not checked yet.
///
/// # Errors
/// When the answer is not valid.
pub fn answered_items(answer: &ExternalAnswer, note: &[u8]) -> Result<Vec<MemoryItem>, String> {
    crate::external::read_items(answer, note)
}

/// The episodes that a snapshot's file of experiences holds, replayed.
///
/// # Errors
/// When the file is not valid, or an episode cannot take place in `worlds`.
pub fn experiences(
    text: &[u8],
    worlds: &WorldStates,
) -> Result<Vec<ReplayedDemonstration>, String> {
    let experiences: Vec<StoredExperience> =
        serde_json::from_slice(text).map_err(|error| error.to_string())?;
    let replayed = experiences.iter().map(|experience| experience.replayed(worlds));
    replayed.collect::<Option<_>>().ok_or_else(|| "an episode cannot take place".to_owned())
}

/// The vector, scaled to length 1.
///
/// # Panics
/// When it is all zeros.
pub fn embedding(raw: &[f32]) -> search::Embedding {
    search::Embedding::normalised(raw).unwrap_or_else(|| panic!("{raw:?} has no direction"))
}
