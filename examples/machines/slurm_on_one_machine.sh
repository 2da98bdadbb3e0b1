#!/bin/bash
# Executes a plan with Slurm on this machine: slurmctld, slurmd and munged with a configuration in a temporary folder. One task
# is requeued while it runs. The merged log has to be that of `memtransfer run`.
#
#     apt-get install slurmctld slurmd slurm-client munge
#     PATH=target/release:$PATH examples/machines/slurm_on_one_machine.sh --suite quick --policy grounded
#
# Needs root. The arguments are settings of the run. Everything listens on 127.0.0.1 and ends with the script.
set -euo pipefail

folder=$(mktemp -d)
export SLURM_CONF=$folder/slurm.conf
host=$(hostname -s)
daemons=()
stop() {
    kill "${daemons[@]}" 2>/dev/null || true
    wait
    rm -rf "$folder"
}
trap stop EXIT

cd "$folder"
mkdir state spool run
dd if=/dev/urandom of=munge.key bs=1024 count=1 status=none
chmod 600 munge.key
cat >slurm.conf <<END
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthInfo=socket=$folder/munge.socket
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/run/slurmctld.pid
SlurmdPidFile=$folder/run/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
SchedulerParameters=sched_interval=1
NodeName=$host NodeAddr=127.0.0.1 CPUs=12 RealMemory=32000
PartitionName=main Nodes=$host Default=YES
END
# The configuration promises more than a small machine has, so that three tasks of four cores run at a time.
echo 'SlurmdParameters=config_overrides' >>slurm.conf

munged --foreground --force --key-file=munge.key --socket=munge.socket --pid-file=run/munged.pid \
    --seed-file=munge.seed --log-file=munged.log --origin=127.0.0.1 2>munged.err &
daemons+=($!)
for _ in {1..100}; do [ -S munge.socket ] && break || sleep 0.1; done
slurmctld -D 2>slurmctld.err &
daemons+=($!)
slurmd -D -N "$host" 2>slurmd.err &
daemons+=($!)
for _ in {1..300}; do sinfo --noheader --format=%t 2>/dev/null | grep -q idle && break || sleep 0.2; done
sinfo

memtransfer run "$@" --lanes 1 --out whole --quiet >/dev/null
memtransfer plan "$@" --out plan.json --unit-episodes 10 --workers 3 --slurm --quiet >run.sbatch
job=$(sbatch --parsable run.sbatch)
merge=$(sbatch --parsable --array=0 --dependency="afterany:$job" run.sbatch merge)

# Once the second task has a unit at work, it starts over.
for _ in {1..600}; do compgen -G 'units/*' >/dev/null && break || sleep 0.1; done
squeue
scontrol requeue "${job}_1"
echo "task ${job}_1 was requeued"
for _ in {1..1200}; do [ -z "$(squeue --noheader --jobs="$merge" 2>/dev/null)" ] && break || sleep 0.5; done
scontrol show job "${job}_1" | grep -o 'JobState=.*\|Restarts=[0-9]*' || true
cat slurm-*.out

cmp merged/episodes.jsonl whole/episodes.jsonl
echo "the merged log is that of one run: $(wc -l <merged/episodes.jsonl) episodes"
