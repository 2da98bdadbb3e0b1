//! Readers of bytes from outside without queues, for the fuzz targets in `tests/fuzz`. Not part of the program.

use peer::memory::MemoryItem;
use shm_types::message::ExternalAnswer;

use crate::demonstrations::RememberedDemonstration;
use crate::sequences::StoredExperience;

/// The items of an external memory's answer with the note `note`, whose references are not checked yet.
///
/// # Errors
/// When the answer is not valid.
pub fn answered_items(answer: &ExternalAnswer, note: &[u8]) -> Result<Vec<MemoryItem>, String> {
    crate::external::read_items(answer, note)
}

/// The episodes that a snapshot's file of experiences holds.
///
/// # Errors
/// When the file is not valid.
pub fn experiences(text: &[u8]) -> Result<Vec<RememberedDemonstration>, String> {
    let experiences: Vec<StoredExperience> =
        serde_json::from_slice(text).map_err(|error| error.to_string())?;
    let lived = experiences.into_iter().map(|stored| stored.lived(1));
    lived.collect::<Option<_>>().ok_or_else(|| "an episode has parts that do not fit".to_owned())
}

/// The vector, scaled to length 1.
///
/// # Panics
/// When it is all zeros.
pub fn embedding(raw: &[f32]) -> search::Embedding {
    search::Embedding::normalised(raw).unwrap_or_else(|| panic!("{raw:?} has no direction"))
}
