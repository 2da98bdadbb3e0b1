//! `memtransfer conformance`: checks an external policy, an external memory or a world.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use conformance::{CheckFinding, CheckVerdict, CheckedRole, Conformance};
use serde::Serialize;

use super::{Exit, print, print_json};
use crate::signals::Signals;

/// The variable that `--policy-cmd` stands for.
const POLICY_VARIABLE: &str = "MEMTRANSFER_POLICY_CMD";

#[derive(Debug, Args)]
#[command(after_help = "\
The command is started as `memtransfer run` does with --policy-cmd, --memory-cmd or --world-cmd:
with a folder in MEMTRANSFER_ATTACH; a world with the verbs `book`, `serve` and `act`. The other
processes are scripted; the quality of decisions, of what a memory supplies and of tasks is not
checked.

Exit status: 0 all checks passed, 1 a check failed, 2 the command cannot be started.

Examples:
  memtransfer conformance --policy-cmd 'python my_policy.py'
  memtransfer conformance --policy-cmd ./target/release/my-policy --strict --json
  memtransfer conformance --memory-cmd 'python my_memory.py'
  memtransfer conformance --world-cmd ./target/release/my-world")]
pub(super) struct ConformanceArgs {
    /// The command that starts your policy
    #[arg(long, value_name = "COMMAND", env = POLICY_VARIABLE)]
    policy_cmd: Option<String>,

    /// The command that starts your memory, to check a memory instead of a policy
    #[arg(long, value_name = "COMMAND")]
    memory_cmd: Option<String>,

    /// The command that starts your world, to check a world instead of a policy
    #[arg(long, value_name = "COMMAND")]
    world_cmd: Option<String>,

    /// Seconds that an answer may take; the end of the process may take as long, but at most 10
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    step_timeout: u32,

    /// Seconds that the process may take to get ready, a memory to build itself from a bank, and a world to write its
    /// case book
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    start_timeout: u32,

    /// Count warnings as failures
    #[arg(long)]
    strict: bool,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    command: BTreeMap<&'static str, &'a str>,
    conforms: bool,
    checks: &'a [CheckFinding],
}

pub(super) fn run(args: &ConformanceArgs) -> Result<Exit> {
    let signals = Signals::listen().context("cannot listen to signals")?;
    let (role, flag, command) = checked(args)?;
    let conformance = Conformance {
        role,
        command: command.clone(),
        answer_timeout: Duration::from_secs(args.step_timeout.into()),
        start_timeout: Duration::from_secs(args.start_timeout.into()),
        strict: args.strict,
    };
    let mut printed = Ok(());
    let findings = conformance.check(signals.stop(), &mut |finding| {
        if !args.json && printed.is_ok() {
            printed = print(&line(finding));
        }
    });
    if let Some(signal) = signals.received() {
        return Ok(Exit::Signal(signal));
    }
    let findings = findings?;
    printed?;
    let count = |verdict| findings.iter().filter(|finding| finding.verdict == verdict).count();
    let conforms = count(CheckVerdict::Failed) == 0;
    if args.json {
        let command = BTreeMap::from([(flag, command.as_str())]);
        print_json(&Report { command, conforms, checks: &findings })?;
    } else {
        let counts = [
            (CheckVerdict::Passed, "passed"),
            (CheckVerdict::Warning, "passed with a warning"),
            (CheckVerdict::Failed, "failed"),
            (CheckVerdict::Skipped, "skipped"),
        ];
        let counts = counts.map(|(verdict, word)| (count(verdict), word));
        let counts: Vec<String> = counts
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, word)| format!("{count} {word}"))
            .collect();
        print(&format!("\n{} checks: {}", findings.len(), counts.join(", ")))?;
    }
    Ok(if conforms { Exit::Complete } else { Exit::Failed })
}

/// What is checked: its role, the flag that names it and its command. A policy that is named by its variable alone gives way.
fn checked(args: &ConformanceArgs) -> Result<(CheckedRole, &'static str, &String)> {
    let named = [
        (CheckedRole::Policy, "policy_cmd", &args.policy_cmd),
        (CheckedRole::Memory, "memory_cmd", &args.memory_cmd),
        (CheckedRole::World, "world_cmd", &args.world_cmd),
    ];
    let mut given: Vec<_> =
        named.into_iter().filter_map(|(role, flag, of)| Some((role, flag, of.as_ref()?))).collect();
    if given.len() > 1 && std::env::var(POLICY_VARIABLE).ok() == args.policy_cmd {
        given.retain(|(role, ..)| *role != CheckedRole::Policy);
    }
    match given[..] {
        [one] => Ok(one),
        [] => anyhow::bail!(
            "there is nothing to check: give --policy-cmd, --memory-cmd or --world-cmd"
        ),
        _ => anyhow::bail!(
            "one program is checked at a time: give --policy-cmd, --memory-cmd or --world-cmd"
        ),
    }
}

/// A finding in a line, or in a paragraph where something is to be done.
fn line(finding: &CheckFinding) -> String {
    let CheckFinding { name, verdict, expected, happened, advice, printed } = finding;
    let (word, explains) = match verdict {
        CheckVerdict::Passed => ("ok  ", false),
        CheckVerdict::Warning => ("WARN", true),
        CheckVerdict::Failed => ("FAIL", true),
        CheckVerdict::Skipped => ("-   ", false),
    };
    if explains {
        let indented = |text: &str| text.replace('\n', "\n               ");
        let happened = indented(happened);
        let printed = match printed.as_str() {
            "" => String::new(),
            lines => format!("\n     printed   {}", indented(lines)),
        };
        return format!(
            "{word} {name}\n     expected  {expected}\n     happened  {happened}{printed}\n     to do     {advice}"
        );
    }
    format!("{word} {name:<36} {happened}").trim_end().to_owned()
}
