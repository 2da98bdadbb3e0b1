//! `memtransfer score`: a run's table, or comparisons of conditions and runs, from logs alone.

mod require;

use std::path::PathBuf;

use clap::Args;
use require::RequireArgs;
use run_log::policy::PolicyLabel;
use run_log::{Difference, RunLog, tell_apart};
use scores::compare::{LeftOutConditions, differing_settings, pair_conditions, pair_runs};
use scores::gate::{GateResult, Verdict};
use scores::{Comparison, Scores, conclude, score};
use serde::Serialize;

use super::{Exit, print, print_json, warn_of_damage};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads the runs' folders and nothing else; a run in progress can be scored, too.
A comparison is paired: it takes the cases and repetitions that both sides have, prints the figures
of both and their difference, says what is not paired, and names the settings in which two runs
differ. It answers better, worse or no difference shown, with p corrected for all comparisons of the
command, and with the difference that as many cases would show.

With --require or --require-no-worse-than the tables end with a line for each gate. A gate is passed
where the whole 95 % interval of the figure satisfies it, failed where none of the interval does,
and otherwise undecided, which is not passed: too few cases, or episodes are missing. The figure of
--require-no-worse-than is the difference of the success rates on the same cases and repetitions,
and the bound -POINTS: with 100 cases equal runs pass by default, with 50 they do not. Each gate is
decided by itself, at 95 %. docs/gates.md has more.

Exit status: 0 complete, and every gate is passed; 1 episodes are missing, given up or not run yet;
2 error, also for a gate that names no condition of the run; 4 a gate is failed or undecided.

Examples:
  memtransfer score runs/quick-grounded
  memtransfer score runs/quick-grounded --json | jq '.conditions[].sr.mean'
  memtransfer score runs/quick-grounded \\
      --compare episodic/new/unchanged/original working/new/unchanged/none
  memtransfer score runs/quick-grounded runs/quick-random   every condition that both have
  memtransfer score runs/quick-grounded --require 'episodic/new/unchanged/original: sr >= 50'
  memtransfer score runs/new --require-no-worse-than runs/main --margin 10")]
pub(super) struct ScoreArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Compare with this run, condition by condition
    #[arg(value_name = "RUN2")]
    other: Option<PathBuf>,
    /// Compare two conditions (of RUN; the second one of RUN2 where that is given). Can be given several times: p is corrected
    /// for all
    #[arg(long, num_args = 2, value_names = ["CONDITION", "CONDITION"])]
    compare: Option<Vec<String>>,
    #[command(flatten)]
    required: RequireArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ScoreArgs) -> anyhow::Result<Exit> {
    let mut log = RunLog::read(&args.run)?;
    let mut other = args.other.as_deref().map(RunLog::read).transpose()?;
    let mut base = args.required.base()?;
    tell_apart([Some(&mut log), other.as_mut(), base.as_mut()].into_iter().flatten());
    let is_summary = args.compare.is_none() && other.is_none() && !args.json;
    if !is_summary {
        // The summary names them itself.
        warn_of_damage(log.damaged.iter().chain(other.iter().flat_map(|other| &other.damaged)));
    }
    warn_of_damage(base.iter().flat_map(|base| &base.damaged));
    let mut gates = Vec::new();
    match (&args.compare, &other) {
        (None, None) => {
            let scores = score(&log);
            gates = args.required.check((&log, &scores), base.as_ref())?;
            let differing_settings =
                base.as_ref().map(|base| differing_settings(&log, base)).unwrap_or_default();
            let shown = GatedScores { scores: &scores, differing_settings, gates: &gates };
            args.show(&shown, || match gates[..] {
                [] => report::summary(&log),
                _ => format!(
                    "{}\n{}",
                    report::summary(&log),
                    report::gates(&gates, &shown.differing_settings)
                ),
            })?;
        }
        (None, Some(other)) => {
            let paired = pair_runs(&log, other)?;
            args.show_runs(&log, other, &conclude(paired.pairings), &paired.left_out)?;
        }
        (Some(conditions), other) => {
            let second = other.as_ref().unwrap_or(&log);
            let pairing =
                |names: &[String; 2]| pair_conditions((&log, &names[0]), (second, &names[1]));
            let pairs = conditions.as_chunks().0.iter();
            let compared = conclude(pairs.map(pairing).collect::<Result<_, _>>()?);
            match other {
                Some(other) => {
                    args.show_runs(&log, other, &compared, &LeftOutConditions::default())?;
                }
                None => {
                    let policy = log.manifest.policy_label();
                    let labelled = compared.iter().map(|comparison| ComparedConditions {
                        policy: policy.clone(),
                        comparison,
                    });
                    args.show(&labelled.collect::<Vec<_>>(), || {
                        report::comparison(&log, &compared)
                    })?;
                }
            }
        }
    }
    if gates.iter().any(|gate| gate.verdict != Verdict::Passed) {
        return Ok(Exit::NotPassed);
    }
    let are_complete = [Some(&log), other.as_ref()].into_iter().flatten().all(RunLog::is_complete);
    Ok(if are_complete { Exit::Complete } else { Exit::Failed })
}

/// A run's scores and gates, as JSON.
#[derive(Debug, Serialize)]
struct GatedScores<'a> {
    #[serde(flatten)]
    scores: &'a Scores,
    /// Those in which the run differs from the one that it has to be no worse than.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    differing_settings: Vec<Difference>,
    #[serde(skip_serializing_if = "<[GateResult]>::is_empty")]
    gates: &'a [GateResult],
}

/// Two conditions of one run compared, as JSON.
#[derive(Debug, Serialize)]
struct ComparedConditions<'a> {
    policy: PolicyLabel,
    #[serde(flatten)]
    comparison: &'a Comparison,
}

/// Two runs compared, as JSON.
#[derive(Debug, Serialize)]
struct ComparedRuns<'a> {
    /// Of the first run and of the second.
    policies: [PolicyLabel; 2],
    differing_settings: Vec<Difference>,
    comparisons: &'a [Comparison],
    /// The conditions of one run, or without a pair.
    left_out: &'a LeftOutConditions,
}

impl ScoreArgs {
    fn show_runs(
        &self,
        a: &RunLog,
        b: &RunLog,
        comparisons: &[Comparison],
        left_out: &LeftOutConditions,
    ) -> anyhow::Result<()> {
        let policies = [a, b].map(|log| log.manifest.policy_label());
        let differing_settings = differing_settings(a, b);
        let shown = ComparedRuns { policies, differing_settings, comparisons, left_out };
        self.show(&shown, || report::compared_runs(a, b, comparisons, left_out))
    }

    fn show(&self, value: &impl Serialize, text: impl Fn() -> String) -> anyhow::Result<()> {
        if self.json { print_json(value) } else { print(&text()) }
    }
}
