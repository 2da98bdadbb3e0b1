//! What documents are made of: the selected demonstrations of all cases, walked in a world that is rendered.
//!
//! This is where map and catalogue are known, to replay a demonstration and to word its instruction. What goes
//! on to a builder is a [`Transcript`] of it.

use std::collections::HashSet;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use domain::Pose;
use sha2::{Digest, Sha256};
use shm_types::FrameSize;
use warehouse::case_file::CASES_FILE;
use warehouse::{CaseSet, Demonstrations, History, Warehouse};

use super::transcript::{Seen, Step, Transcript, hex};

/// Files that decide what a view of the world shows, and those that are built in.
const DRAWN: [(&str, &[u8]); 2] = [
    ("layout.toml", include_bytes!("../../../assets/layout.toml")),
    ("catalogue.toml", include_bytes!("../../../assets/catalogue.toml")),
];

/// The world and its cases.
#[derive(Debug)]
pub struct Sources {
    warehouse: Warehouse,
    cases: CaseSet,
    /// SHA-256 of the files of [`DRAWN`].
    drawn: [u8; 32],
}

impl Sources {
    /// What the folder `assets` holds, or what is built in.
    ///
    /// # Errors
    /// When a file cannot be read or says something impossible.
    pub fn load(assets: Option<&Path>) -> Result<Self> {
        let mut drawn = Sha256::new();
        let (warehouse, cases) = match assets {
            None => {
                DRAWN.iter().for_each(|(_, built_in)| drawn.update(Sha256::digest(built_in)));
                (Warehouse::shipped(), CaseSet::shipped())
            }
            Some(folder) => {
                for (name, _) in DRAWN {
                    let path = folder.join(name);
                    let bytes = fs::read(&path);
                    let bytes = bytes.with_context(|| format!("cannot read {}", path.display()))?;
                    drawn.update(Sha256::digest(bytes));
                }
                let warehouse = Warehouse::load(folder)?;
                let cases = CaseSet::load(&folder.join(CASES_FILE), &warehouse)?;
                (warehouse, cases)
            }
        };
        Ok(Self { warehouse, cases, drawn: drawn.finalize().into() })
    }

    /// The demonstrations that `selection` comes to for any case, each once: in the order of the cases, and
    /// for each in the order of its own set.
    pub fn histories(&self, selection: Demonstrations) -> Vec<History> {
        let mut known = HashSet::new();
        (0..self.cases.cases.len())
            .flat_map(|case| self.cases.histories(case, selection))
            .filter(|history| known.insert(*history))
            .collect()
    }

    /// The poses from which something is seen in a demonstration of `selection`, sorted.
    pub fn poses(&self, selection: Demonstrations) -> Vec<Pose> {
        let replayed = |History { case, start }: History| {
            self.cases.cases[case].replay(&self.warehouse, start).poses
        };
        let mut poses: Vec<Pose> =
            self.histories(selection).into_iter().flat_map(replayed).collect();
        poses.sort_unstable();
        poses.dedup();
        poses
    }

    /// The demonstrations of `selection`, given what is seen from a pose. `None` when that is not known of
    /// one of their poses.
    pub fn transcripts(
        &self,
        selection: Demonstrations,
        seen: impl Fn(Pose) -> Option<Arc<Seen>>,
    ) -> Option<Vec<Transcript>> {
        self.histories(selection)
            .into_iter()
            .map(|history| self.transcript(history, &seen))
            .collect()
    }

    fn transcript(
        &self,
        History { case, start }: History,
        seen: impl Fn(Pose) -> Option<Arc<Seen>>,
    ) -> Option<Transcript> {
        let case = &self.cases.cases[case];
        let replay = case.replay(&self.warehouse, start);
        let actions = case.trajectory(start).actions.iter().copied().map(Some).chain([None]);
        let states = replay.poses.into_iter().zip(replay.feedback).zip(replay.stages);
        let steps = states.zip(actions).map(|(((pose, feedback), completed), action)| {
            Some(Step { pose, feedback, seen: seen(pose)?, completed, action })
        });
        let instruction = case.task.instruction(&self.warehouse.catalogue);
        Some(Transcript { instruction, steps: steps.collect::<Option<_>>()? })
    }

