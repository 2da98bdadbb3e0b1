"""A run on the machines of a Ray cluster.

    python -m memtransfer.ray run --suite paper --policy grounded --address auto --out runs/paper

Every node needs the programs and the cache folder of `cargo xtask setup`, and Ray; this package is needed only where the
command is given. The plan and the finished units travel through Ray, so no folder is shared. A unit whose node is lost is
executed again on another one. The same command again goes on after an interruption. The guide is `docs/machines.md` of the
project.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import io
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from memtransfer._extras import missing

try:
    import ray
except ModuleNotFoundError as error:
    raise missing(error, "ray") from None

_ERROR_LINES = 20
"""The last lines of a worker's messages that an error shows."""


def _unit_name(unit: int) -> str:
    return f"unit-{unit:06}"


def _work(plan: bytes, unit: int, program: str, flags: Sequence[str]) -> bytes:
    """Executes a unit on this node. Returns its folder as a compressed archive.

    Its folder stays on the node until it is finished, so that another attempt on this node goes on from there.
    """
    digest = hashlib.sha256(plan).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"memtransfer-ray-{os.getuid()}-{digest}-{unit}"
    folder.mkdir(mode=0o700, exist_ok=True)
    # An attempt before, whose worker was lost, may still be stopping: its program holds the lock.
    lock = os.open(folder, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    file = folder / "plan.json"
    if not file.exists():
        draft = folder / f"plan.json.{os.getpid()}"
        draft.write_bytes(plan)
        draft.rename(file)
    # It ends with this process, which Ray ends with the node or the run. Ray kills the children and the process group of such a process,
    # and would leave it no time to remove what it has in shared memory: so it is the child of a child, in a session of its own.
    command = ["sh", "-c", '"$@"; exit $?', "sh", program, "work", "--plan", str(file), "--unit", str(unit), "--out", str(folder)]
    command += ["--quiet", "--die-with", str(os.getpid()), *flags]
    child = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        pass_fds=[lock],
    )
    _, errors = child.communicate()
    os.close(lock)
    if child.returncode != 0:
        messages = "\n".join(errors.splitlines()[-_ERROR_LINES:])
        raise RuntimeError(f"unit {unit} on {os.uname().nodename}: exit status {child.returncode}\n{messages}")
    whole = folder / _unit_name(unit)
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w:gz", compresslevel=1) as files:
        files.add(whole, arcname=whole.name)
    shutil.rmtree(folder)
    return archive.getvalue()


def _store(archive: bytes, unit: int, units: Path) -> None:
    """Writes the folder of a unit, all of it or nothing."""
    draft = units / f"{_unit_name(unit)}.draft"
    shutil.rmtree(draft, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(archive), mode="r:gz") as files:
        files.extractall(draft, filter="data")
    for path in draft.rglob("*"):
        descriptor = os.open(path, os.O_RDONLY)
        os.fsync(descriptor)
        os.close(descriptor)
    (draft / _unit_name(unit)).rename(units / _unit_name(unit))
    draft.rmdir()


def _make_plan(program: str, settings: Sequence[str], units: Path) -> Path:
    """The plan of these settings, in the folder of its units; `plan` keeps what is there already, and refuses another."""
    plan = units / "plan.json"
    _call([program, "plan", *settings, "--out", str(plan)])
    return plan


def _call(command: Sequence[str]) -> None:
    """Runs a command, which an interrupt stops.

    Raises:
        subprocess.CalledProcessError: Its exit status is not 0.
    """
    with subprocess.Popen(command) as child:
        try:
            status = child.wait()
        except KeyboardInterrupt:
            # `subprocess.run` would kill it.
            child.send_signal(signal.SIGINT)
            child.wait()
            raise
    if status != 0:
        raise subprocess.CalledProcessError(status, command)


def _flags_of_units(settings: Sequence[str], work: Sequence[str]) -> list[str]:
    """The flags of `memtransfer work`: a worker takes commands, and the address that a key is sent to, from no plan alone. These
    settings are given here, on the command line."""
    flags = ["--allow-commands"]
    name = "--base-url"
    if not any(flag == name or flag.startswith(f"{name}=") for flag in work):
        for flag, value in zip(settings, [*settings[1:], ""], strict=False):
            if flag == name:
                flags = [*flags, name, value]
            elif flag.startswith(f"{name}="):
                flags = [*flags, flag]
    return [*flags, *work]


class _Progress:
    """A line about all nodes on stderr, at most one a second."""

    def __init__(self, total: int, done: int) -> None:
        self.total, self.done, self.began_with = total, done, done
        self.began = self.shown = time.monotonic()
        self.explained: float | None = None
        """The cores of the largest node, as last seen."""

    def show(self, running: int, cpus: float) -> None:
        now = time.monotonic()
        if now - self.shown < 1 and self.done < self.total:
            return
        self.shown = now
        nodes = [node["Resources"].get("CPU", 0.0) for node in ray.nodes() if node["Alive"]]
        largest = max(nodes, default=0.0)
        # A larger node may come later.
        if largest < cpus and largest != self.explained:
            message = f"no node has the {cpus:g} cores of a unit (--cpus), the largest has {largest:g}: waiting for a larger one"
            print(message, file=sys.stderr)
        self.explained = largest
        rate = (self.done - self.began_with) / max(now - self.began, 1e-9)
        left = f", {(self.total - self.done) / rate / 60:.0f} min left" if rate else ""
        line = f"{self.done} of {self.total} units, {len(nodes)} nodes, {running} queued or running{left}"
        end = "\r" if sys.stderr.isatty() else "\n"
        print(f"{line}   " if end == "\r" else line, end=end, file=sys.stderr, flush=True)


