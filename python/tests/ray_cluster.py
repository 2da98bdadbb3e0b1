"""Loses nodes of a Ray cluster during a run: python ray_cluster.py OUT PROGRAM SETTINGS...

Three raylets on this machine execute `python -m memtransfer.ray run`. Two of them are killed, and one is added. Before that, runs are
interrupted: one that waits for a larger node, and one that goes on. Ray's files go to TMPDIR, whose path is short.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ray.cluster_utils import Cluster

OBJECTS = 80 << 20
"""Bytes of a node's object store, about the least that Ray accepts."""


# A test in the background may inherit an ignored SIGINT, and the run that it starts with it; a program at a terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)


def finished(units: Path) -> int:
    return sum(1 for unit in units.glob("unit-*") if unit.suffix == "")


def wait_for(units: Path, count: int, run: "subprocess.Popen[bytes]") -> None:
    while finished(units) < count and run.poll() is None:
        time.sleep(0.02)


def interrupt(command: list[str], is_due: Callable[[str], bool]) -> str:
    """Interrupts a run as soon as its messages say so. Returns them."""
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert run.stderr is not None
    said = ""
    while not is_due(said):
        line = run.stderr.readline()
        assert line, said
        said += line
    run.send_signal(signal.SIGINT)
    said += run.communicate()[1]
    assert run.returncode == 130 and "the same command goes on" in said and "Traceback" not in said, said
    return said


def check_interrupts(command: list[str], settings: Sequence[str]) -> None:
    runs = os.environ["MEMTRANSFER_RUN_DIR"]
    waiting = [*command, "--out", "waiting", "--cpus", "64", *settings]
    said = interrupt(waiting, lambda said: "0 of " in said)
    assert "no node has the 64 cores of a unit (--cpus), the largest has 1: waiting for a larger one" in said, said
    interrupt([*command, "--out", "interrupted", "--cpus", "1", *settings], lambda _: bool(os.listdir(runs)))
    while os.listdir(runs):
        time.sleep(0.1)


def main(out: str, program: str, *settings: str) -> int:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    head = {"num_cpus": 0, "object_store_memory": OBJECTS, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    nodes = [cluster.add_node(num_cpus=1, object_store_memory=OBJECTS, wait=False) for _ in range(3)]
    cluster.wait_for_nodes()
    command = [sys.executable, "-m", "memtransfer.ray", "run", "--address", cluster.address, "--program", program]
    command += ["--unit-episodes", "4"]
    check_interrupts(command, settings)
    run = subprocess.Popen([*command, "--out", out, "--cpus", "1", *settings])
    units = Path(f"{out}.units")
    for node, count in zip(nodes[:2], [2, 4]):
        wait_for(units, count, run)
        assert run.poll() is None, "the run ended before its nodes were killed"
        os.kill(node.all_processes["raylet"][0].process.pid, signal.SIGKILL)
        print(f"killed a node after {finished(units)} units", flush=True)
    cluster.add_node(num_cpus=1, object_store_memory=OBJECTS, wait=False)
    status = run.wait()
    cluster.shutdown()
    return status


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
