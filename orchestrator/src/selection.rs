//! What a run's settings select: some of the world's cases, and the streams.

use std::time::Duration;

use anyhow::{Result, ensure};
use case_book::{BookRequest, CaseBook, ElsewhereRequest, StreamsRequest, WorldFacts};
use conditions::settings::RunSettings;
use conditions::{Condition, Route};
use domain::{Arm, Demonstrations, Start};
use settings::select_cases;

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
        let ids = every.cases.book.ids();
        let cases = select_cases(&ids, &settings.cases, settings.limit)?;
        check_mismatches(settings, &every.cases.book.world)?;
        let demonstrations = demonstrations(settings);
        check_banks(&demonstrations, every.demonstrations.book.largest_bank())?;
        let books = write(&BookRequest {
            assets,
            cases: cases.iter().map(|&case| ids[case].to_owned()).collect(),
            demonstrations,
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

/// The sets of demonstrations that the groups name, each once.
fn demonstrations(settings: &RunSettings) -> Vec<Demonstrations> {
    let mut found = Vec::new();
    for &set in settings.groups.iter().flat_map(|group| &group.demos) {
        if !found.contains(&set) {
            found.push(set);
        }
    }
    found
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
