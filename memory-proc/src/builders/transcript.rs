//! A demonstration as a builder sees it: the instruction and, step by step, the expert's pose, feedback, view,
//! progress and action.
//!
//! A view holds the label plates that can be read in its frame. Plates carry digits only; names appear in
//! instructions.

use std::sync::Arc;

use documents::Sources;
use domain::{Action, Demonstrations, Feedback, Pose, hex};
use plates::Landmark;
use search::ContentHash;
use sha2::{Digest, Sha256};
use warehouse::{Demonstrated, Viewpoint};

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

/// The demonstrations of `selection`, given what is seen from each viewpoint. `None` when `seen` does not know one.
pub fn transcripts(
    sources: &Sources,
    selection: Demonstrations,
    seen: impl Fn(Viewpoint) -> Option<Arc<FrameReading>>,
) -> Option<Vec<Transcript>> {
    sources.demonstrations(selection).iter().map(|of| transcript(of, &seen)).collect()
}

fn transcript(
    of: &Demonstrated<'_>,
    seen: impl Fn(Viewpoint) -> Option<Arc<FrameReading>>,
) -> Option<Transcript> {
    let variant = of.variant;
    let replay = of.replay();
    let actions = of.trajectory.actions.iter().copied().map(Some).chain([None]);
    let states = replay.poses.into_iter().zip(replay.feedback).zip(replay.stages);
    let steps = states.zip(actions).map(|(((pose, feedback), completed), action)| {
        let seen = seen(Viewpoint { variant, pose })?;
        Some(TranscriptStep { pose, feedback, seen, completed, action })
    });
    Some(Transcript { instruction: of.instruction(), steps: steps.collect::<Option<_>>()? })
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
    use domain::Heading;

    use warehouse::Elsewhere;

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

    fn sources() -> Sources {
        Sources::load(None).unwrap()
    }

    /// References cannot get into a document: nothing that a document depends on changes with them.
    #[test]
    fn test_references_and_barricades_make_no_difference() {
        let (mut sources, mut other) = (sources(), sources());
        for case in &mut other.cases.cases {
            case.test = case.original.clone();
            case.blocked = case.distant.clone();
            case.barricade.clear();
            case.id.push('x');
        }
        for sources in [&mut sources, &mut other] {
            let elsewhere = Elsewhere::generate(&sources.warehouse, &sources.cases, 1).unwrap();
            sources.cases.elsewhere = Some(elsewhere);
        }
        let nothing = |_| Some(Arc::default());
        for word in
            ["original", "opposite", "nearby+distant", "4", "irrelevant", "confusable", "elsewhere"]
        {
            let selection: Demonstrations = word.parse().unwrap();
            assert_eq!(sources.viewpoints(selection), other.viewpoints(selection));
            assert_eq!(
                transcripts(&sources, selection, nothing),
                transcripts(&other, selection, nothing)
            );
            let hash = |sources: &Sources| sources.sha256(selection, [448, 448]);
            assert_eq!(hash(&sources), hash(&other));
        }
    }

    #[test]
    fn a_transcript_is_the_demonstration_and_needs_every_view() {
        let sources = sources();
        let nothing = |_| Some(Arc::default());
        let all = transcripts(&sources, Demonstrations::ORIGINAL, nothing).unwrap();
        let case = &sources.cases.cases[0];
        let Transcript { instruction, steps } = &all[0];
        assert_eq!(*instruction, case.task.instruction(&sources.warehouse.catalogue));
        let actions: Vec<_> = steps.iter().filter_map(|step| step.action).collect();
        assert_eq!(actions, case.original.actions);
        assert_eq!((steps[0].pose, steps[0].completed), (case.original.start, 0));
        assert!(steps[steps.len() - 1].completed > 0);
        let but_one = |seen: Viewpoint| (seen.pose != steps[3].pose).then(Arc::default);
        assert_eq!(transcripts(&sources, Demonstrations::ORIGINAL, but_one), None);
    }
}
