//! Executes a run: what is missing of it goes through the processes and into its folder.

use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use domain::cache_folder;
use domain::prompt_log::session_folder;
use run_log::{
    DOCUMENTS_FOLDER, LOGS_FOLDER, LogError, Manifest, Opened, PROMPTS_FOLDER, RunFolder, RunLog,
};
use shm_types::{Attach, registry};

use crate::budget::Budget;
use crate::external_memory::StartedMemories;
use crate::invocation::Invocation;
use crate::lanes::Lanes;
use crate::launch;
use crate::monitor::Monitor;
use crate::pipeline::{self, Ending, Observer, PipelineOptions};
use crate::plan::PlannedEpisode;
use crate::progress::{ProgressDisplay, Verbosity, say};
use crate::run_documents::DocumentSupply;
use crate::run_plan::RunPlan;
use crate::session::RunSession;
use crate::status::EpisodeCounts;
use crate::streams::Remaining;
use crate::trace::RunTrace;

/// How the execution of a run ended.
#[derive(Debug)]
pub enum RunOutcome {
    /// It was asked to stop before the first episode, while documents were being built.
    Stopped,
    /// It has stopped before the first episode, because documents take more than it may spend: the reason.
    OverBudget(String),
    /// All its episodes were finished before.
    NothingMissing,
    /// The processes have ended, or the budget was used up before they were started.
    Ended(Ending),
}

/// Executes the episodes of `plan` that its run folder does not have, and records them there.
///
/// # Errors
/// When the folder has another run or cannot be written, a document is missing and cannot be built, there is too little shared
/// memory, or the processes fail repeatedly.
pub fn execute(mut plan: RunPlan, invocation: &Invocation<'_>) -> Result<RunOutcome> {
    RunFolder::check(&plan.settings.out)?;
    let mut manifest = plan.manifest()?;
    let started = plan.started.take();
    let settings = &plan.settings;
    let mut fresh = invocation.fresh;
    // So that a session that is stopped before the first episode leaves what it has spent.
    let record = &mut |documents| {
        let manifest = Manifest { documents, ..manifest.clone() };
        let opened = RunFolder::open(&settings.out, manifest, std::mem::take(&mut fresh))?;
        opened.notes.iter().for_each(|note| say(note));
        Ok(())
    };
    let documents = match plan.documents(invocation, record)? {
        DocumentSupply::Ready(documents) => documents,
        DocumentSupply::Stopped => return Ok(RunOutcome::Stopped),
        DocumentSupply::OverBudget(why) => return Ok(RunOutcome::OverBudget(why)),
    };
    manifest.documents = documents.facts();
    if !invocation.fresh && RunFolder::has_episodes(&settings.out) {
        check_resumable(&plan, &manifest)?;
    }
    let opened = RunFolder::open(&settings.out, manifest, fresh)?;
    let Opened { mut folder, finished, requests, notes } = opened;
    let mut progress = ProgressDisplay::new(invocation.verbosity);
    notes.iter().for_each(|note| progress.note(note));
    documents.copy_to(&folder.dir().join(DOCUMENTS_FOLDER))?;
    drop(documents);
    plan.write(folder.dir())?;
    let remaining = Remaining::of(&plan.books.cases.book, &plan.episodes, &finished)?;
    let missing = remaining.missing.len();
    let prompts = folder.dir().join(PROMPTS_FOLDER);
    if settings.log_prompts {
        let logged = prompts.exists().then_some(&*prompts);
        let note = prompt_log_note(finished.len(), missing, logged);
        note.iter().for_each(|note| progress.note(note));
    }
    if missing == 0 {
        // A killed run may have finished all episodes: remove what it left, as was done before memories were started.
        if started.is_none() {
            registry::clean(&registry::default_base())?;
        }
        return Ok(RunOutcome::NothingMissing);
    }
    let prices = folder.manifest().prices.as_ref();
    let mut budget = Budget::new(settings.model.as_ref(), prices, &requests);
    budget.count(&folder.manifest().built_usage());
    if let Some(why) = budget.exceeded() {
        return Ok(RunOutcome::Ended(Ending { halted: Some(why), ..Ending::default() }));
    }
    let successes = finished.iter().filter(|record| record.is_success()).count();
    let total = finished.len() + missing;
    if !finished.is_empty() && invocation.verbosity == Verbosity::Progress {
        let (out, done) = (settings.out.display(), finished.len());
        progress.note(&format!("resuming {out}: {done} of {total} episodes are finished"));
    }
    let counts = EpisodeCounts {
        planned: total as u64,
        earlier: (finished.len() as u64, successes as u64),
        ..EpisodeCounts::default()
    };
    let mut processes =
        RunProcesses::prepare(&plan, started, remaining, invocation, &mut progress)?;
    let attach = &mut processes.attach;
    if settings.log_prompts {
        // Absolute: an external policy may have another working folder.
        attach.prompts = Some(std::path::absolute(session_folder(&prompts, folder.session()))?);
    }
    let trace = invocation.trace.as_deref().map(RunTrace::create).transpose()?;
    attach.spans = trace.as_ref().map(|trace| trace.spans().to_owned());
    if settings.warm_views {
        let views = plan.books.cases.book.world.views;
        progress.note(&format!("rendering {views} views before the first step"));
    }
    let policy = folder.manifest().policy_label();
    let monitor = Monitor::new(folder.dir(), policy, attach.lanes, counts, progress);
    let size = (attach.lanes, attach.frame_capacity);
    let mut session = RunSession::new(&mut folder, monitor, budget, trace, size);
    let outcome = processes.run(invocation.stop, &mut session);
    session.end(&outcome, &end_reason(&outcome, (invocation.stop_reason)()))?;
    Ok(RunOutcome::Ended(outcome?))
}

