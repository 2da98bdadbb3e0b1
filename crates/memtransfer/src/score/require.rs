//! `memtransfer score --require`: gates, for scripts and CI.

use std::path::PathBuf;

use clap::Args;
use run_log::RunLog;
use scores::Scores;
use scores::gate::{Gate, GateError, GateResult, no_worse_than};

#[derive(Debug, Args)]
pub(super) struct RequireArgs {
    /// Require this of a figure: 'CONDITION: FIGURE OPERATOR NUMBER', where the figure is sr, spl, follow, recovery, change or
    /// retention, and the operator >=, <=, > or <. Can be given several times
    #[arg(long, value_name = "GATE", conflicts_with_all = ["compare", "other"])]
    require: Vec<Gate>,
    /// Require of every condition of RUN2 that its success rate is not lower here, on the same cases and repetitions
    #[arg(long, value_name = "RUN2", conflicts_with_all = ["compare", "other"])]
    require_no_worse_than: Option<PathBuf>,
    /// How many percentage points lower is not worse
    #[arg(long, value_name = "POINTS", default_value = "5", allow_negative_numbers = true, requires = "require_no_worse_than", value_parser = points)]
    margin: f64,
}

/// Reads a number of percentage points.
fn points(text: &str) -> Result<f64, String> {
    let points = text.parse::<f64>().ok().filter(|points| (0.0..=100.0).contains(points));
    points.ok_or_else(|| "expected percentage points from 0 to 100".to_owned())
}

impl RequireArgs {
    /// Reads the run that this one has to be no worse than, if there is one.
    pub(super) fn base(&self) -> anyhow::Result<Option<RunLog>> {
        Ok(self.require_no_worse_than.as_deref().map(RunLog::read).transpose()?)
    }

    /// Decides the gates for the run `log`, of which `base` is the run of [`base`](Self::base).
    pub(super) fn check(
        &self,
        (log, scores): (&RunLog, &Scores),
        base: Option<&RunLog>,
    ) -> Result<Vec<GateResult>, GateError> {
        let gates = self.require.iter().cloned();
        let mut results =
            gates.map(|gate| gate.check(log, scores)).collect::<Result<Vec<_>, _>>()?;
        if let Some(base) = base {
            let base = (base, &scores::score(base));
            results.extend(no_worse_than((log, scores), base, self.margin)?);
        }
        Ok(results)
    }
}
