//! The sources of documents: the selected demonstrations of all cases, in a world that is rendered.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use domain::{Appearance, Pose};
use sha2::{Digest, Sha256};
use warehouse::case_file::CASES_FILE;
use warehouse::{CaseSet, Demonstrations, History, Warehouse};

use crate::{hex, sha256_of_parts};

/// The files that determine what a view shows, and their built-in content.
const WORLD_FILES: [(&str, &[u8]); 2] = [
    ("layout.toml", include_bytes!("../../../assets/layout.toml")),
    ("catalogue.toml", include_bytes!("../../../assets/catalogue.toml")),
];

/// The world and its cases.
#[derive(Debug)]
pub struct Sources {
    /// The world.
    pub warehouse: Warehouse,
    /// Its cases.
    pub cases: CaseSet,
    /// SHA-256 of the world's files, in hexadecimal digits.
    world_sha256: String,
    /// How the world looks in frames.
    appearance: Appearance,
}

impl Sources {
    /// Loads the folder `assets`, or the built-in assets.
    ///
    /// # Errors
    /// When a file cannot be read or is invalid.
    pub fn load(assets: Option<&Path>) -> Result<Self> {
        let mut world = Sha256::new();
        let (warehouse, cases) = match assets {
            None => {
                WORLD_FILES.iter().for_each(|(_, built_in)| world.update(Sha256::digest(built_in)));
                (Warehouse::shipped(), CaseSet::shipped())
            }
            Some(folder) => {
                for (name, _) in WORLD_FILES {
                    let path = folder.join(name);
                    let bytes = fs::read(&path);
                    let bytes = bytes.with_context(|| format!("cannot read {}", path.display()))?;
                    world.update(Sha256::digest(bytes));
                }
                let warehouse = Warehouse::load(folder)?;
                let cases = CaseSet::load(&folder.join(CASES_FILE), &warehouse)?;
                (warehouse, cases)
            }
        };
        let world_sha256 = hex(&world.finalize());
        Ok(Self { warehouse, cases, world_sha256, appearance: Appearance::STANDARD })
    }

    /// The same sources, in frames with this appearance.
    pub fn seen_with(self, appearance: Appearance) -> Self {
        Self { appearance, ..self }
    }

    /// The demonstrations that `selection` names for any case, each once: in the order of the cases, and for each
    /// case in the order of its own set.
    pub fn histories(&self, selection: Demonstrations) -> Vec<History> {
        let mut known = HashSet::new();
        (0..self.cases.cases.len())
            .flat_map(|case| self.cases.histories(case, selection))
            .filter(|history| known.insert(*history))
            .collect()
    }

    /// The poses of the views in the demonstrations of `selection`, sorted.
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

    /// SHA-256, in hexadecimal digits, of everything that determines the demonstrations of `selection` and their views
    /// and is known without rendering: layout, catalogue, the demonstrations, the frames' width and height, their appearance
    /// if it is not the standard one, and this program's version, which stands for how the world is drawn and how plates
    /// are read.
    ///
    /// Test references and barricades are left out: a document does not depend on them.
    pub fn sha256(&self, selection: Demonstrations, frame: [u32; 2]) -> String {
        let frame = format!("{} x {}", frame[0], frame[1]);
        let mut parts = vec![
            "memtransfer sources v1".to_owned(),
            env!("CARGO_PKG_VERSION").to_owned(),
            self.world_sha256.clone(),
            frame,
        ];
        if self.appearance != Appearance::STANDARD {
            parts.push(self.appearance.to_string());
        }
        for History { case, start } in self.histories(selection) {
            let case = &self.cases.cases[case];
            let trajectory = case.trajectory(start);
            parts.push(case.task.instruction(&self.warehouse.catalogue));
            parts.push(trajectory.start.to_string());
            parts.push(trajectory.actions.iter().map(|action| action.letter()).collect());
        }
        sha256_of_parts(parts.iter().map(String::as_str))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: [u32; 2] = [448, 448];

    fn sources() -> Sources {
        Sources::load(None).unwrap()
    }

    #[test]
    fn a_copy_of_the_built_in_assets_is_the_same_source() {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
        let (built_in, read) = (sources(), Sources::load(Some(&assets)).unwrap());
        let hash = |sources: &Sources| sources.sha256(Demonstrations::ALL, FRAME);
        assert_eq!(hash(&built_in), hash(&read));
        assert_ne!(hash(&built_in), built_in.sha256(Demonstrations::ALL, [224, 224]));
        assert_ne!(hash(&built_in), built_in.sha256(Demonstrations::ORIGINAL, FRAME));
        let seeded = sources().seen_with(Appearance { seed: 7, ..Appearance::STANDARD });
        assert_ne!(hash(&built_in), hash(&seeded));
        assert_eq!(hash(&built_in), hash(&seeded.seen_with(Appearance::STANDARD)));
    }

    #[test]
    fn every_demonstration_of_a_set_is_listed_once() {
        let sources = sources();
        let cases = sources.cases.cases.len();
        let count = |selection| sources.histories(selection).len();
        assert_eq!(count(Demonstrations::NONE), 0);
        assert_eq!(count(Demonstrations::ORIGINAL), cases);
        assert_eq!(count(Demonstrations::ALL), 4 * cases);
        // Every case's own two; the others belong to some case, too.
        assert!((2 * cases..4 * cases).contains(&count(Demonstrations::IRRELEVANT)));
    }
}
