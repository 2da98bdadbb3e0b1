//! A demonstration as a builder sees it: the instruction and, step by step, the expert's pose, feedback, view,
//! progress and action.
//!
//! A view holds the label plates that can be read in its frame. Plates carry digits only; names appear in
//! instructions.

use std::sync::Arc;

use case_book::Demonstration;
use documents::Sources;
use domain::{Action, Demonstrations, Feedback, Pose, hex};
use plates::Landmark;
use search::ContentHash;
use sha2::{Digest, Sha256};

/// One demonstration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transcript {
    /// The instruction.
    pub instruction: String,
    /// The start, then the state after each action; at least one.
    pub steps: Vec<TranscriptStep>,
}

/// A state, and the action taken in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TranscriptStep {
    /// The expert's pose.
    pub pose: Pose,
    /// Feedback on its last action.
    pub feedback: Feedback,
    /// Its view.
    pub seen: Arc<FrameReading>,
    /// Sub-goals completed so far, this cell included.
    pub completed: u32,
    /// Its action; `None` at the end.
    pub action: Option<Action>,
}

/// What can be read in a frame.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FrameReading {
    /// Identifies the frame's content.
    pub frame: ContentHash,
    /// The plates that were read, placed in the world by the camera's pose.
    pub landmarks: Vec<Landmark>,
}

/// The demonstrations of `selection`, given what is seen in the view with each number. `None` when `seen` does not know one.
pub fn transcripts(
    sources: &Sources,
    selection: Demonstrations,
    seen: impl Fn(u32) -> Option<Arc<FrameReading>>,
) -> Option<Vec<Transcript>> {
    sources.demonstrations(selection).into_iter().map(|of| transcript(of, &seen)).collect()
}

fn transcript(
    of: &Demonstration,
    seen: impl Fn(u32) -> Option<Arc<FrameReading>>,
) -> Option<Transcript> {
    let actions = of.actions.iter().copied().map(Some).chain([None]);
    let states = of.states.iter().zip(&of.feedback).zip(of.stages()).zip(&of.views);
    let steps = states.zip(actions).map(|((((&state, &feedback), completed), &view), action)| {
        Some(TranscriptStep {
            pose: state.try_into().ok()?,
            feedback: feedback.try_into().ok()?,
            seen: seen(view)?,
            completed,
            action: action.map(Action::try_from).transpose().ok()?,
        })
    });
    Some(Transcript { instruction: of.instruction.clone(), steps: steps.collect::<Option<_>>()? })
}

/// SHA-256, in hexadecimal digits, of everything in `transcripts`. Equal demonstrations have equal hashes, whatever
/// cases, layout or catalogue they come from; frames count by their content.
pub(super) fn sha256(transcripts: &[Transcript]) -> String {
    let mut hasher = Sha256::new();
    hasher.update(b"memtransfer transcripts v1\0");
    for Transcript { instruction, steps } in transcripts {
        hasher.update((instruction.len() as u64).to_le_bytes());
        hasher.update(instruction);
        hasher.update((steps.len() as u64).to_le_bytes());
        for TranscriptStep { pose, feedback, seen, completed, action } in steps {
            let action = action.map_or(shm_types::message::NO_ACTION, |action| action as u8);
            let codes = [pose.cell.x, pose.cell.y, pose.heading as u8, *feedback as u8, action];
            hasher.update(codes);
            hasher.update(completed.to_le_bytes());
            hasher.update(seen.frame);
        }
    }
    hex(&hasher.finalize())
}

#[cfg(test)]
mod tests {
    use case_book::{BookRequest, ElsewhereRequest};
    use domain::{ActionCode, Appearance, Heading};
    use warehouse::case_book::write_books;
    use warehouse::{CaseSet, Warehouse};

    use super::*;

    #[test]
    fn every_part_of_a_transcript_counts() {
        let step = TranscriptStep {
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
            changed(|t| {
                t.steps[0].seen = Arc::new(FrameReading { frame: [1; 16], landmarks: vec![] })
            }),
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

    fn sources(assets: Option<&std::path::Path>) -> Sources {
        let request = BookRequest {
            assets: assets.map(Into::into),
            elsewhere: Some(ElsewhereRequest { assets: None, seed: 1 }),
            ..BookRequest::default()
        };
        let book = write_books(&request).unwrap().demonstrations;
        Sources::new(book, 448, Appearance::STANDARD)
    }

    /// References cannot get into a document: nothing that a document depends on changes with them.
    #[test]
    fn test_references_and_barricades_make_no_difference() {
        let mut cases = CaseSet::shipped();
        let passage = cases.cases[0].barricade.clone();
        for case in &mut cases.cases {
            case.test = case.original.clone();
            case.blocked = case.distant.clone();
            case.barricade.clone_from(&passage);
            case.id.push('x');
        }
        let assets = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets");
        let folder = tempfile::tempdir().unwrap();
        for file in ["layout.toml", "catalogue.toml"] {
            let copied = std::path::Path::new(assets).join(file);
            std::fs::copy(copied, folder.path().join(file)).unwrap();
        }
        let text = cases.to_toml(&Warehouse::shipped().catalogue);
        std::fs::write(folder.path().join("cases.toml"), text).unwrap();
        let (sources, other) = (sources(None), sources(Some(folder.path())));
        let nothing = |_| Some(Arc::default());
        for word in
            ["original", "opposite", "nearby+distant", "4", "irrelevant", "confusable", "elsewhere"]
        {
            let selection: Demonstrations = word.parse().unwrap();
            assert_eq!(
                transcripts(&sources, selection, nothing),
                transcripts(&other, selection, nothing)
            );
            assert_eq!(sources.sha256(selection), other.sha256(selection));
        }
    }

    #[test]
    fn a_transcript_is_the_demonstration_and_needs_every_view() {
        let sources = sources(None);
        let nothing = |_| Some(Arc::default());
        let all = transcripts(&sources, Demonstrations::ORIGINAL, nothing).unwrap();
        let demonstration = sources.demonstrations(Demonstrations::ORIGINAL)[0];
        let Transcript { instruction, steps } = &all[0];
        assert_eq!(*instruction, demonstration.instruction);
        let actions: Vec<_> =
            steps.iter().filter_map(|step| step.action).map(ActionCode::from).collect();
        assert_eq!(actions, demonstration.actions);
        assert_eq!((steps[0].pose.into(), steps[0].completed), (demonstration.states[0], 0));
        assert!(steps[steps.len() - 1].completed > 0);
        let but_one = |view| (view != demonstration.views[3]).then(Arc::default);
        assert_eq!(transcripts(&sources, Demonstrations::ORIGINAL, but_one), None);
    }
}
