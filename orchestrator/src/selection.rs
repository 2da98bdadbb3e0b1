//! What a run's settings select: some of the world's cases, and the streams.

use std::time::Duration;

use anyhow::{Result, ensure};
use case_book::{
    BookRequest, CaseBook, DEMONSTRATIONS_FILE, DemonstrationBook, ElsewhereRequest,
    StreamsRequest, WorldFacts,
};
use conditions::settings::RunSettings;
use conditions::{Condition, Route};
use domain::{Arm, Demonstrations, Start};
use settings::cases_of_run;

use crate::books::Books;
use crate::plan::{PlannedEpisode, plan, plan_streams};

/// The case book of a run, and which of its cases take part.
#[derive(Debug, Clone)]
pub struct SelectedCases {
    /// The case book.
    pub books: Books,
    /// Indices of the cases.
    pub cases: Vec<usize>,
}

impl SelectedCases {
    /// What `settings` select in the world.
    ///
    /// # Errors
    /// When assets cannot be used, there is no such case or bank, or no streams can be drawn.
    pub fn of(settings: &RunSettings) -> Result<Self> {
        match &settings.world_book {
            Some(folder) => {
                Self::written_by(|request| Books::written_before(folder, request), settings)
            }
            None => {
                let command = settings.world_cmd.as_deref();
                let limit = Duration::from_secs(settings.start_timeout.into());
                Self::written_by(|request| Books::of_world(command, request, limit), settings)
            }
        }
    }

    /// What `settings` select of books that `write` writes.
    ///
    /// # Errors
    /// As [`of`](Self::of), and those of `write`.
    pub fn written_by(
        write: impl Fn(&BookRequest) -> Result<Books>,
        settings: &RunSettings,
    ) -> Result<Self> {
        // Which cases there are is known to the world alone.
        let assets = settings.assets.clone();
        let every = write(&BookRequest { assets: assets.clone(), ..BookRequest::default() })?;
        let book = &every.cases.book;
        let (ids, cases) = (book.ids(), cases_of_run(&book.world, &book.cases, settings)?);
        ensure!(!cases.is_empty(), "no case is left: --limit is 0, or --cases selects none");
        check_mismatches(settings, &book.world)?;
        let demonstrations = demonstrations(settings)?;
        check_banks(&demonstrations, every.demonstrations.book.largest_bank())?;
        let books = write(&BookRequest {
            assets,
            cases: cases.iter().map(|&case| ids[case].to_owned()).collect(),
            demonstrations: demonstrations.clone(),
            blocked: settings.groups.iter().any(|group| group.routes.contains(&Route::Blocked)),
            elsewhere: settings.demonstrates_elsewhere().then(|| ElsewhereRequest {
                assets: settings.elsewhere.clone(),
                seed: settings.seed,
            }),
            streams: settings.stream.as_ref().map(|stream| StreamsRequest {
                rules: stream.rules(),
                seed: settings.seed,
                planned: settings.groups.iter().any(|group| group.arms.contains(&Arm::Oracle)),
            }),
        })?;
        check_references(&demonstrations, &books.demonstrations.book)?;
        Ok(Self { books, cases })
    }

    /// The cases of the world.
    pub fn book(&self) -> &CaseBook {
        &self.books.cases.book
    }

    /// The number of episodes of a run with `settings`.
    pub fn count(&self, settings: &RunSettings) -> usize {
        self.with_episodes(settings, |episodes| episodes.count())
    }

    /// The number of selected cases that have no blocked route, where a run with `settings` has episodes on those.
    pub fn without_blocked_route(&self, settings: &RunSettings) -> usize {
        let is_blocked = |condition: &Condition| condition.route == Route::Blocked;
        if !settings.conditions().iter().any(is_blocked) {
            return 0;
        }
        let has_none = |case: &&usize| {
            self.book().cases[**case].reference(Start::New, Route::Blocked).is_none()
        };
        self.cases.iter().filter(has_none).count()
    }

    /// Calls `each` with the episodes of a run with `settings`, in their order. One that the case book has no reference for, on the
    /// blocked route of a case without one, is left out.
    pub fn with_episodes<T>(
        &self,
        settings: &RunSettings,
        each: impl FnOnce(&mut dyn Iterator<Item = PlannedEpisode>) -> T,
    ) -> T {
        let (runs, ids) = (settings.runs(), self.book().ids());
        match self.book().streams.as_ref().zip(settings.stream.as_ref()) {
            Some((streams, stream)) => {
                each(&mut plan_streams(&runs, streams, stream, &ids, settings.seed))
            }
            None => {
                let all = plan(&runs, &self.cases, &ids, settings.seed);
                each(&mut all.filter(|episode| episode.expert(self.book()).is_some()))
            }
        }
    }
}

