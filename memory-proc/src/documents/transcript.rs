//! One demonstration as a builder of documents may see it: what was asked, and step by step where the expert
//! stood, what it was told, what it saw, how far it had got, and what it did.
//!
//! What it saw are the label plates that can be read in its frame. They say nothing in words: names are in the
//! instruction alone.

use std::sync::Arc;

use domain::{Action, Feedback, Pose};
use plates::Landmark;
use sha2::{Digest, Sha256};

use crate::embedding::ContentHash;

/// One demonstration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transcript {
    /// What was asked.
    pub instruction: String,
    /// The start, then the state after each action. At least one.
    pub steps: Vec<Step>,
}

/// The state after some actions, and what is done then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// Where the expert stands.
    pub pose: Pose,
    /// What it was told about its last action.
    pub feedback: Feedback,
    /// What it sees from there.
    pub seen: Arc<Seen>,
    /// Sub-goals completed so far, by standing here or before.
    pub completed: u32,
    /// What it does now; `None` at the end.
    pub action: Option<Action>,
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Seen {
    /// The frame's content.
    pub frame: ContentHash,
    /// The plates that were read from its pixels, and where they hang, given where the camera was.
    pub landmarks: Vec<Landmark>,
}

/// SHA-256, in hexadecimal digits, of everything that `transcripts` say: the same for the same
/// demonstrations, whichever cases, layout or catalogue they come from.
///
/// Frames enter by their contents, so a change that shows in no demonstration does not change it.
pub fn sha256(transcripts: &[Transcript]) -> String {
    let mut hasher = Sha256::new();
    hasher.update(b"memtransfer transcripts v1\0");
    for Transcript { instruction, steps } in transcripts {
        hasher.update((instruction.len() as u64).to_le_bytes());
        hasher.update(instruction);
        hasher.update((steps.len() as u64).to_le_bytes());
        for Step { pose, feedback, seen, completed, action } in steps {
            let action = action.map_or(shm_types::message::NO_ACTION, |action| action as u8);
            let codes = [pose.cell.x, pose.cell.y, pose.heading as u8, *feedback as u8, action];
            hasher.update(codes);
            hasher.update(completed.to_le_bytes());
            hasher.update(seen.frame);
        }
    }
    hex(&hasher.finalize())
}

/// Hexadecimal digits of `bytes`.
pub(super) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;

    #[test]
    fn every_part_of_a_transcript_counts() {
        let step = Step {
            pose: Pose::new(3, 4, Heading::N),
            feedback: Feedback::Start,
            seen: Arc::default(),
            completed: 0,
            action: Some(Action::Forward),
        };
        let base = Transcript { instruction: "Find a blue barrel.".into(), steps: vec![step] };
        let changed = |change: fn(&mut Transcript)| {
            let mut other = base.clone();
            change(&mut other);
            other
        };
        let all = [
            base.clone(),
            changed(|t| t.instruction.push('!')),
            changed(|t| t.steps[0].pose.heading = Heading::E),
            changed(|t| t.steps[0].feedback = Feedback::Turned),
            changed(|t| t.steps[0].completed = 1),
            changed(|t| t.steps[0].action = None),
            changed(|t| t.steps[0].seen = Arc::new(Seen { frame: [1; 16], landmarks: vec![] })),
            changed(|t| t.steps.extend_from_within(..)),
        ];
        let mut hashes: Vec<_> = all.iter().map(|t| sha256(std::slice::from_ref(t))).collect();
        hashes.push(sha256(&[]));
        hashes.push(sha256(&[base.clone(), base]));
        let count = hashes.len();
        hashes.sort();
        hashes.dedup();
        assert_eq!(hashes.len(), count);
        assert!(hashes.iter().all(|hash| hash.len() == 64));
    }
}
