//! A run before and while it is executed: what `run`, `plan` and `work` share.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use build_commit::COMMIT;
use conditions::cost::ModelPrices;
use conditions::settings::{Group, RunSettings};
use conditions::{Demonstrations, Route, Start};
use domain::prompt_log::session_folder;
use domain::representation::Trajectories;
use domain::{ExternalName, cache_folder, shell_word};
use llm::Servers;
use orchestrator::books::Books;
use orchestrator::budget::Budget;
use orchestrator::command_files::command_files;
use orchestrator::documents::ReadyDocuments;
use orchestrator::external_memory::{self, ExternalMemory, StartedMemories};
use orchestrator::lanes::Lanes;
use orchestrator::launch;
use orchestrator::monitor::Monitor;
use orchestrator::pipeline::{self, Ending};
use orchestrator::plan::PlannedEpisode;
use orchestrator::progress::{ProgressDisplay, say};
use orchestrator::selection::SelectedCases;
use orchestrator::session::RunSession;
use orchestrator::status::EpisodeCounts;
use orchestrator::streams::Remaining;
use orchestrator::trace::RunTrace;
use run_log::{
    DOCUMENTS_FOLDER, FORMAT, LOGS_FOLDER, LogError, Manifest, Opened, PROMPTS_FOLDER, RunFolder,
    RunLog, UnitId,
};
use rustix::io::Errno;
use shm_types::message::{MAX_SOURCES, WIRE_VERSION};
use shm_types::{RunDir, registry};
use supervise::Children;

use super::documents::RunDocuments;
use super::run::flags::RunOptions;
use super::{Exit, in_one_line};
use crate::signals::{self, Signals};

/// What a plan of a run is made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// It is executed now. External memories write their logs into its folder.
    Execution,
    /// It is executed later, in units. External memories tell their names, and end.
    Units,
    /// It is described. No program is started.
    DryRun,
}

/// All episodes of a run.
pub(super) const ALL: Range<usize> = 0..usize::MAX;

/// A run before it starts: its settings and the episodes that follow from them.
pub(super) struct RunPlan {
    pub(super) settings: RunSettings,
    /// What the world tells about its cases.
    pub(super) books: Books,
    pub(super) episodes: Vec<PlannedEpisode>,
    /// The unit of a plan that it is.
    pub(super) unit: Option<UnitId>,
    /// The file of embeddings that came with the plan.
    pub(super) shipped_embeddings: Option<PathBuf>,
    pub(super) prices: Option<ModelPrices>,
    /// The external memories; `None` without any.
    started: Option<StartedMemories>,
}

/// What a signal can interrupt before the first episode.
pub(super) const STARTING_MEMORIES: &str = "external memories were being started";
pub(super) const BUILDING_DOCUMENTS: &str = "documents were being built";
pub(super) const FILLING_STORE: &str = "the store was being filled";

/// How the execution of a run ended.
pub(super) enum Executed {
    /// A signal came before the first episode.
    Stopped(Exit),
    /// The processes have ended.
    ToTheEnd {
        /// Why it stopped early, if a process or the budget did so.
        halted: Option<String>,
    },
}

/// Whether a full disk caused the error, here or in a child process, whose error is a text.
fn is_disk_full(error: &anyhow::Error) -> bool {
    let full = io::Error::from(Errno::NOSPC).to_string();
    error.chain().any(|cause| {
        let io_error = cause.downcast_ref::<io::Error>();
        io_error.is_some_and(|error| error.kind() == io::ErrorKind::StorageFull)
            || cause.to_string().contains(&full)
    })
}

/// Checks that every memory can name the demonstrations of its bank.
fn check_banks(settings: &RunSettings) -> Result<()> {
    for condition in settings.conditions() {
        let size = condition.demonstrations.bank_size().unwrap_or(0);
        let info = condition.memory.describe();
        let is_whole = info.is_some_and(|info| info.trajectories == Trajectories::Whole);
        ensure!(
            !is_whole || usize::from(size) <= MAX_SOURCES,
            "{condition}: {} memory names every demonstration at every step, and an answer has at most {MAX_SOURCES} sources: \
             give it a bank of its own in a [[group]]",
            condition.memory
        );
    }
    Ok(())
}