    /// SHA-256, in hexadecimal digits, of what decides the transcripts of `selection` and is known without
    /// rendering: layout, catalogue, the demonstrations, the frames' size, and this program's version, which
    /// stands for how the world is drawn and how plates are read.
    ///
    /// Test references and barricades do not enter: a document does not depend on them.
    pub fn sha256(&self, selection: Demonstrations, frame: FrameSize) -> String {
        let mut hasher = Sha256::new();
        let mut add = |part: &str| {
            hasher.update((part.len() as u64).to_le_bytes());
            hasher.update(part);
        };
        add("memtransfer sources v1");
        add(env!("CARGO_PKG_VERSION"));
        add(&hex(&self.drawn));
        add(&format!("{} x {}", frame.width, frame.height));
        for History { case, start } in self.histories(selection) {
            let case = &self.cases.cases[case];
            let walk = case.trajectory(start);
            add(&case.task.instruction(&self.warehouse.catalogue));
            add(&walk.start.to_string());
            add(&walk.actions.iter().map(|action| action.letter()).collect::<String>());
        }
        hex(&hasher.finalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources() -> Sources {
        Sources::load(None).unwrap()
    }

    #[test]
    fn a_copy_of_the_built_in_assets_is_the_same_source() {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
        let (built_in, read) = (sources(), Sources::load(Some(&assets)).unwrap());
        let hash = |sources: &Sources| sources.sha256(Demonstrations::ALL, FrameSize::DEFAULT);
        assert_eq!(hash(&built_in), hash(&read));
        let small = FrameSize { width: 224, height: 224 };
        assert_ne!(hash(&built_in), built_in.sha256(Demonstrations::ALL, small));
        assert_ne!(hash(&built_in), built_in.sha256(Demonstrations::ORIGINAL, FrameSize::DEFAULT));
    }

    #[test]
    fn every_demonstration_of_a_set_comes_up_once() {
        let sources = sources();
        let cases = sources.cases.cases.len();
        let count = |selection| sources.histories(selection).len();
        assert_eq!(count(Demonstrations::NONE), 0);
        assert_eq!(count(Demonstrations::ORIGINAL), cases);
        assert_eq!(count(Demonstrations::ALL), 4 * cases);
        // Every case's own two; what else there is belongs to some case.
        assert!((2 * cases..4 * cases).contains(&count(Demonstrations::IRRELEVANT)));
    }

    /// References cannot get into a document: nothing that is made here changes with them.
    #[test]
    fn test_references_and_barricades_make_no_difference() {
        let (sources, mut other) = (sources(), sources());
        for case in &mut other.cases.cases {
            case.test = case.original.clone();
            case.blocked = case.distant.clone();
            case.barricade.clear();
            case.id.push('x');
        }
        let nothing = |_| Some(Arc::default());
        for word in ["original", "opposite", "nearby+distant", "4", "irrelevant", "confusable"] {
            let selection: Demonstrations = word.parse().unwrap();
            assert_eq!(sources.poses(selection), other.poses(selection));
            assert_eq!(
                sources.transcripts(selection, nothing),
                other.transcripts(selection, nothing)
            );
            let hash = |sources: &Sources| sources.sha256(selection, FrameSize::DEFAULT);
            assert_eq!(hash(&sources), hash(&other));
        }
    }

    #[test]
    fn a_transcript_is_the_demonstration_and_needs_every_view() {
        let sources = sources();
        let nothing = |_| Some(Arc::default());
        let transcripts = sources.transcripts(Demonstrations::ORIGINAL, nothing).unwrap();
        let case = &sources.cases.cases[0];
        let Transcript { instruction, steps } = &transcripts[0];
        assert_eq!(*instruction, case.task.instruction(&sources.warehouse.catalogue));
        let actions: Vec<_> = steps.iter().filter_map(|step| step.action).collect();
        assert_eq!(actions, case.original.actions);
        assert_eq!((steps[0].pose, steps[0].completed), (case.original.start, 0));
        assert!(steps[steps.len() - 1].completed > 0);
        let but_one = |pose| (pose != steps[3].pose).then(Arc::default);
        assert_eq!(sources.transcripts(Demonstrations::ORIGINAL, but_one), None);
    }
}
