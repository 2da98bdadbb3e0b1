//! What the verbs `run`, `plan` and `work` share: how the orchestrator is called, and what is printed when it stops early.

use std::cell::Cell;
use std::ffi::OsString;
use std::io;
use std::path::Path;

use anyhow::{Error, Result, anyhow};
use conditions::settings::{Group, ModelSettings, RunSettings};
use conditions::{Demonstrations, Route, Start};
use domain::{SecretHeader, cache_folder, shell_word};
use llm::{Servers, Source};
use orchestrator::invocation::Invocation;
use orchestrator::progress::Verbosity;
use orchestrator::run::{self, RunOutcome};
use orchestrator::run_plan::RunPlan;
use rustix::io::Errno;

use super::doctor::endpoint::copy_reports;
use super::run::flags::RunOptions;
use super::{Exit, in_one_line};
use crate::signals::{self, Signals};

/// What a signal can interrupt before the first episode.
pub(super) const STARTING_MEMORIES: &str = "external memories were being started";
pub(super) const BUILDING_DOCUMENTS: &str = "documents were being built";
pub(super) const FILLING_STORE: &str = "the store was being filled";

/// The invocation that `options` describe, which a signal stops.
pub(super) fn invocation<'a>(options: &'a RunOptions, signals: &'a Signals) -> Invocation<'a> {
    let RunOptions { fresh, quiet, trace, base_url_source, header_source, .. } = options;
    let servers = move |model: &ModelSettings| {
        let given = model.base_url.as_deref().map(|url| (url, *base_url_source));
        let of_file = *header_source == Source::SettingsFile;
        let servers = Servers::from_environment(given, Path::new("."))?;
        Ok::<_, Error>(servers.with_headers(&model.header, of_file)?)
    };
    let is_announced = Cell::new(*quiet);
    Invocation {
        fresh: *fresh,
        verbosity: Verbosity::of_quiet(*quiet),
        trace: trace.clone(),
        stop_reason: Box::new(|| signals.received().map(signals::name)),
        base_url_from: Some(base_url_source.word()),
        before_asking: Box::new(move |settings| {
            let Some(model) = &settings.model else { return Ok(()) };
            let servers = servers(model)?;
            // A run that has documents written asks twice.
            if !is_announced.replace(true) {
                say!("asking {} at {servers}", model.model);
            }
            Ok(())
        }),
        adjust: Box::new(move |settings, _, _| {
            let Some(model) = &settings.model else { return Ok(()) };
            copy_reports(&cache_folder()?, &model.model, &servers(model)?, &settings.out)
        }),
        ..Invocation::until(signals.stop())
    }
}

/// Executes what is missing of a run. An error that a full disk causes says what to do about it.
pub(super) fn execute(plan: RunPlan, invocation: &Invocation<'_>) -> Result<RunOutcome> {
    run::execute(plan, invocation).map_err(|error| match is_disk_full(&error) {
        false => error,
        true => anyhow!(
            "{}\nThe disk is full. Finished episodes are kept: free some space, then give the same command \
             again:\n  {}",
            in_one_line(&error),
            same_command()
        ),
    })
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

/// Reports requested combinations that do not exist.
pub(super) fn note_omissions(settings: &RunSettings) {
    let groups = &settings.groups;
    let blocked_original = |group: &Group| {
        group.routes.contains(&Route::Blocked) && group.starts.contains(&Start::Original)
    };
    if groups.iter().any(blocked_original) {
        say!("blocked routes exist for the new start only: left out for the original start");
    }
    let without_demonstrations = |group: &Group| {
        group.demos.contains(&Demonstrations::NONE)
            && group.memory.iter().any(|memory| memory.uses_demonstrations())
    };
    if groups.iter().any(without_demonstrations) {
        say!("memories of demonstrations need some: left out with `--demos none`");
    }
}

/// Reports that documents take more than the run may spend.
pub(super) fn over_budget(why: &str) -> Exit {
    say!(
        "stopped before the first episode: {why}\nDocuments that are complete are kept. To resume:\n  {}",
        same_command()
    );
    Exit::Failed
}

/// Reports that a signal came before the first episode, while something else was being done.
pub(super) fn stopped_before_episodes(signals: &Signals, meanwhile: &str) -> Exit {
    let signal = signals.received().unwrap_or_default();
    say!(
        "stopped by {} while {meanwhile}, before the first episode. Documents that were complete are kept, and so are \
         replies for the others. To resume:\n  {}",
        signals::name(signal),
        same_command()
    );
    Exit::Signal(signal)
}

/// The command line that resumes the run: without `--fresh`, which would start over, and without the process that this one ends with.
pub(super) fn same_command() -> String {
    let arguments = without_own_flags(std::env::args_os());
    let mut is_header = false;
    let shown = |argument: OsString| {
        let text = argument.to_string_lossy().into_owned();
        let header = if is_header { Some(&*text) } else { text.strip_prefix("--header=") };
        let prefix = if is_header { "" } else { "--header=" };
        let masked = header.map(|header| match header.parse::<SecretHeader>() {
            Ok(header) => format!("{prefix}{header}"),
            Err(_) => format!("{prefix}..."),
        });
        is_header = text == "--header";
        masked.map_or(argument, OsString::from)
    };
    arguments.map(shown).map(shell_word).collect::<Vec<_>>().join(" ")
}

/// The arguments without those that are for this invocation alone.
fn without_own_flags(arguments: impl Iterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    let mut is_pid = false;
    arguments.filter(move |argument| {
        let is_value = std::mem::replace(&mut is_pid, argument == "--die-with");
        let text = argument.to_string_lossy();
        let is_own = ["--fresh", "--discard", "--die-with"].contains(&&*text);
        !(is_value || is_own || text.starts_with("--die-with="))
    })
}

#[cfg(test)]
mod tests {
    use run_log::LogError;

    use super::*;

    #[test]
    fn the_same_command_does_not_name_a_process_that_has_ended() {
        let given =
            "memtransfer run --die-with 17 --fresh --limit 5 --die-with=17 --discard --out x";
        let kept = without_own_flags(given.split(' ').map(OsString::from));
        let kept: Vec<_> = kept.map(|word| word.into_string().unwrap()).collect();
        assert_eq!(kept.join(" "), "memtransfer run --limit 5 --out x");
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
