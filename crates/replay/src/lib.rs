//! The world and the cases of a run: built in, or read from a folder of assets.

use std::collections::BTreeMap;
use std::path::Path;

use results::log::ELSEWHERE_HASH;
use warehouse::case_file::CASES_FILE;
use warehouse::{AssetError, CaseSet, Elsewhere, ElsewhereError, Warehouse};

/// Files whose contents determine the outcome of a run: name of the hash, file, built-in text.
const HASHED: [(&str, &str, &[u8]); 4] = [
    ("layout", "layout.toml", include_bytes!("../../../assets/layout.toml")),
    ("catalogue", "catalogue.toml", include_bytes!("../../../assets/catalogue.toml")),
    ("cases", CASES_FILE, include_bytes!("../../../assets/cases.toml")),
    ("models", "models.toml", include_bytes!("../../../assets/models.toml")),
];

/// The warehouse, its cases, and the hashes that identify them.
#[derive(Debug, Clone)]
pub struct World {
    /// The warehouse.
    pub warehouse: Warehouse,
    /// The cases.
    pub cases: CaseSet,
    /// BLAKE3 hashes of the files, as hexadecimal digits, by name.
    pub hashes: BTreeMap<String, String>,
}

impl World {
    /// Reads the assets in the folder `assets`, or takes the built-in ones.
    ///
    /// # Errors
    /// When a file cannot be read or is invalid.
    pub fn load(assets: Option<&Path>) -> Result<Self, AssetError> {
        let (warehouse, cases) = CaseSet::with_warehouse(assets)?;
        let mut hashes = BTreeMap::new();
        for (name, file, built_in) in HASHED {
            let own = assets.map(|dir| dir.join(file)).filter(|path| path.exists());
            let hash = match own {
                None => blake3::hash(built_in),
                Some(path) => {
                    let unreadable = |source| AssetError::Unreadable {
                        file: path.display().to_string(),
                        source,
                    };
                    blake3::hash(&durable::input::read(&path).map_err(unreadable)?)
                }
            };
            hashes.insert(name.to_owned(), hash.to_hex().to_string());
        }
        Ok(Self { warehouse, cases, hashes })
    }

    /// Adds the other warehouse in which tasks are demonstrated: the one in the folder `assets`, or one drawn from `seed`.
    ///
    /// # Errors
    /// When a file cannot be used, or the tasks cannot be demonstrated there.
    pub fn add_elsewhere(
        &mut self,
        assets: Option<&Path>,
        seed: u64,
    ) -> Result<(), ElsewhereError> {
        let Self { warehouse, cases, hashes } = self;
        let elsewhere = match assets {
            Some(dir) => Elsewhere::load(dir, warehouse, cases, seed)?,
            None => Elsewhere::generate(warehouse, cases, seed)?,
        };
        let hash = blake3::hash(elsewhere.to_text().as_bytes()).to_hex().to_string();
        hashes.insert(ELSEWHERE_HASH.to_owned(), hash);
        cases.elsewhere = Some(elsewhere);
        Ok(())
    }

    /// The ids of all cases, in the order of the case file.
    pub fn case_ids(&self) -> Vec<&str> {
        self.cases.cases.iter().map(|case| case.id.as_str()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_world_and_a_copy_of_it_have_the_same_hashes() {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
        let (built_in, read) = (World::load(None).unwrap(), World::load(Some(&assets)).unwrap());
        assert_eq!(built_in.hashes, read.hashes);
        assert_eq!(built_in.case_ids(), read.case_ids());
    }
}