impl RunPlan {
    /// The plan of a run with `settings`, or of those of its episodes in `range`, once its external memories have told their
    /// names. `None` when a signal asked to stop meanwhile.
    pub(super) fn new(
        mut settings: RunSettings,
        range: Range<usize>,
        purpose: Purpose,
        options: &RunOptions,
        signals: &Signals,
    ) -> Result<Option<Self>> {
        // What can be wrong without the names of external memories is said before these start.
        if let Some(model) = &settings.model {
            ensure!(
                model.max_cost.is_none() || model.prices.is_some(),
                "--max-cost needs prices: give --prices FILE (docs/costs.md describes it)"
            );
        }
        let selection = SelectedCases::of(&settings)?;
        check_banks(&settings)?;
        let mut started = None;
        if purpose == Purpose::DryRun {
            name_memories_of_folder(&mut settings)?;
        } else {
            started = start_memories(&mut settings, purpose, options, signals)?;
            if settings.has_external_memories() && started.is_none() {
                return Ok(None);
            }
        }
        note_omissions(&settings);
        let episodes: Vec<PlannedEpisode> = selection.with_episodes(&settings, |episodes| {
            episodes.skip(range.start).take(range.len()).collect()
        });
        if episodes.is_empty() {
            bail!("no case is left: --limit is 0, or --cases selects none");
        }
        let priced =
            settings.model.as_ref().and_then(|model| Some((model, model.prices.as_ref()?)));
        let prices =
            priced.map(|(model, file)| ModelPrices::read(file, &model.model)).transpose()?;
        let SelectedCases { books, .. } = selection;
        Ok(Some(Self {
            settings,
            books,
            episodes,
            unit: None,
            shipped_embeddings: None,
            prices,
            started,
        }))
    }

    /// The external memories.
    fn memories(&self) -> &[ExternalMemory] {
        self.started.as_ref().map_or(&[], |started| &started.memories)
    }

    /// The keys of all episodes.
    pub(super) fn keys(&self) -> BTreeSet<String> {
        self.episodes.iter().map(|episode| episode.key.to_string()).collect()
    }

    /// The types of the tasks of all cases, if the run has banks.
    fn tasks(&self) -> BTreeMap<String, u8> {
        let conditions = self.settings.runs().into_iter();
        let mut sizes = conditions.map(|(condition, _)| condition.demonstrations.bank_size());
        if !sizes.any(|size| size.is_some()) {
            return BTreeMap::new();
        }
        let cases = self.books.cases.book.cases.iter();
        cases.map(|case| (case.id.clone(), case.task)).collect()
    }

    /// The run's manifest.
    pub(super) fn manifest(&self) -> Result<Manifest> {
        let memories = self.memories().iter();
        let memories = memories.map(|memory| Ok((memory.name, memory.facts()?)));
        let policy_cmd = self.settings.policy_cmd.as_deref();
        Ok(Manifest {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            wire_version: WIRE_VERSION,
            commit: COMMIT.map(str::to_owned),
            settings: self.settings.clone(),
            hashes: self.books.hashes(),
            tasks: self.tasks(),
            documents: BTreeMap::new(),
            memories: memories.collect::<Result<_>>()?,
            policy_files: policy_cmd.map(command_files).transpose()?.unwrap_or_default(),
            prices: self.prices.clone(),
            episodes: self.episodes.len() as u32,
            unit: self.unit.clone(),
            processes: BTreeMap::new(),
        })
    }

    /// The documents of the run, built if they are missing. `None` when a signal asked to stop.
    pub(super) fn documents(
        &self,
        options: &RunOptions,
        signals: &Signals,
    ) -> Result<Option<ReadyDocuments>> {
        RunDocuments::of(&self.settings, &self.books, options.fresh).supply(signals, options.quiet)
    }

    /// Whether a memory of the run matches views.
    pub(super) fn matches_views(&self) -> bool {
        launch::matches_views(&self.settings, self.memories())
    }