def _execute(arguments: argparse.Namespace, plan: Path, units: Path) -> list[str]:
    """Executes the units that are missing. Returns the messages of those that failed."""
    count = json.loads(plan.read_bytes())["units"]
    waiting = [unit for unit in range(count) if not (units / _unit_name(unit)).is_dir()]
    progress = _Progress(count, count - len(waiting))
    waiting.reverse()
    content = ray.put(plan.read_bytes())
    work: Any = ray.remote(_work).options(num_cpus=arguments.cpus, max_retries=arguments.retries)
    running: dict[Any, int] = {}
    failed = []
    while waiting or running:
        # Few at a time: finished units do not wait in the object store, and nodes may come and go.
        room = 2 + 2 * int(ray.cluster_resources().get("CPU", 0) / arguments.cpus)
        while waiting and len(running) < room:
            unit = waiting.pop()
            running[work.remote(content, unit, arguments.program, arguments.flags)] = unit
        finished, _ = ray.wait(list(running), num_returns=1, timeout=1)
        for one in finished:
            unit = running.pop(one)
            try:
                _store(ray.get(one), unit, units)
                progress.done += 1
            except ray.exceptions.RayError as error:
                failed.append(str(error))
        progress.show(len(running), arguments.cpus)
    return failed


def _cores(text: str) -> float:
    """A number of cores as Ray takes it."""
    cores = float(text)
    if not (0 < cores < 1 or (cores >= 1 and cores.is_integer())):
        raise argparse.ArgumentTypeError(f"{text} is neither a whole number from 1 nor a fraction of a core")
    return cores


def main(given: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit status: 0 merged, 1 units failed, 2 error, 130 interrupted."""
    parser = argparse.ArgumentParser(prog="python -m memtransfer.ray", allow_abbrev=False)
    verbs = parser.add_subparsers(required=True)
    run = verbs.add_parser(
        "run",
        allow_abbrev=False,
        help="execute a run on a Ray cluster",
        epilog="All other flags are settings, as of `memtransfer run`.",
    )
    run.add_argument("--address", default="auto", help="the cluster's address [default: auto]")
    run.add_argument("--out", type=Path, required=True, help="the run folder to make; units lie in OUT.units")
    run.add_argument("--unit-episodes", default="500", help="episodes of a unit [default: 500]")
    run.add_argument("--cpus", type=_cores, default=2.0, help="cores that Ray reserves for a unit [default: 2]")
    run.add_argument("--retries", type=int, default=20, help="losses of nodes that a unit survives [default: 20]")
    run.add_argument("--program", default="memtransfer", help="the program on every node [default: memtransfer]")
    run.add_argument("--work", default="", help="flags for `memtransfer work`, for example '--lanes 32'")
    run.add_argument("--strict", action="store_true", help="as of `memtransfer merge`")
    arguments, settings = parser.parse_known_args(given)
    try:
        arguments.flags = _flags_of_units(settings, shlex.split(arguments.work))
    except ValueError as error:
        parser.error(f"--work: {error}")
    try:
        return _run(arguments, settings)
    except KeyboardInterrupt:
        # What the progress has drawn is not erased.
        print(f"\ninterrupted: finished units are kept in {arguments.out}.units; the same command goes on", file=sys.stderr)
        return 128 + signal.SIGINT


def _run(arguments: argparse.Namespace, settings: Sequence[str]) -> int:
    """Plans, executes the units, and merges them. Returns the exit status."""
    units = Path(f"{arguments.out}.units")
    settings = [*settings, "--unit-episodes", arguments.unit_episodes]
    try:
        plan = _make_plan(arguments.program, settings, units)
    except subprocess.CalledProcessError as error:
        # It has said why.
        return int(error.returncode)
    except OSError as error:
        print(f"cannot start {arguments.program}: {error.strerror}", file=sys.stderr)
        print("Give the path of the program `memtransfer` with --program.", file=sys.stderr)
        return 2
    try:
        ray.init(address=arguments.address, log_to_driver=False, configure_logging=False)
    except ConnectionError as error:
        print(f"cannot join a Ray cluster at {arguments.address}: {error}", file=sys.stderr)
        print("Start one with `ray start --head`, or give its address with --address.", file=sys.stderr)
        return 2
    failed = _execute(arguments, plan, units)
    for message in failed:
        print(message, file=sys.stderr)
    if failed:
        print(f"{len(failed)} units failed; the same command executes them again", file=sys.stderr)
        return 1
    merge = [arguments.program, "merge", "--plan", str(plan), str(units), "--out", str(arguments.out)]
    try:
        _call([*merge, *(["--strict"] if arguments.strict else [])])
    except subprocess.CalledProcessError as error:
        return int(error.returncode)
    return 0


if __name__ == "__main__":
    sys.exit(main())
