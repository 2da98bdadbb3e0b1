//! Scripts that execute the units of a plan on a cluster.
//!
//! Worker `i` of `n` executes the units i, i + n, i + 2n, ...: a cluster limits the length of an array, and a plan does not
//! limit its units.

use std::path::Path;

use anyhow::{Context, Result};
use llm::Source;
use results::settings::RunSettings;

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

/// An indexed Job for `kubectl apply`. Needs a volume claim `memtransfer` that holds `plan.json`.
pub(super) fn kubernetes(image: &str, units: u32, workers: u32, flags: &str) -> String {
    format!(
        r#"# Executes the {units} units of /work/plan.json on the volume claim "memtransfer", which all workers share.
# Then: memtransfer merge --plan plan.json units --out RUN
apiVersion: batch/v1
kind: Job
metadata:
  name: memtransfer
spec:
  completionMode: Indexed
  completions: {workers}
  parallelism: {workers}
  backoffLimitPerIndex: 20
  podReplacementPolicy: Failed
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: worker
          image: {image}
          command:
            - /bin/bash
            - -c
            - |
              failed=0
              for ((unit = JOB_COMPLETION_INDEX; unit < {units}; unit += {workers})); do
                memtransfer work --plan /work/plan.json --unit "$unit" --out /work/units --quiet{flags} || failed=1
              done
              exit "$failed"
          resources:
            requests:
              cpu: "4"
              memory: 8Gi
            limits:
              memory: 8Gi
          volumeMounts:
            - name: work
              mountPath: /work
            - name: shared-memory
              mountPath: /dev/shm
      volumes:
        - name: work
          persistentVolumeClaim:
            claimName: memtransfer
        - name: shared-memory
          emptyDir:
            medium: Memory
            sizeLimit: 4Gi
"#
    )
}