/// Checks that the folder of `plan` has episodes of this run only.
fn check_resumable(plan: &RunPlan, manifest: &Manifest) -> Result<()> {
    let log = RunLog::read(&plan.settings.out)?;
    // Other settings often select other episodes, too: report the cause first.
    let differences = manifest.differences(&log.manifest);
    if !differences.is_empty() {
        return Err(LogError::OtherSettings { dir: log.dir, differences }.into());
    }
    Ok(log.check_planned(&plan.keys())?)
}

/// Why a session ended, as its record says it. `stop_reason` is what asked it to stop, if something did.
fn end_reason(outcome: &Result<Ending>, stop_reason: Option<&str>) -> String {
    match (outcome, stop_reason) {
        (Err(error), _) => format!("{error:#}"),
        (Ok(_), Some(reason)) => reason.to_owned(),
        (Ok(Ending { halted: Some(why), .. }), None) => why.clone(),
        (Ok(_), None) => "complete".to_owned(),
    }
}

/// Executes all episodes of `plan` for measurements: `observer` sees them, and no run folder records them. The folder of its
/// settings gets only what the processes read.
///
/// # Errors
/// As [`execute`], apart from those of a run folder.
pub fn observe(
    mut plan: RunPlan,
    invocation: &Invocation<'_>,
    observer: &mut dyn Observer,
) -> Result<RunOutcome> {
    let started = plan.started.take();
    let documents = match plan.documents(invocation, &mut |_| Ok(()))? {
        DocumentSupply::Ready(documents) => documents,
        DocumentSupply::Stopped => return Ok(RunOutcome::Stopped),
        DocumentSupply::OverBudget(why) => return Ok(RunOutcome::OverBudget(why)),
    };
    let out = &plan.settings.out;
    fs::create_dir_all(out)?;
    documents.copy_to(&out.join(DOCUMENTS_FOLDER))?;
    drop(documents);
    plan.write(out)?;
    let remaining = Remaining::of(&plan.books.cases.book, &plan.episodes, &[])?;
    let mut progress = ProgressDisplay::new(invocation.verbosity);
    let processes = RunProcesses::prepare(&plan, started, remaining, invocation, &mut progress)?;
    Ok(RunOutcome::Ended(processes.run(invocation.stop, observer)?))
}

/// The processes of a run before they are started, and the episodes that they are for.
struct RunProcesses<'a> {
    lanes: Lanes<'a>,
    episodes: Vec<PlannedEpisode>,
    attach: Attach,
    options: PipelineOptions,
    started: StartedMemories,
}

impl<'a> RunProcesses<'a> {
    fn prepare(
        plan: &'a RunPlan,
        started: Option<StartedMemories>,
        remaining: Remaining,
        invocation: &Invocation<'_>,
        progress: &mut ProgressDisplay,
    ) -> Result<Self> {
        let RunPlan { settings, books, unit, shipped_embeddings, .. } = plan;
        let Remaining { missing, learned } = remaining;
        let none = || StartedMemories::none(&mut |note| progress.note(note));
        let started = started.map_or_else(none, Ok)?;
        let memories = &started.memories;
        let mut attach = launch::attach(settings, books, &missing, &started)?;
        let logs = settings.out.join(LOGS_FOLDER);
        let mut options = launch::pipeline_options(settings, memories, logs)?;
        if unit.is_some() {
            launch::share_views(&mut options, &cache_folder()?.join("views"));
        }
        if let Some(file) = shipped_embeddings {
            launch::ship_embeddings(&mut options, file);
        }
        if settings.model.is_some() {
            (invocation.before_asking)(settings)?;
            let source = invocation.base_url_from.iter();
            source.for_each(|source| launch::tell_source_of_base_url(&mut options, source));
        }
        (invocation.adjust)(settings, &mut attach, &mut options)?;
        let rules = launch::rules(settings, memories)?;
        let mut lanes = Lanes::new(books, rules, attach.lanes as usize);
        for (sequence, position, experience) in learned {
            lanes.remember(sequence, position, experience);
        }
        Ok(Self { lanes, episodes: missing, attach, options, started })
    }

    /// Starts the processes, runs the episodes and ends the processes.
    fn run(self, stop: &AtomicBool, observer: &mut dyn Observer) -> Result<Ending> {
        let Self { mut lanes, episodes, attach, options, started } = self;
        // The run's folder is removed after the processes have ended.
        let StartedMemories { children, run: _run, .. } = started;
        pipeline::run_episodes(&mut lanes, episodes, &attach, &options, children, stop, observer)
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
}
