//! `memtransfer run`: settings, plan, run folder, processes, table, in this order.

mod dry_run;
pub(super) mod flags;

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use clap::Args;
use flags::{RunOptions, SettingFlags, source_of};
use orchestrator::run::RunOutcome;
use orchestrator::run_plan::{Purpose, RunPlan, Selected};
use run_log::answers::WithoutAction;
use run_log::{EpisodeError, RunLog};
use settings::{Layer, Resolved, resolve};

use super::execution::{
    BUILDING_DOCUMENTS, STARTING_MEMORIES, execute, invocation, note_omissions, over_budget,
    same_command, stopped_before_episodes,
};
use super::{Exit, commands, print};
use crate::parent::{self, ParentFlags};
use crate::signals::{self, Signals};

#[derive(Debug, Args)]
#[command(after_help = "\
The same command again resumes a run that was stopped or killed: finished episodes stay, the
others run again. Ctrl-C stops cleanly, a second one at once. A run can grow: with a larger --limit
or --runs, more --memory or more --cases, the same folder gets the episodes that are missing.

The settings under \"How it is run\" change no result, except that --backend, --adapter and
--provider may change one slightly.

Precedence: defaults < suite file < MEMTRANSFER_* variables < flags. Every setting is also a
variable (MEMTRANSFER_MAX_STEPS=50), and most are keys of a suite file (max-steps = 50).

Examples:
  memtransfer run                                       the suite `quick` with the policy `grounded`
  memtransfer run --policy random --limit 10            ten cases, one of each task
  memtransfer run --policy expert --starts original,new --routes unchanged,blocked
  memtransfer run --memory episodic --demos original,4  one against four demonstrations
  memtransfer run --memory working,episodic --memory-cmd 'python my_memory.py'  and your own memory
  memtransfer run --suite transfer                      demonstrations of two warehouses
  memtransfer run --suite paper --dry-run               the paper's conditions, counted
  memtransfer run --frames blank --out runs/blank       a control: what remains without pixels?
  memtransfer run --cases t03,t09-01 --dry-run          what would run")]
pub(super) struct RunArgs {
    #[command(flatten)]
    flags: SettingFlags,

    #[command(flatten)]
    options: RunOptions,

    /// Print the resolved settings, each with its source, and stop
    #[arg(long, conflicts_with = "dry_run")]
    show_settings: bool,

    #[command(flatten)]
    parent: ParentFlags,

    /// Remove the run's folder when PID has ended
    #[arg(long, requires = "die_with", help_heading = parent::HEADING)]
    discard: bool,

    /// Run repetition N of --runs alone
    #[arg(long, value_name = "N", help_heading = parent::HEADING)]
    repetition: Option<u32>,
}

impl RunArgs {
    /// The settings, each with its origin.
    pub(super) fn resolve(&self) -> Result<Resolved> {
        let environment = Layer::environment(std::env::vars_os())?;
        resolve([environment, self.flags.layer()?])
    }
}

pub(super) fn run(args: RunArgs) -> Result<Exit> {
    // First, because the end of the parent is a signal: a folder to discard is removed even if it comes at once.
    let signals = Signals::listen().context("cannot listen to signals")?;
    let parent = args.parent.watch()?;
    let resolved = args.resolve()?;
    if args.show_settings {
        print(&resolved.to_string())?;
        return Ok(Exit::Complete);
    }
    let folder = args.discard.then(|| resolved.settings.out.clone());
    let exit = execute_settings(args, resolved, &signals)?;
    // Not after an error: the folder may be that of another run, or no run's.
    if let Some(folder) = folder {
        parent.remove_if_ended(&folder)?;
    }
    Ok(exit)
}

