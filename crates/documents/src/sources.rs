//! The sources of documents: the selected demonstrations of all cases, in a world that is rendered.

use std::path::Path;

use anyhow::{Context, Result};
use domain::{Appearance, Demonstrations, hex};
use sha2::{Digest, Sha256};
use warehouse::{CaseSet, Demonstrated, Elsewhere, Viewpoint, Warehouse};

use crate::sha256_of_parts;

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
        let read = |(name, built_in): (&str, &[u8])| match assets {
            None => Ok(built_in.to_owned()),
            Some(folder) => {
                let path = folder.join(name);
                durable::input::read(&path)
                    .with_context(|| format!("cannot read {}", path.display()))
            }
        };
        let files: Vec<Vec<u8>> = WORLD_FILES.into_iter().map(read).collect::<Result<_>>()?;
        let (warehouse, cases) = CaseSet::with_warehouse(assets)?;
        let world_sha256 = sha256_of_files(files);
        Ok(Self { warehouse, cases, world_sha256, appearance: Appearance::STANDARD })
    }

    /// The same sources, with the other warehouse in which tasks are demonstrated, whose file has the text `elsewhere`, if there
    /// is one.
    ///
    /// # Errors
    /// When the text is not that of another warehouse.
    pub fn with_elsewhere(mut self, elsewhere: Option<&str>) -> Result<Self> {
        let read = |text| Elsewhere::parse(text, &self.warehouse, &self.cases);
        self.cases.elsewhere = elsewhere.map(read).transpose()?;
        Ok(self)
    }

    /// SHA-256, in hexadecimal digits, of the files of the world in which the demonstrations of `selection` take place.
    fn world_of(&self, selection: Demonstrations) -> String {
        match self.cases.elsewhere.as_ref().filter(|_| selection.take_place_elsewhere()) {
            None => self.world_sha256.clone(),
            Some(elsewhere) => sha256_of_files(elsewhere.files()),
        }
    }

    /// The same sources, in frames with this appearance.
    pub fn seen_with(self, appearance: Appearance) -> Self {
        Self { appearance, ..self }
    }

    /// The demonstrations that `selection` names for any case, each once: in the order of the cases, and for each
    /// case in the order of its own set.
    pub fn demonstrations(&self, selection: Demonstrations) -> Vec<Demonstrated<'_>> {
        let histories = self.cases.histories_of_all(selection).into_iter();
        histories.filter_map(|of| self.cases.demonstrated(&self.warehouse, of)).collect()
    }

    /// Where the views in the demonstrations of `selection` are seen from, sorted.
    pub fn viewpoints(&self, selection: Demonstrations) -> Vec<Viewpoint> {
        let demonstrations = self.demonstrations(selection);
        let mut viewpoints: Vec<Viewpoint> =
            demonstrations.iter().flat_map(Demonstrated::viewpoints).collect();
        viewpoints.sort_unstable();
        viewpoints.dedup();
        viewpoints
    }

    /// SHA-256, in hexadecimal digits, of everything that determines the demonstrations of `selection` and their views
    /// and is known without rendering: layout, catalogue, the demonstrations, the cells that are closed where one takes place,
    /// the frames' width and height, their appearance if it is not the standard one, and this program's version, which stands
    /// for how the world is drawn and how plates are read.
    ///
    /// Test references and other barricades are left out: a document does not depend on them.
    pub fn sha256(&self, selection: Demonstrations, frame: [u32; 2]) -> String {
        let frame = format!("{} x {}", frame[0], frame[1]);
        let mut parts = vec![
            "memtransfer sources v1".to_owned(),
            env!("CARGO_PKG_VERSION").to_owned(),
            self.world_of(selection),
            frame,
        ];
        if self.appearance != Appearance::STANDARD {
            parts.push(self.appearance.to_string());
        }
        for demonstrated in self.demonstrations(selection) {
            let Demonstrated { trajectory, closed, .. } = &demonstrated;
            parts.push(demonstrated.instruction());
            parts.push(trajectory.start.to_string());
            parts.push(trajectory.actions.iter().map(|action| action.letter()).collect());
            if !closed.is_empty() {
                let cells: Vec<String> = closed.iter().map(ToString::to_string).collect();
                parts.push(format!("closed {}", cells.join(" ")));
            }
        }
        sha256_of_parts(parts.iter().map(String::as_str))
    }
}

/// The SHA-256 of the SHA-256 of each file, in hexadecimal digits.
fn sha256_of_files(files: impl IntoIterator<Item: AsRef<[u8]>>) -> String {
    let mut hasher = Sha256::new();
    files.into_iter().for_each(|file| hasher.update(Sha256::digest(file)));
    hex(&hasher.finalize())
}

#[cfg(test)]
mod tests {
    use warehouse::ELSEWHERE_VARIANT;

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
        let count = |selection| sources.demonstrations(selection).len();
        assert_eq!(count(Demonstrations::NONE), 0);
        assert_eq!(count(Demonstrations::ORIGINAL), cases);
        assert_eq!(count(Demonstrations::ALL), 4 * cases);
        // Every case's own two; the others belong to some case, too.
        assert!((2 * cases..4 * cases).contains(&count(Demonstrations::IRRELEVANT)));
        assert_eq!(count(Demonstrations::BEFORE_AFTER), 2 * cases);
    }

    #[test]
    fn documents_of_the_other_warehouse_depend_on_it_alone() {
        let seen = |seed| {
            let Sources { warehouse, cases, .. } = sources();
            let other = Elsewhere::generate(&warehouse, &cases, seed).unwrap();
            sources().with_elsewhere(Some(&other.to_text())).unwrap()
        };
        let hash = |of: &Sources, selection| of.sha256(selection, FRAME);
        let (one, two) = (seen(1), seen(2));
        let elsewhere = Demonstrations::ELSEWHERE;
        assert_eq!(hash(&one, elsewhere), hash(&seen(1), elsewhere));
        assert_ne!(hash(&one, elsewhere), hash(&two, elsewhere));
        assert_eq!(hash(&one, Demonstrations::ALL), hash(&sources(), Demonstrations::ALL));
        let viewpoints = one.viewpoints(elsewhere);
        assert!(viewpoints.iter().all(|viewpoint| viewpoint.variant == ELSEWHERE_VARIANT));
    }

    #[test]
    fn a_demonstration_after_the_event_depends_on_what_is_closed() {
        let (sources, mut other) = (sources(), sources());
        let hash = |of: &Sources, selection| of.sha256(selection, FRAME);
        let passage = other.cases.cases[7].barricade.clone();
        other.cases.cases[8].barricade = passage;
        assert_eq!(hash(&sources, Demonstrations::ALL), hash(&other, Demonstrations::ALL));
        for selection in [Demonstrations::AFTER, Demonstrations::BEFORE_AFTER] {
            assert_ne!(hash(&sources, selection), hash(&other, selection));
        }
        assert_ne!(
            hash(&sources, Demonstrations::AFTER_BEFORE),
            hash(&sources, Demonstrations::BEFORE_AFTER)
        );
        let after = sources.viewpoints(Demonstrations::AFTER);
        assert!(after.iter().all(|viewpoint| viewpoint.variant > 0));
    }
}