/// The sets of demonstrations that the groups name, and those that memories of control arms hold, each once.
fn demonstrations(settings: &RunSettings) -> Result<Vec<Demonstrations>> {
    let mut settings = settings.clone();
    if settings.has_external_memories() && settings.external_names().is_empty() {
        // Their names are not known yet, and do not matter here.
        settings.add_external_memories(&[("any".parse()?, false)]);
    }
    let conditions = settings.conditions();
    let remembering = conditions.iter().filter(|condition| condition.memory.uses_demonstrations());
    let held = remembering.map(|condition| settings.demonstrations_of(condition));
    let mut found = Vec::new();
    for set in settings.groups.iter().flat_map(|group| &group.demos).copied().chain(held) {
        if !found.contains(&set) {
            found.push(set);
        }
    }
    Ok(found)
}

/// Checks that a world has test references among its demonstrations only where memories of the arm `oracle` hold them.
fn check_references(sets: &[Demonstrations], book: &DemonstrationBook) -> Result<()> {
    for route in [Route::Unchanged, Route::Blocked] {
        let is_held = sets.iter().any(|set| set.reference() == Some(route));
        ensure!(
            is_held || book.cases.iter().all(|case| case.reference(route).is_none()),
            "{DEMONSTRATIONS_FILE} of the world {} has test references of the {route} route, which only memories of the arm \
             `oracle` may hold, and the run has none there: have the case book written without them",
            book.world.name
        );
    }
    Ok(())
}

/// Checks that `world` offers the mismatches of `settings`.
fn check_mismatches(settings: &RunSettings, world: &WorldFacts) -> Result<()> {
    let (name, offered) = (&world.declaration.name, &world.mismatches);
    for mismatch in settings.mismatches() {
        let names: Vec<&str> = offered.iter().map(|one| one.name()).collect();
        ensure!(
            offered.contains(&mismatch),
            "--mismatch {mismatch}: the world {name} offers {}",
            if names.is_empty() { "none".to_owned() } else { names.join(", ") }
        );
    }
    Ok(())
}

/// Checks that the cases have as many demonstrations as each bank holds.
fn check_banks(sets: &[Demonstrations], most: usize) -> Result<()> {
    for set in sets {
        ensure!(
            usize::from(set.bank_size().unwrap_or(0)) <= most,
            "{set}: the largest bank is bank-{most}, the own demonstrations of all cases; a world with more cases has a larger one \
             (a warehouse: `memtransfer generate world --cases N`, then --assets)"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use case_book::BookFile;
    use settings::{Layer, resolve};
    use warehouse::case_book::write_books;

    use super::*;
    use crate::testing::selected;

    /// The references among the demonstrations of the first case.
    fn references(selected: &SelectedCases) -> [bool; 2] {
        let case = &selected.books.demonstrations.book.cases[0];
        [Route::Unchanged, Route::Blocked].map(|route| case.reference(route).is_some())
    }

    #[test]
    fn test_references_are_demonstrations_where_a_memory_holds_them_only() {
        let of = |arms, routes, starts| {
            let flags = [("arms", arms), ("routes", routes), ("starts", starts), ("limit", "1")];
            references(&selected(&[&[("memory", "working,episodic")], &flags[..]].concat()))
        };
        let both = "unchanged,blocked";
        assert_eq!(of("frozen,wrong", both, "original,new"), [false, false]);
        assert_eq!(of("frozen,oracle", both, "original,new"), [true, true]);
        assert_eq!(of("oracle", "unchanged", "new"), [true, false]);
        // From there the original demonstration is the reference.
        assert_eq!(of("oracle", "unchanged", "original"), [false, false]);
        // The name of an external memory is told after the case book is written.
        let external = [("memory", "none"), ("memory-cmd", "m"), ("arms", "oracle")];
        assert_eq!(references(&selected(&external)), [true, false]);
    }

    #[test]
    fn a_world_that_gives_references_away_is_refused() {
        let generous = |request: &BookRequest| {
            let demonstrations = vec![Demonstrations::NEW_REFERENCE];
            let books = write_books(&BookRequest { demonstrations, ..request.clone() })?;
            let (cases, demonstrations) = (books.cases, books.demonstrations);
            let (cases, demonstrations) = (BookFile::new(cases)?, BookFile::new(demonstrations)?);
            Ok(Books { cases, demonstrations, streams: None, elsewhere: None })
        };
        let flags = Layer::flags([("memory", "episodic"), ("starts", "new")]).unwrap();
        let settings = resolve([flags]).unwrap().settings;
        let refused = SelectedCases::written_by(generous, &settings).unwrap_err();
        insta::assert_snapshot!(refused, @"demonstrations.json of the world warehouse has test references of the unchanged route, which only memories of the arm `oracle` may hold, and the run has none there: have the case book written without them");
    }
}