    /// Runs what is missing.
    pub(super) fn execute(&mut self, options: &RunOptions, signals: &Signals) -> Result<Executed> {
        self.execute_missing(options, signals).map_err(|error| match is_disk_full(&error) {
            false => error,
            true => anyhow!(
                "{}\nThe disk is full. Finished episodes are kept: free some space, then give the same command \
                 again:\n  {}",
                in_one_line(&error),
                same_command()
            ),
        })
    }

    fn execute_missing(&mut self, options: &RunOptions, signals: &Signals) -> Result<Executed> {
        let settings = self.settings.clone();
        RunFolder::check(&settings.out)?;
        let mut manifest = self.manifest()?;
        let Some(documents) = self.documents(options, signals)? else {
            return Ok(Executed::Stopped(stopped_before_episodes(signals, BUILDING_DOCUMENTS)));
        };
        manifest.documents = documents.facts();
        if !options.fresh && RunFolder::has_episodes(&settings.out) {
            let log = RunLog::read(&settings.out)?;
            // Other settings often select other episodes, too: report the cause first.
            let differences = manifest.differences(&log.manifest);
            if !differences.is_empty() {
                return Err(LogError::OtherSettings { dir: log.dir, differences }.into());
            }
            log.check_planned(&self.keys())?;
        }
        let opened = RunFolder::open(&settings.out, manifest, options.fresh)?;
        let Opened { mut folder, finished, requests, notes } = opened;
        notes.iter().for_each(|note| say(note));
        documents.copy_to(&folder.dir().join(DOCUMENTS_FOLDER))?;
        drop(documents);
        self.books.write(folder.dir())?;
        let remaining = Remaining::of(&self.books.cases.book, &self.episodes, &finished)?;
        let missing = &remaining.missing;
        if settings.log_prompts {
            let logged = folder.dir().join(PROMPTS_FOLDER);
            let logged = logged.exists().then_some(&*logged);
            if let Some(note) = prompt_log_note(finished.len(), missing.len(), logged) {
                say(&note);
            }
        }
        let prices = folder.manifest().prices.as_ref();
        if missing.is_empty() {
            // A killed run may have finished all episodes: remove what it left.
            registry::clean(&registry::default_base())?;
        }
        let budget = Budget::new(settings.model.as_ref(), prices, &requests);
        let mut halted = budget.exceeded().filter(|_| !missing.is_empty());
        if !missing.is_empty() && halted.is_none() {
            let successes = finished.iter().filter(|record| record.is_success()).count();
            let total = finished.len() + missing.len();
            if !finished.is_empty() && !options.quiet {
                let (out, done) = (settings.out.display(), finished.len());
                say!("resuming {out}: {done} of {total} episodes are finished");
            }
            let counts = EpisodeCounts {
                planned: total as u64,
                earlier: (finished.len() as u64, successes as u64),
                ..EpisodeCounts::default()
            };
            halted = self.session(remaining, counts, &mut folder, budget, options, signals)?;
        }
        // They are not needed while the table is made.
        self.started = None;
        Ok(Executed::ToTheEnd { halted })
    }

