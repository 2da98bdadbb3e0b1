"""Loses nodes of a Ray cluster during a run: python ray_cluster.py OUT PROGRAM SETTINGS...

Three raylets on this machine execute `python -m memtransfer.ray run`. Two of them are killed, and one is added. Ray's files
go to TMPDIR, whose path is short. The variable RAY_RUN_TIMEOUT_S sets how long the run may take, 240 seconds without it.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from ray.cluster_utils import Cluster

OBJECTS = 80 << 20
"""Bytes of a node's object store, about the least that Ray accepts."""


def finished(units: Path) -> int:
    return sum(1 for unit in units.glob("unit-*") if unit.suffix == "")


def wait_for(units: Path, count: int, run: "subprocess.Popen[bytes]") -> None:
    while finished(units) < count and run.poll() is None:
        time.sleep(0.02)


def main(out: str, program: str, *settings: str) -> int:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    head = {"num_cpus": 0, "object_store_memory": OBJECTS, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    nodes = [cluster.add_node(num_cpus=1, object_store_memory=OBJECTS, wait=False) for _ in range(3)]
    cluster.wait_for_nodes()
    command = [sys.executable, "-m", "memtransfer.ray", "run", "--address", cluster.address, "--program", program]
    command += ["--out", out, "--cpus", "1", "--unit-episodes", "4", *settings]
    run = subprocess.Popen(command)
    units = Path(f"{out}.units")
    for node, count in zip(nodes[:2], [2, 4]):
        wait_for(units, count, run)
        assert run.poll() is None, "the run ended before its nodes were killed"
        os.kill(node.all_processes["raylet"][0].process.pid, signal.SIGKILL)
        print(f"killed a node after {finished(units)} units", flush=True)
    cluster.add_node(num_cpus=1, object_store_memory=OBJECTS, wait=False)
    status = run.wait(timeout=float(os.environ.get("RAY_RUN_TIMEOUT_S", "240")))
    cluster.shutdown()
    return status


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
