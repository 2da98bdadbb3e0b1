//! What of an episode's record follows from its run: from the seed and, where the run's folder has the case book, from the
//! cases.

use std::collections::BTreeMap;
use std::path::Path;

use case_book::{BookError, BookFile, CASE_BOOK_FILE, CaseBook, CaseFacts, WorldFacts};

use super::{EpisodeRecord, Manifest, PlannedFacts};

/// Seed and cases of a run.
#[derive(Debug)]
pub(super) struct KnownFacts {
    seed: u64,
    /// The case book; `None` before the world has written it.
    book: Option<CaseBook>,
}

impl KnownFacts {
    /// Those of the run in the folder `dir`.
    ///
    /// # Errors
    /// When its case book cannot be used.
    pub(super) fn of(dir: &Path, manifest: &Manifest) -> Result<Self, BookError> {
        let path = dir.join(CASE_BOOK_FILE);
        let file = path.exists().then(|| BookFile::read(&path)).transpose()?;
        Ok(Self { seed: manifest.settings.seed, book: file.map(|file| file.book) })
    }

    /// What the case book says about the world.
    pub(super) fn world(&self) -> WorldFacts {
        self.book.as_ref().map(|book| book.world.clone()).unwrap_or_default()
    }

    /// The cases of the case book, by id.
    pub(super) fn cases(&self) -> BTreeMap<String, CaseFacts> {
        let cases = self.book.iter().flat_map(|book| &book.cases);
        cases.map(|case| (case.id.clone(), case.clone())).collect()
    }

    /// Checks the seed, the task and the reference of a record whose fields make its key.
    pub(super) fn check(&self, record: &EpisodeRecord) -> Result<(), String> {
        let mut facts = PlannedFacts::of(record);
        facts.seed = record.own_key().seed(self.seed);
        if let Some(book) = &self.book {
            let index = book.index(&record.case);
            let case = index.and_then(|index| book.cases.get(index).map(|case| (index, case)));
            let Some((index, case)) = case else {
                return Err(format!("the run has no case {}", record.case));
            };
            facts.task = case.task;
            facts.reference = match &record.stream {
                None => case.reference(record.start, record.route).map(|of| of.length),
                Some(of) => {
                    let streams = book.streams.as_ref();
                    let found = streams.and_then(|streams| streams.case(of.world, index as u32));
                    found.map(|found| found.length)
                }
            }
            .unwrap_or(0);
            if let Some(failure) = record.shared_facts().failure
                && book.world.failure_index(&failure.kind).is_none()
            {
                return Err(format!("the world has no kind of failure {}", failure.kind));
            }
        }
        facts.check(PlannedFacts::of(record), &record.key, "by its run")
    }
}

#[cfg(test)]
mod tests {
    use domain::{Route, Start, State};

    use super::*;
    use crate::records::{manifest, record, world};
    use case_book::Reference;

    fn book() -> CaseBook {
        let reference = Reference {
            start: Start::Original,
            route: Route::Unchanged,
            begin: State::new(&[0.0, 0.0, 0.0]).unwrap(),
            actions: Vec::new(),
            length: 16,
        };
        let case = CaseFacts {
            id: "t01-01".to_owned(),
            task: 1,
            instruction: String::new(),
            paraphrase: None,
            references: vec![reference],
            invalidated_when_blocked: false,
        };
        CaseBook { world: world(), cases: vec![case], streams: None, stale: [].into() }
    }

    #[test]
    fn task_seed_and_reference_follow_from_the_run_and_its_cases() {
        let folder = tempfile::tempdir().unwrap();
        let run = manifest();
        let sound = EpisodeRecord { task: 1, reference: 16, ..record("t01-01", true) };
        let problem = |edit: fn(&mut EpisodeRecord)| {
            let mut record = sound.clone();
            edit(&mut record);
            KnownFacts::of(folder.path(), &run).unwrap().check(&record).err().unwrap_or_default()
        };
        // Without a case book only the seed can be checked.
        assert_eq!(problem(|record| record.reference = 9), "");
        assert_ne!(problem(|record| record.seed = 9), "");
        let path = folder.path().join(CASE_BOOK_FILE);
        std::fs::write(&path, BookFile::new(book()).unwrap().text).unwrap();
        assert_eq!(problem(|_| ()), "");
        let problems = [
            problem(|record| record.task = 9),
            problem(|record| record.seed = 9),
            problem(|record| record.reference = 9),
            problem(|record| record.case = "t99-01".to_owned()),
            problem(|record| {
                let fell = serde_json::json!({"kind": "fell", "step": 4});
                record.world.insert("failure".to_owned(), fell);
            }),
        ];
        insta::assert_snapshot!(problems.join("\n"), @r#"
        "task" of episodic/original/unchanged/original/run1/t01-01 is 9, and 1 by its run
        "seed" of episodic/original/unchanged/original/run1/t01-01 is 9, and 12812761443170901343 by its run
        "reference" of episodic/original/unchanged/original/run1/t01-01 is 9, and 16 by its run
        the run has no case t99-01
        the world has no kind of failure fell
        "#);
        std::fs::write(&path, "{}").unwrap();
        let error = KnownFacts::of(folder.path(), &run).err().unwrap().to_string();
        assert!(error.contains("is not part of a case book"), "{error}");
    }
}