    /// Runs the missing episodes, and records how that ended. Returns why it stopped early, if a process or the
    /// budget did so.
    fn session(
        &mut self,
        remaining: Remaining,
        counts: EpisodeCounts,
        folder: &mut RunFolder,
        budget: Budget,
        options: &RunOptions,
        signals: &Signals,
    ) -> Result<Option<String>> {
        let Self { settings, books, started, unit, shipped_embeddings, .. } = self;
        if let Some(model) = &settings.model {
            let given = model.base_url.as_deref().map(|url| (url, options.base_url_source));
            let servers = Servers::from_environment(given, Path::new("."))?;
            if !options.quiet {
                say!("asking {} at {servers}", model.model);
            }
        }
        let Remaining { missing, learned } = remaining;
        let mut progress = ProgressDisplay::new(options.quiet);
        let (own, children);
        let (run, memories): (&RunDir, &[ExternalMemory]) = match started {
            Some(started) => {
                children = std::mem::take(&mut started.children);
                (&started.run, &started.memories)
            }
            None => {
                let base = registry::default_base();
                registry::clean(&base)?.notes().iter().for_each(|one| progress.note(one));
                own = RunDir::create(&base)?;
                children = Children::default();
                (&own, &[])
            }
        };
        let prompts = settings.out.join(PROMPTS_FOLDER);
        let prompts = settings.log_prompts.then(|| session_folder(&prompts, folder.session()));
        let mut attach =
            launch::attach(settings, books, &missing, (run, memories), prompts.as_deref())?;
        let trace = options.trace.as_deref().map(RunTrace::create).transpose()?;
        attach.spans = trace.as_ref().map(|trace| trace.spans().to_owned());
        if settings.warm_views {
            let views = books.cases.book.world.views;
            progress.note(&format!("rendering {views} views before the first step"));
        }
        let mut pipeline_options =
            launch::pipeline_options(settings, memories, folder.dir().join(LOGS_FOLDER))?;
        launch::tell_source_of_base_url(&mut pipeline_options, options.base_url_source.word());
        if unit.is_some() {
            launch::share_views(&mut pipeline_options, &cache_folder()?.join("views"));
        }
        if let Some(file) = shipped_embeddings {
            launch::ship_embeddings(&mut pipeline_options, file);
        }
        let rules = launch::rules(settings, memories)?;
        let mut lanes = Lanes::new(books, rules, attach.lanes as usize);
        for (sequence, position, experience) in learned {
            lanes.remember(sequence, position, experience);
        }
        let policy = folder.manifest().policy_label();
        let monitor = Monitor::new(folder.dir(), policy, attach.lanes, counts, progress);
        let size = (attach.lanes, attach.frame_capacity);
        let mut session = RunSession::new(folder, monitor, budget, trace, size);
        let stop = signals.stop();
        let outcome = pipeline::run_episodes(
            &mut lanes,
            missing,
            &attach,
            &pipeline_options,
            children,
            stop,
            &mut session,
        );
        let reason = match (&outcome, signals.received()) {
            (Err(error), _) => format!("{error:#}"),
            (Ok(_), Some(signal)) => signals::name(signal).to_owned(),
            (Ok(Ending { halted: Some(why), .. }), None) => why.clone(),
            (Ok(_), None) => "complete".to_owned(),
        };
        session.end(&outcome, &reason)?;
        Ok(outcome?.halted)
    }
}

/// The note about episodes whose prompts are not logged because they are finished. `logged` is the folder of the logs of
/// earlier sessions, if there is one.
fn prompt_log_note(finished: usize, missing: usize, logged: Option<&Path>) -> Option<String> {
    const ADVICE: &str = "To log them, run them again with another --out, or remove the folder to run all again (as `run --fresh` does)";
    match (finished, missing, logged) {
        (0, ..) | (_, 1.., Some(_)) => None,
        (_, 0, None) => Some(format!(
            "--log-prompts: nothing is logged, because all {finished} episodes are finished. {ADVICE}"
        )),
        (_, 0, Some(folder)) => Some(format!(
            "--log-prompts: nothing more is logged, because all {finished} episodes are finished. Earlier logs are in {}",
            folder.display()
        )),
        (_, 1.., None) => Some(format!(
            "--log-prompts: the prompts of {finished} episodes that are finished are not logged, only those of the \
             other {missing}. {ADVICE}"
        )),
    }
}

/// Reports requested combinations that do not exist.
fn note_omissions(settings: &RunSettings) {
    let groups = &settings.groups;
    let blocked_original = |group: &Group| {
        group.routes.contains(&Route::Blocked) && group.starts.contains(&Start::Original)
    };
    if groups.iter().any(blocked_original) {
        say("blocked routes exist for the new start only: left out for the original start");
    }
    let without_demonstrations = |group: &Group| {
        group.demos.contains(&Demonstrations::NONE)
            && group.memory.iter().any(|memory| memory.uses_demonstrations())
    };
    if groups.iter().any(without_demonstrations) {
        say("memories of demonstrations need some: left out with `--demos none`");
    }
}