fn execute_settings(args: RunArgs, resolved: Resolved, signals: &Signals) -> Result<Exit> {
    let RunArgs { mut options, repetition, .. } = args;
    options.base_url_source = source_of(resolved.origin("base-url"));
    options.header_source = source_of(resolved.origin("header"));
    let suite = format!("the suite {}", resolved.settings.suite);
    let (purpose, used) = match options.dry_run {
        true => (Purpose::DryRun, commands::Use::Show),
        false => (Purpose::Execution, commands::Use::Start { allowed: options.allow_commands }),
    };
    commands::check(&suite, &resolved.commands_of_suite()?, used)?;
    let invocation = invocation(&options, signals);
    let selected = repetition.map_or(Selected::All, Selected::Repetition);
    let Some(plan) = RunPlan::new(resolved.settings, &selected, purpose, &invocation)? else {
        return Ok(stopped_before_episodes(signals, STARTING_MEMORIES));
    };
    note_omissions(&plan.settings);
    if options.dry_run {
        print(&dry_run::describe(&plan, options.fresh)?)?;
        return Ok(Exit::Complete);
    }
    let out = plan.settings.out.clone();
    let halted = match execute(plan, &invocation)? {
        RunOutcome::Stopped => return Ok(stopped_before_episodes(signals, BUILDING_DOCUMENTS)),
        RunOutcome::OverBudget(why) => return Ok(over_budget(&why)),
        RunOutcome::NothingMissing => None,
        RunOutcome::Ended(ending) => ending.halted,
    };
    conclude(&out, halted, signals)
}

/// Kinds of reasons that are printed.
const SHOWN_REASONS: usize = 3;

/// Why episodes were given up: the most frequent reasons, and how many episodes each has.
pub(super) fn reasons(errors: &[EpisodeError]) -> String {
    let mut counts: BTreeMap<(bool, &str), usize> = BTreeMap::new();
    for error in errors {
        *counts.entry((error.is_final(), &error.error)).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    // First those that say what to do.
    counts.sort_by_key(|&((is_final, _), count)| Reverse((is_final, count)));
    if counts.is_empty() {
        return ".".to_owned();
    }
    let more = counts.len().saturating_sub(SHOWN_REASONS);
    let line = |((_, reason), count): &((bool, &str), usize)| {
        let episodes = if *count == 1 { "episode" } else { "episodes" };
        format!("\n  {count} {episodes}: {reason}")
    };
    let lines: String = counts.iter().take(SHOWN_REASONS).map(line).collect();
    match more {
        0 => format!(":{lines}"),
        _ => format!(":{lines}\n  and {more} other reasons, in errors.jsonl"),
    }
}

/// Prints the table, and what is to be done about episodes that are missing.
fn conclude(out: &Path, halted: Option<String>, signals: &Signals) -> Result<Exit> {
    let log = RunLog::read(out)?;
    let (done, planned) = (log.episodes.len(), log.manifest.episodes as usize);
    if let Some(signal) = signals.received() {
        say!(
            "stopped by {}: {done} of {planned} episodes are finished and kept in {}. To resume:\n  {}",
            signals::name(signal),
            out.display(),
            same_command()
        );
        return Ok(Exit::Signal(signal));
    }
    print(&report::summary(&log))?;
    if let Some(why) = halted {
        say!("stopped: {why}\nFinished episodes are kept. To resume:\n  {}", same_command());
    } else if done < planned {
        let first = match log.errors.iter().any(EpisodeError::is_final) {
            true => {
                "The same command runs no sequence again that cannot go on. Do first what is said above about it. Then, or \
                     for the others:"
            }
            false => "To run them again:",
        };
        say!(
            "{} of {planned} episodes could not be finished, and count neither as success nor as failure{}\n{first}\n  {}",
            planned - done,
            reasons(&log.errors),
            same_command()
        );
    }
    let model = log.manifest.settings.model.as_ref();
    // Who turns the stop off has decided that such a run is one.
    let counts_silence = model.is_some_and(|model| model.stop_without_action == 0);
    let is_silent = WithoutAction::of_run(&log).is_some_and(|silent| silent.is_all());
    if done >= planned && is_silent && !counts_silence {
        say!("no answer of the model has an action, so the run measures nothing");
        return Ok(Exit::Failed);
    }
    Ok(if done >= planned { Exit::Complete } else { Exit::Failed })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_reasons_are_printed_first() {
        let error = |number: u32, error: &str| EpisodeError {
            key: format!("working/new/unchanged/none/run1/t01-{number:02}"),
            session: 1,
            error: error.to_owned(),
        };
        assert_eq!(reasons(&[]), ".");
        let errors: Vec<_> = ["b", "a", "b", "c", "d", "e"].into_iter().zip(1..).collect();
        let errors: Vec<_> = errors.into_iter().map(|(text, number)| error(number, text)).collect();
        assert_eq!(reasons(&errors[..1]), ":\n  1 episode: b");
        assert_eq!(
            reasons(&errors),
            ":\n  2 episodes: b\n  1 episode: a\n  1 episode: c\n  and 2 other reasons, in errors.jsonl"
        );
    }
}
