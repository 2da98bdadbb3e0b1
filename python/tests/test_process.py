"""A policy as a process: what it says, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from peer import WATCHDOG_S, Peer, eventually

from memtransfer import _wire

EXAMPLES = Path(__file__).parent.parent / "examples"

RAISES = """
from memtransfer import _wire
from memtransfer import Policy, run
class Raises(Policy):
    def act(self, batch):
        return batch
run(Raises())
"""


def hears_interrupts() -> None:
    # Whoever starts the tests in the background lets them ignore it, and what they start inherits that.
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(*arguments: str, folder: Path | None) -> subprocess.Popen[str]:
    variables = {name: value for name, value in os.environ.items() if name != "MEMTRANSFER_ATTACH"}
    if folder is not None:
        variables["MEMTRANSFER_ATTACH"] = str(folder)
    variables["PYTHONPATH"] = str(EXAMPLES.parent)
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hears_interrupts,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit status and what was said."""
    try:
        out, err = process.communicate(timeout=WATCHDOG_S)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, out + err


def random_policy(folder: Path | None) -> subprocess.Popen[str]:
    return start(str(EXAMPLES / "random_policy.py"), folder=folder)


def test_without_a_run_it_says_how_to_get_one(tmp_path: Path) -> None:
    status, said = ended(random_policy(None))
    assert status == 2 and said.startswith("memtransfer: MEMTRANSFER_ATTACH is not set")
    assert "memtransfer run --policy-cmd" in said

    status, said = ended(random_policy(tmp_path / "nowhere"))
    assert status == 2 and "there is no run in" in said and "Traceback" not in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"wire_version": 99}, "the run speaks wire version 99 and this package 4: install"),
        ({"lanes": 0}, "lanes is 0, but must be 1 to 4096"),
        ({"prefix": "mt/../"}, "prefix is 'mt/../', but must be"),
        ({"frame": {"width": 70, "height": 1}}, "width is 70, but must be a multiple of 64"),
        ({"wait": None}, "wait is None, but must be an object"),
        ({"crew": ["sim"]}, "the run decides itself"),
        ({"orchestrator_pid": (1 << 31) - 1}, "orchestrator, process 2147483647"),
    ],
)
def test_a_run_that_cannot_be_attached_to(change: dict[str, object], said: str) -> None:
    with Peer() as peer:
        peer.write(**change)
        status, text = ended(random_policy(peer.root))
        assert status == 2 and said in text and "Traceback" not in text, text


def test_it_decides_until_it_is_told_to_stop() -> None:
    with Peer() as peer:
        process = random_policy(peer.root)
        (hello,) = peer.await_(_wire.Hello)
        assert hello.pid == process.pid
        peer.brief(seed=4)
        frame = peer.publish_frame(1)
        actions = []
        for step in range(20):
            peer.step(frame, step=step)
            (decision,) = peer.await_(_wire.Decision)
            actions.append(decision.action)
        assert len(set(actions)) > 3
        peer.stop()
        peer.await_(_wire.Farewell)
        assert ended(process) == (0, "")


def test_it_ends_when_the_run_is_over_and_nobody_said_stop() -> None:
    with Peer() as peer:
        process = random_policy(peer.root)
        peer.await_(_wire.Hello)
        (peer.root / "attach.json").unlink()
        assert ended(process) == (0, "")


def test_only_one_policy_can_take_part() -> None:
    with Peer() as peer:
        first = random_policy(peer.root)
        peer.await_(_wire.Hello)
        status, said = ended(random_policy(peer.root))
        assert status == 2 and "the run has a policy already: only one can take part" in said
        peer.stop()
        assert ended(first) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_quietly(number: signal.Signals) -> None:
    with Peer() as peer:
        process = random_policy(peer.root)
        peer.await_(_wire.Hello)
        process.send_signal(number)
        assert ended(process) == (128 + number, "")


def test_it_ends_with_its_orchestrator() -> None:
    orchestrator = subprocess.Popen(["sleep", "600"])
    try:
        with Peer(orchestrator_pid=orchestrator.pid) as peer:
            process = random_policy(peer.root)
            peer.await_(_wire.Hello)
            orchestrator.kill()
            orchestrator.wait()
            assert ended(process) == (0, "the run's orchestrator is gone\n")
    finally:
        orchestrator.kill()
        orchestrator.wait()


def test_it_is_killed_with_the_process_that_started_it(tmp_path: Path) -> None:
    with Peer() as peer:
        # The starter writes its own number into the run, starts the policy, and waits for ever.
        starter = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "import json, os, subprocess, sys, time\n"
                "path = sys.argv[1] + '/attach.json'\n"
                "values = json.load(open(path))\n"
                "values['orchestrator_pid'] = os.getpid()\n"
                "json.dump(values, open(path, 'w'))\n"
                # A policy that never looks around: only the system can end it.
                "policy = 'from memtransfer import *; import time\\n'"
                "'class Hangs(Policy):\\n'"
                "'    def act(self, batch): time.sleep(600)\\n'"
                "'run(Hangs())'\n"
                "subprocess.Popen([sys.executable, '-c', policy])\n"
                "time.sleep(600)\n",
                str(peer.root),
            ],
            env={
                **os.environ,
                "MEMTRANSFER_ATTACH": str(peer.root),
                "PYTHONPATH": str(EXAMPLES.parent),
            },
        )
        (hello,) = peer.await_(_wire.Hello)
        peer.brief()
        peer.step(peer.publish_frame(1))
        starter.kill()
        starter.wait()

        def is_gone() -> bool:
            try:
                with open(f"/proc/{hello.pid}/stat", encoding="utf-8") as stat:
                    return stat.read().rpartition(")")[2].split()[0] in "ZX"
            except (FileNotFoundError, ProcessLookupError):
                return True

        eventually("the policy's end", is_gone)


def test_a_policy_that_breaks_its_contract_ends_with_a_message() -> None:
    with Peer() as peer:
        process = start("-c", RAISES, folder=peer.root)
        peer.await_(_wire.Hello)
        peer.brief()
        peer.step(peer.publish_frame(1))
        status, said = ended(process)
        assert status == 1
        assert "memtransfer: policy Raises answered" in said and "an answer is an Action" in said
        assert "Traceback" not in said