/// Adds the names of the external memories of a dry run to the settings, as far as the run's folder has them: their programs, which
/// would tell them, are not started.
fn name_memories_of_folder(settings: &mut RunSettings) -> Result<()> {
    if settings.has_external_memories() {
        let recorded = match settings.out.join("manifest.json").exists() {
            true => Manifest::read(&settings.out)?.memories,
            false => BTreeMap::new(),
        };
        let named: Vec<(ExternalName, bool)> = recorded
            .iter()
            .filter(|(_, facts)| match &facts.command {
                Some(command) => settings.memory_cmd.contains(command),
                None => settings.external_memory,
            })
            .map(|(name, facts)| (*name, facts.learns))
            .collect();
        let all = settings.memory_cmd.len() + usize::from(settings.external_memory);
        settings.add_external_memories(&named);
        if named.len() < all {
            let reason = "a dry run starts no program, and a memory of your own tells its name when it starts";
            ensure!(
                !settings.conditions().is_empty(),
                "{reason}: without it no condition is left to list"
            );
            say(&format!("{reason}: its conditions are not listed"));
        }
    }
    settings::check(settings)
}

/// Starts the external memories of a run and adds their names to the settings. `None` without any, and when a signal asked to
/// stop.
fn start_memories(
    settings: &mut RunSettings,
    purpose: Purpose,
    options: &RunOptions,
    signals: &Signals,
) -> Result<Option<StartedMemories>> {
    let mut progress = ProgressDisplay::new(options.quiet);
    let mut logs = None;
    if purpose == Purpose::Execution {
        RunFolder::check(&settings.out)?;
        if options.fresh {
            RunFolder::remove_memory_logs(&settings.out)?;
        }
        logs = Some(settings.out.join(LOGS_FOLDER));
    }
    let started =
        external_memory::start(settings, logs, signals.stop(), &mut |note| progress.note(note))?;
    if let Some(started) = &started {
        let told = started.memories.iter().map(|memory| (memory.name, memory.description.learns));
        settings.add_external_memories(&told.collect::<Vec<_>>());
    }
    // With the names all conditions are known.
    settings::check(settings)?;
    Ok(started)
}

/// Reports that a signal came before the first episode, while something else was being done.
pub(super) fn stopped_before_episodes(signals: &Signals, meanwhile: &str) -> Exit {
    let signal = signals.received().unwrap_or_default();
    say!(
        "stopped by {} while {meanwhile}, before the first episode. Documents that were complete are kept. To \
         resume:\n  {}",
        signals::name(signal),
        same_command()
    );
    Exit::Signal(signal)
}

/// The command line that resumes the run: without `--fresh`, which would start over.
pub(super) fn same_command() -> String {
    let arguments = std::env::args_os().filter(|argument| argument != "--fresh");
    arguments.map(shell_word).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prompts_that_cannot_be_logged_any_more_are_counted() {
        let logged = Some(Path::new("runs/x/prompts"));
        assert_eq!(prompt_log_note(0, 12, None), None);
        assert_eq!(prompt_log_note(4, 8, logged), None);
        let note = |finished, missing, logged| prompt_log_note(finished, missing, logged).unwrap();
        insta::assert_snapshot!(note(12, 0, None), @"--log-prompts: nothing is logged, because all 12 episodes are finished. To log them, run them again with another --out, or remove the folder to run all again (as `run --fresh` does)");
        insta::assert_snapshot!(note(12, 0, logged), @"--log-prompts: nothing more is logged, because all 12 episodes are finished. Earlier logs are in runs/x/prompts");
        insta::assert_snapshot!(note(4, 8, None), @"--log-prompts: the prompts of 4 episodes that are finished are not logged, only those of the other 8. To log them, run them again with another --out, or remove the folder to run all again (as `run --fresh` does)");
    }

    #[test]
    fn a_full_disk_is_noticed_here_and_in_child_processes() {
        let full = || io::Error::from(Errno::NOSPC);
        let doing = "write to";
        let log = LogError::System { doing, path: "episodes.jsonl".into(), source: full() };
        let reported = format!("the memory process failed: cannot store embeddings: {}", full());
        for error in [anyhow::Error::from(log).context("session"), anyhow!(reported)] {
            assert!(is_disk_full(&error), "{error:#}");
        }
        assert!(!is_disk_full(&io::Error::from(Errno::ACCESS).into()));
    }
}
