//! What of an episode's record follows from its run: from the seed and, where they are known, from the cases.

use std::collections::BTreeMap;
use std::path::Path;

use warehouse::{CaseSet, TrajectoryKind, Warehouse, file_texts};

use super::{EpisodeRecord, Manifest, PlannedFacts};
use crate::conditions::{Route, Start};

/// Seed and cases of a run.
pub(super) struct KnownFacts {
    seed: u64,
    cases: Option<KnownCases>,
}

/// The cases of a run.
struct KnownCases {
    warehouse: Warehouse,
    cases: CaseSet,
    /// Indices by id.
    indices: BTreeMap<String, usize>,
    /// Lengths of references, once they are needed.
    references: BTreeMap<(usize, Start, Route), u32>,
}

impl KnownFacts {
    /// Those of the run that `manifest` describes. Its cases are known if they are those that are compiled in, or if the
    /// folder of assets that it names has them.
    pub(super) fn of(manifest: &Manifest) -> Self {
        let has = |assets: Option<&Path>| {
            file_texts(assets).is_ok_and(|texts| {
                texts.iter().all(|(name, text)| {
                    let hash = blake3::hash(text.as_bytes()).to_hex();
                    manifest.hashes.get(*name).is_some_and(|known| *known == *hash)
                })
            })
        };
        let assets = manifest.settings.assets.as_deref();
        let found = [None, assets].into_iter().find(|assets| has(*assets));
        let read = found.and_then(|assets| CaseSet::with_warehouse(assets).ok());
        let cases = read.map(|(warehouse, cases)| {
            let ids = cases.cases.iter().map(|case| case.id.clone());
            let indices = ids.zip(0..).collect();
            KnownCases { warehouse, cases, indices, references: BTreeMap::new() }
        });
        Self { seed: manifest.settings.seed, cases }
    }

    /// Checks the seed, the task and the reference of a record whose fields make its key.
    pub(super) fn check(&mut self, record: &EpisodeRecord) -> Result<(), String> {
        let mut facts = PlannedFacts::of(record);
        facts.seed = record.own_key().seed(self.seed);
        if let Some(cases) = &mut self.cases {
            cases.facts(record, &mut facts)?;
        }
        facts.check(PlannedFacts::of(record), &record.key, "by its run")
    }
}

impl KnownCases {
    /// Sets what follows from the case of `record`. In a stream the world has changed, and so has the reference.
    fn facts(&mut self, record: &EpisodeRecord, facts: &mut PlannedFacts) -> Result<(), String> {
        let Some(&index) = self.indices.get(&record.case) else {
            return Err(format!("the run has no case {}", record.case));
        };
        let Some(case) = self.cases.cases.get(index) else { return Ok(()) };
        facts.task = case.task.task_type().number();
        if record.stream.is_none() {
            let reference = || {
                let replay = case
                    .replay(&self.warehouse, TrajectoryKind::reference(record.start, record.route));
                replay.length.unwrap_or(0)
            };
            let known = self.references.entry((index, record.start, record.route));
            facts.reference = *known.or_insert_with(reference);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::testing::{manifest, record};

    #[test]
    fn task_seed_and_reference_follow_from_the_run_and_its_cases() {
        let mut run = manifest();
        let texts = file_texts(None).unwrap();
        run.hashes = texts
            .iter()
            .map(|(name, text)| {
                ((*name).to_owned(), blake3::hash(text.as_bytes()).to_hex().to_string())
            })
            .collect();
        let case = &CaseSet::shipped().cases[0];
        let sound = EpisodeRecord {
            task: case.task.task_type().number(),
            reference: case.replay(&Warehouse::shipped(), TrajectoryKind::Original).length.unwrap(),
            ..record(&case.id, true)
        };
        let problem = |manifest: &Manifest, edit: fn(&mut EpisodeRecord)| {
            let mut record = sound.clone();
            edit(&mut record);
            KnownFacts::of(manifest).check(&record).err().unwrap_or_default()
        };
        assert_eq!(problem(&run, |_| ()), "");
        let problems = [
            problem(&run, |record| record.task = 9),
            problem(&run, |record| record.seed = 9),
            problem(&run, |record| record.reference = 9),
            problem(&run, |record| record.case = "t99-01".to_owned()),
        ];
        insta::assert_snapshot!(problems.join("\n"), @r#"
        "task" of episodic/original/unchanged/original/run1/t01-01 is 9, and 1 by its run
        "seed" of episodic/original/unchanged/original/run1/t01-01 is 9, and 12812761443170901343 by its run
        "reference" of episodic/original/unchanged/original/run1/t01-01 is 9, and 16 by its run
        the run has no case t99-01
        "#);
        // Unknown cases: only the seed can be checked.
        assert_eq!(problem(&manifest(), |record| record.reference = 9), "");
        assert_ne!(problem(&manifest(), |record| record.seed = 9), "");
        // A folder of assets has them, as long as it has not changed.
        let folder = tempfile::tempdir().unwrap();
        for (file, (_, text)) in ["layout.toml", "catalogue.toml", "cases.toml"].iter().zip(&texts)
        {
            let text = format!("{text}\n# mine\n");
            std::fs::write(folder.path().join(file), &text).unwrap();
        }
        let mut own = run.clone();
        own.settings.assets = Some(folder.path().to_owned());
        for (name, text) in file_texts(Some(folder.path())).unwrap() {
            own.hashes.insert(name.to_owned(), blake3::hash(text.as_bytes()).to_hex().to_string());
        }
        assert_ne!(problem(&own, |record| record.reference = 9), "");
        std::fs::write(folder.path().join("cases.toml"), "").unwrap();
        assert_eq!(problem(&own, |record| record.reference = 9), "");
    }
}
