//! A script that executes the units of a plan on a cluster.
//!
//! Worker `i` of `n` executes the units i, i + n, i + 2n, ...: a cluster limits the length of an array, and a plan does not
//! limit its units.

use std::path::Path;

use anyhow::{Context, Result};
use conditions::settings::RunSettings;
use llm::Source;

use crate::commands::ALLOW;

/// The flags of `work` in a script: what the user who makes it has given on the command line, or allowed, and what a worker would
/// not take from the plan alone. Each begins with a space.
pub(super) fn work_flags(settings: &RunSettings, base_url_source: Source) -> Result<String> {
    let mut flags = String::new();
    if !settings::commands(settings)?.is_empty() {
        flags += &format!(" {ALLOW}");
    }
    let base_url = settings.model.as_ref().and_then(|model| model.base_url.as_ref());
    if let Some(url) = base_url.filter(|_| base_url_source == Source::CommandLine) {
        let url = shlex::try_quote(url).context("--base-url has a zero byte")?;
        flags += &format!(" --base-url {url}");
    }
    Ok(flags)
}

/// An array script for `sbatch`: the workers, then the merge. Needs the plan, the programs and the current folder on every node.
pub(super) fn slurm(plan: &Path, units: u32, workers: u32, flags: &str) -> Result<String> {
    let plan = plan.to_str().context("the path of the plan is not UTF-8")?;
    let plan = shlex::try_quote(plan).context("the path of the plan has a zero byte")?;
    let last = workers - 1;
    Ok(format!(
        r#"#!/bin/bash
# Executes the {units} units of a plan, and merges them:
#   job=$(sbatch --parsable FILE) && sbatch --array=0 --dependency=afterany:$job FILE merge
#SBATCH --job-name=memtransfer
#SBATCH --array=0-{last}
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
set -u

plan={plan}
units=${{MEMTRANSFER_UNITS:-units}}

if [ "${{1-}}" = merge ]; then
    exec memtransfer merge --plan "$plan" "$units" --out "${{MEMTRANSFER_MERGED:-merged}}"
fi

failed=0
for ((unit = SLURM_ARRAY_TASK_ID; unit < {units}; unit += {workers})); do
    # What is finished is left as it is, also after a requeue.
    memtransfer work --plan "$plan" --unit "$unit" --out "$units" --quiet{flags} || failed=1
done
exit "$failed"
"#
    ))
}
