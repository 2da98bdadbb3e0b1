"""Evaluations: real runs of the program that `MEMTRANSFER_PROGRAM` names, or that is on the PATH."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from memtransfer import Action, Memory, Policy, PolicyError, Result, RunError, Steps, evaluate

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))
# Tests in the background may inherit an ignored SIGINT, and the scripts that they start with it; a program at a terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)

SHORT: dict[str, Any] = {"frame_size": 64, "max_steps": 7, "lanes": 3, "limit": 3, "starts": "original", "progress": False}
"""Short episodes on small frames."""

SCRIPT = """
    import asyncio, os, sys, threading, time
    from memtransfer import Action, Memory, Policy, evaluate

    class Forward(Policy):
        def act(self, batch):
            open("acts", "a").write("x")
            time.sleep(float(os.environ["PAUSE_S"]))
            return [Action.FORWARD for _ in batch]

    class Nothing(Memory):
        embeddings = False

        def recall(self, query):
            return []

    def run():
        settings = dict(frame_size=64, max_steps=20, lanes=2, limit=4, starts="original", out="run")
        return evaluate(policy=Forward(), memory=[Nothing(), "working"], **settings)
"""
"""A script without a main guard."""


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where the runs of a test are registered. Nothing may be left there, nor any process of them."""
    # Short, because it is part of the names of sockets.
    folder = Path(tempfile.mkdtemp(prefix="mt", dir="/dev/shm"))
    monkeypatch.setenv("MEMTRANSFER_RUN_DIR", str(folder))
    yield folder
    eventually(lambda: not os.listdir(folder) and not processes(folder))
    shutil.rmtree(folder)


def eventually(condition: Callable[[], Any]) -> Any:
    """Waits until `condition` returns something true, and returns it."""
    while not (value := condition()):
        time.sleep(0.05)
    return value


def processes(registry: Path) -> list[str]:
    """The command lines of the processes that have this registry, but for this one."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            mine = f"MEMTRANSFER_RUN_DIR={registry}\0".encode() in (process / "environ").read_bytes()
            if mine and int(process.name) != os.getpid():
                found.append((process / "cmdline").read_text().replace("\0", " "))
        except OSError:
            pass
    return found


class Forward(Policy):
    """Always moves forward."""

    def act(self, batch):
        return [Action.FORWARD for _ in batch]


class TopThree(Memory):
    """Supplies the steps with the most similar views."""

    name = "top-3"

    def build(self, demonstrations):
        self.demonstrations = demonstrations

    def recall(self, query):
        similar = self.demonstrations[0].embeddings @ query.embedding
        return [Steps(0, int(step)) for step in (-similar).argsort()[:3]]


class Nothing(Memory):
    """Supplies nothing."""

    embeddings = False

    def recall(self, query):
        return []


def records(run: Path) -> list[str]:
    """The log of a run, but for measured times and tries."""
    return sorted((run / "episodes.jsonl").read_text().splitlines())


def test_objects_of_this_process_are_evaluated(tmp_path: Path) -> None:
    out = tmp_path / "run"
    memory = [TopThree(), Nothing, "working"]
    result = evaluate(policy=Forward(), memory=memory, out=out, **SHORT)
    assert result.path == out and result.manifest["processes"]["policy"]["policy"] == "Forward"
    assert list(result.manifest["memories"]) == ["nothing", "top-3"]
    scores = result.scores
    conditions = ["nothing/original/unchanged/original", "top-3/original/unchanged/original", "working/original/unchanged/none"]
    assert sorted(scores.index) == conditions
    assert list(scores.columns[:4]) == ["episodes", "sr", "sr_low", "sr_high"]
    assert scores["episodes"].tolist() == [3, 3, 3] and (scores["sr_low"] <= scores["sr"]).all()
    assert len(result.episodes) == 9 and set(result.episodes["memory"]) == {"top-3", "nothing", "working"}
    compared = result.compare(conditions[1], conditions[0])
    assert (compared.a, compared.b, compared.pairs, compared.cases) == (conditions[1], conditions[0], 3, 3)
    assert compared.difference == compared.success_a - compared.success_b and compared.interval is not None
    assert compared.verdict == "no-difference-shown" and compared.sentence.startswith("No difference shown: ")
    # Three cases show none.
    assert (compared.detectable, compared.unpaired, compared.changed_without) == (None, [], [])
    words = f"0.0 % against 0.0 %: +0.0 points [{compared.interval[0]:.1f}, {compared.interval[1]:.1f}], p = 1"
    for shown in (repr(compared), compared._repr_html_()):
        assert words in shown and "3 pairs of episodes, 3 cases: A better in 0, worse in 0" in shown and conditions[1] in shown
        assert "No difference shown: " in shown
    with pytest.raises(RunError, match="did you mean `top-3/original/unchanged/original`"):
        result.compare("top-3/original/unchanged/orignal", conditions[0])
    unnamed: Any = 3
    with pytest.raises(TypeError, match="3 is no name of a condition"):
        result.compare(unnamed, conditions[0])
    assert conditions[0] in repr(result) and conditions[0] in result._repr_html_()
    page = result.report()
    assert repr(page) == repr(Path(page))
    assert page == out / "report/report.html" and "top-3" in page.read_text()
    assert 'report/report.html" target="_blank">' in page._repr_html_()  # type: ignore[attr-defined]
    # The same call again finds nothing missing, and a larger limit adds episodes.
    before = records(out)
    evaluate(policy=Forward(), memory=memory, out=out, **SHORT)
    assert records(out) == before
    grown = evaluate(policy=Forward(), memory=memory, out=out, **{**SHORT, "limit": 4})
    assert len(grown.episodes) == 12 and set(before) < set(records(out))


def test_the_viewer_serves_the_run(tmp_path: Path, registry: Path) -> None:
    script = """
        import urllib.request
        from memtransfer import evaluate
        result = evaluate(policy="random", memory="working", out="run", limit=1, max_steps=3, frame_size=64)
        address = result.view()
        assert address == result.view()
        print(urllib.request.urlopen(address).status)
    """
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, "200\n"), ended.stderr


def test_an_object_is_logged_as_a_command_with_the_same_class(tmp_path: Path) -> None:
    module = tmp_path / "my_memory.py"
    module.write_text("from memtransfer import Memory, run\nclass Mine(Memory):\n    embeddings = False\n    def recall(self, query): return ['go']\n")
    program = tmp_path / "program.py"
    program.write_text("from my_memory import Mine\nfrom memtransfer import run\nrun(Mine())\n")
    sys.path.insert(0, str(tmp_path))
    try:
        from my_memory import Mine  # type: ignore[import-not-found]
    finally:
        sys.path.remove(str(tmp_path))
    evaluate(policy="random", memory=Mine(), out=tmp_path / "object", **SHORT)
    evaluate(policy="random", memory=f"{sys.executable} {program}", out=tmp_path / "command", **SHORT)

    def of(run: str) -> tuple[Any, Any]:
        kept = [json.loads(line) for line in records(tmp_path / run)]
        manifest = json.loads((tmp_path / run / "manifest.json").read_text())
        memory = manifest["memories"]["mine"]
        # How it is started, and by what.
        for fact in ("command", "files", "code"):
            memory.pop(fact, None)
        del manifest["settings"]["memory-cmd"], manifest["settings"]["out"]
        return kept, manifest

    (object_log, object_manifest), (command_log, command_manifest) = of("object"), of("command")
    assert object_log == command_log and object_manifest == command_manifest


def test_what_a_memory_raises_is_the_cause(tmp_path: Path) -> None:
    class Fails(Nothing):
        def recall(self, query):
            if query.step == 3:
                raise KeyError("corridor")
            return []

    with pytest.raises(RunError, match="(?s)3 of 6 episodes could not be finished.*fails.* raised KeyError: 'corridor'.*repaired code: `fresh=True`, or another `out`") as caught:
        evaluate(policy="random", memory=[Fails(), "working"], out=tmp_path / "run", **SHORT)
    assert caught.value.status == 1
    cause = caught.value.__cause__
    assert isinstance(cause, KeyError) and cause.__traceback__ is not None and cause.__traceback__.tb_frame.f_code.co_name == "recall"
    assert "KeyError: 'corridor'" in (tmp_path / "run/logs/external-memory-0.log").read_text()
    # What is finished can be read.
    assert Result(tmp_path / "run").scores["episodes"].to_dict()["working/original/unchanged/none"] == 3


def test_a_memory_that_exits_costs_its_episode_and_not_this_process(tmp_path: Path) -> None:
    class Exits(Nothing):
        def recall(self, query):
            sys.exit(3)

    with pytest.raises(RunError, match="exits.* raised SystemExit: 3"):
        evaluate(policy="random", memory=Exits(), out=tmp_path / "run", **SHORT)


def test_what_a_policy_raises_is_the_cause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Divides(Policy):
        def act(self, batch):
            return [len(batch) // 0]

    class Short(Policy):
        def act(self, batch):
            return []

    class Resets(Forward):
        def reset(self, lane):
            raise ValueError("no lane")

    with pytest.raises(RunError, match="policy Divides raised ZeroDivisionError") as caught:
        evaluate(policy=Divides(), memory="working", out=tmp_path / "divides", **SHORT)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    # A broken contract is no crash: the run stops at once.
    with pytest.raises(RunError, match="policy Short answered 0 of . requests: it must answer each once") as caught:
        evaluate(policy=Short(), memory="working", out=tmp_path / "short", **SHORT)
    assert isinstance(caught.value.__cause__, PolicyError)
    with pytest.raises(RunError, match="^ValueError: no lane$"):
        evaluate(policy=Resets(), memory="working", out=tmp_path / "resets", **SHORT)
    # These runs failed: nothing that is printed may say that they were interrupted.
    printed = capsys.readouterr()
    assert "SIGINT" not in printed.err + printed.out and "WARN" not in printed.err + printed.out


def test_the_message_of_the_program_is_raised(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="^lanes: 0 is not a whole number from 1 to 1024$") as caught:
        evaluate(out=tmp_path / "run", lanes=0)
    assert caught.value.status == 2
    with pytest.raises(RunError, match="^unknown suite `rq7`: did you mean `rq1`"):
        evaluate(out=tmp_path / "run", suite="rq7")
    with pytest.raises(RunError, match="^memory: unknown memory `workin`: did you mean `working`"):
        evaluate(out=tmp_path / "run", memory="workin")
    with pytest.raises(RunError, match="^memory: unknown memory `full_Context`: did you mean `full-context`"):
        evaluate(out=tmp_path / "run", memory="full_Context")
    with pytest.raises(RunError, match="^demos: unknown demonstrations `nope`"):
        evaluate(out=tmp_path / "run", demos="nope")
    with pytest.raises(RunError, match="there is no program `no-such-program` in"):
        evaluate(out=tmp_path / "run", policy="no-such-program --fast")

    class Spaced(Nothing):
        name = "Two Words"

    with pytest.raises(RunError, match='"Two Words" is not a name of a memory: 1 to 24 lower-case letters, digits and hyphens$'):
        evaluate(out=tmp_path / "run", memory=Spaced())


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"limitt": 3}, TypeError, "there is no setting 'limitt': did you mean 'limit'?"),
        ({"max-steps": 3}, TypeError, "there is no setting 'max-steps': did you mean 'max_steps'?"),
        ({"fresh": "yes"}, TypeError, "fresh is 'yes', which is no bool"),
        ({"policy": Forward}, TypeError, r"policy is the class Forward: pass an object, Forward\(...\)"),
        ({"policy": 3}, TypeError, "policy is 3, which is neither a Policy nor a str"),
        ({"memory": 3}, TypeError, "memory is 3, which is no sequence"),
        ({"memory": ["working", 3]}, TypeError, "memory is 3, which is neither a Memory, the class of one nor a str"),
        ({"memory": [Nothing(), Nothing]}, ValueError, "two objects of the name memory nothing"),
        ({"memory": "external"}, ValueError, "pass the memory itself"),
        ({"memory": []}, ValueError, r"memory is \[\], which names none: leave it out for the built-in ones"),
        ({"memory": ["working", " "]}, ValueError, r"memory is \['working', ' '\], which names none"),
        ({"world": 3}, TypeError, "world is 3, which is neither a str nor what makes a world"),
    ],
)
def test_arguments_that_start_no_run(tmp_path: Path, arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        evaluate(out=tmp_path / "run", **arguments)
    assert not (tmp_path / "run").exists()


def is_left(run: str, registry: Path) -> bool:
    """Whether anything of a run is in shared memory."""
    return run in os.listdir(registry) or any(name.startswith(f"mt{run}_") for name in os.listdir("/dev/shm"))


@pytest.mark.parametrize("raises", [False, True])
def test_what_a_memory_keeps_stays_readable_and_leaves_nothing_behind(tmp_path: Path, registry: Path, raises: bool) -> None:
    kept: list[Any] = []
    runs: list[str] = []

    class Keeps(Memory):
        def build(self, demonstrations: Any) -> None:
            runs.extend(os.listdir(registry))
            kept.extend(demonstrations)

        def recall(self, query: Any) -> list[Any]:
            if raises:
                raise ValueError("no answer")
            return []

    if raises:
        with pytest.raises(RunError, match="no answer"):
            evaluate(out=tmp_path / "run", memory=Keeps(), **SHORT)
    else:
        evaluate(out=tmp_path / "run", memory=Keeps(), **SHORT)
    assert runs and not is_left(runs[0], registry)
    assert all(demonstration.embeddings.any() for demonstration in kept)


@pytest.mark.parametrize("answer", [{"a": 1}, {"a"}, b"a", "a", Steps(0), 3, None])
def test_an_answer_that_is_no_list_is_refused(tmp_path: Path, answer: Any) -> None:
    class Recalls(Nothing):
        def recall(self, query: Any) -> Any:
            return answer

    class Acts(Policy):
        def act(self, batch: Any) -> Any:
            return answer

    with pytest.raises(RunError, match="must return a list of items") as caught:
        evaluate(out=tmp_path / "memory", memory=Recalls(), **SHORT)
    assert f"recall returned {answer!r}, but" in str(caught.value)
    with pytest.raises(RunError, match="from act: it must return a list with one answer for each request") as caught:
        evaluate(out=tmp_path / "policy", policy=Acts(), memory="working", **SHORT)
    assert f"returned {answer!r} from act" in str(caught.value)


def test_an_exit_in_a_memory_is_a_cause_as_other_exceptions_are(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    class Exits(Nothing):
        def recall(self, query: Any) -> list[Any]:
            sys.exit("enough")

    with pytest.raises(RunError, match="raised SystemExit: enough") as caught:
        evaluate(out=tmp_path / "run", memory=Exits(), **SHORT)
    assert isinstance(caught.value.__cause__, SystemExit)
    assert "Traceback" not in capfd.readouterr().err
    assert "Traceback" in (tmp_path / "run/logs/external-memory-0.log").read_text()


def test_it_runs_without_pseudo_terminals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import pty

    def refuse() -> tuple[int, int]:
        raise OSError("out of pty devices")

    monkeypatch.setattr(pty, "openpty", refuse)
    evaluate(out=tmp_path / "run", memory=Nothing(), **{**SHORT, "progress": True})
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "starting the processes" and lines[-1] == f"finished: {tmp_path / 'run'}"
    with pytest.raises(RunError, match="^limit: -1 is not a whole number"):
        evaluate(out=tmp_path / "run", memory=Nothing(), **{**SHORT, "limit": -1})


def test_a_process_that_imports_the_main_program_runs_nothing(tmp_path: Path) -> None:
    call = """
class Starts(Nothing):
    def build(self, demonstrations):
        import multiprocessing
        process = multiprocessing.get_context("spawn").Process(target=print)
        process.start()
        process.join()

print(len(evaluate(memory=Starts(), frame_size=64, max_steps=3, limit=1, starts="original", out="run").episodes))
"""
    printed, problems = start(tmp_path, call, 0).communicate()
    assert printed == "1\n", problems
    assert 'put the call under `if __name__ == "__main__":`' in problems


def test_settings_are_the_flags_of_run() -> None:
    from memtransfer._program import find_program
    from memtransfer.evaluation import Settings

    printed = subprocess.run([find_program(), "run", "--help"], capture_output=True, text=True, check=True).stdout
    flags = {line.split()[0] for line in printed.splitlines() if line.startswith("      --")}
    ours = {f"--{name.replace('_', '-')}" for name in Settings.__annotations__}
    arguments = {"--policy", "--policy-cmd", "--memory", "--memory-cmd", "--world", "--world-cmd", "--suite", "--out", "--quiet"}
    # What runs nothing, and what is for programs that start runs, as `evaluate` does.
    assert flags - arguments - {"--dry-run", "--show-settings", "--die-with", "--discard", "--repetition"} == ours


def test_spl_from_infos_of_the_environment_is_that_of_a_run(tmp_path: Path) -> None:
    from memtransfer.gym import MemTransferEnv

    conditions = {"starts": ["original", "new"], "routes": ["unchanged", "blocked"]}
    result = evaluate(policy="grounded", memory="working", cases=["t01-01", "t03-07"], out=tmp_path / "run", progress=False, **conditions)
    assert len(result.episodes) == 6
    spl = []
    for record in result.episodes.itertuples():
        env = MemTransferEnv(case=record.case, start=record.start, route=record.route, frame_size=64)
        _, info = env.reset()
        for letter in record.actions:
            *_, info = env.step("fblrLRU".index(letter))
        assert (info["case"], info["start"], info["route"]) == (record.case, record.start, record.route)
        assert (info["is_success"], info["reference_length"]) == (record.success, record.reference)
        spl.append(info["is_success"] * info["reference_length"] / max(len(record.actions), info["reference_length"]))
        assert abs(spl[-1] - record.spl) < 1e-6
    # Detours, and an episode that failed.
    assert 0 in spl and any(0 < one < 1 for one in spl)


def test_without_the_program_there_is_a_hint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MEMTRANSFER_PROGRAM", "no-such-program")
    with pytest.raises(RunError, match="MEMTRANSFER_PROGRAM is no-such-program, which is no program"):
        evaluate(out=tmp_path / "run")


def test_without_pandas_there_is_a_hint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = evaluate(policy="random", memory="working", out=tmp_path / "run", **SHORT)
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.delitem(sys.modules, "memtransfer.results", raising=False)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'memtransfer\[results\]'"):
        result.scores  # noqa: B018
    for shown in (repr(result), result._repr_html_()):
        assert str(tmp_path / "run") in shown and "pip install" in shown


def test_a_result_needs_a_run(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="^there is no result in .*/nothing, which is no folder"):
        Result(tmp_path / "nothing")
    with pytest.raises(RunError, match="which holds no run"):
        Result(tmp_path)


def start(folder: Path, call: str, pause_s: float) -> subprocess.Popen[str]:
    """Starts the script with a last line."""
    folder.joinpath("script.py").write_text(textwrap.dedent(SCRIPT) + call)
    environment = {**os.environ, "PAUSE_S": str(pause_s)}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A group of its own, as a shell gives it.
    return subprocess.Popen([sys.executable, "script.py"], cwd=folder, env=environment, start_new_session=True, **pipes)


@pytest.mark.parametrize(
    ("caller", "to_group"),
    [
        ("run()", False),
        ("run()", True),
        ("asyncio.run(coroutine())", False),
        ("asyncio.run(coroutine())", True),
        # A thread gets no interrupts; those of a terminal and of Jupyter go to the group.
        ("asyncio.run(asyncio.to_thread(run))", True),
    ],
)
def test_an_interrupt_stops_the_run_and_the_same_call_resumes_it(tmp_path: Path, caller: str, to_group: bool) -> None:
    call = f"async def coroutine():\n    return run()\ntry:\n    print(len({caller}.episodes))\nexcept KeyboardInterrupt:\n    print('interrupted')\n"
    script = start(tmp_path, call, 0.2)
    eventually((tmp_path / "acts").exists)
    (os.killpg if to_group else os.kill)(script.pid, signal.SIGINT)
    printed, problems = script.communicate()
    assert (script.returncode, printed) == (0, "interrupted\n"), problems
    assert "stopped by SIGINT" in problems and "ended at once" not in problems
    assert "stopping" in problems or caller.startswith("asyncio.run(asyncio.to_thread"), problems
    printed, problems = start(tmp_path, call, 0).communicate()
    assert printed == "8\n", problems


@pytest.mark.parametrize("caller", ["asyncio.run(coroutine())", "asyncio.run(asyncio.to_thread(run))"])
def test_it_runs_beside_an_event_loop(tmp_path: Path, caller: str) -> None:
    call = f"async def coroutine():\n    return run()\nprint(len({caller}.episodes))\n"
    printed, problems = start(tmp_path, call, 0).communicate()
    assert printed == "8\n", problems


@pytest.mark.parametrize("interrupts", [1, 2])
def test_an_interrupt_says_what_it_waits_for_and_leaves_nothing_behind(tmp_path: Path, registry: Path, interrupts: int) -> None:
    call = """
class Slow(Nothing):
    def build(self, demonstrations):
        open("builds", "w").close()
        while not os.path.exists("go"):
            time.sleep(0.05)

try:
    evaluate(policy=Forward(), memory=Slow(), frame_size=64, max_steps=3, lanes=2, limit=4, starts="original", out="run")
except KeyboardInterrupt:
    open("interrupted", "w").close()
    # The process goes on, as that of a notebook does.
    for thread in threading.enumerate():
        if thread.name in ("memtransfer object", "memtransfer rest"):
            thread.join()
    print("ended", flush=True)
    input()
"""
    folder, environment = tmp_path, {**os.environ, "PAUSE_S": "0"}
    folder.joinpath("script.py").write_text(textwrap.dedent(SCRIPT) + call)
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    script = subprocess.Popen([sys.executable, "script.py"], cwd=folder, env=environment, start_new_session=True, **pipes)
    eventually((folder / "builds").exists)
    (run,) = os.listdir(registry)
    script.send_signal(signal.SIGINT)
    if interrupts == 2:
        # Signals within half a second are the same request.
        time.sleep(1)
        script.send_signal(signal.SIGINT)
    eventually((folder / "interrupted").exists)
    (folder / "go").touch()
    assert script.stdout is not None and script.stdout.readline() == "ended\n"
    assert not os.listdir(registry) and not [name for name in os.listdir("/dev/shm") if name.startswith(f"mt{run}_")]
    _, problems = script.communicate("\n")
    assert script.returncode == 0, problems
    assert "stopping; waiting for memory slow (build) (interrupt again to end at once)" in problems and "WARN" not in problems


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_run_ends_with_the_process_that_called_it(tmp_path: Path, registry: Path, number: signal.Signals) -> None:
    script = start(tmp_path, "run()", 0.2)
    eventually((tmp_path / "acts").exists)
    runs = os.listdir(registry)
    assert len(runs) == 1 and processes(registry)
    script.send_signal(number)
    script.communicate()
    eventually(lambda: not processes(registry) and not os.listdir(registry))
    assert not [name for name in os.listdir("/dev/shm") if name.startswith(f"mt{runs[0]}")]
    printed, problems = start(tmp_path, "print(len(run().episodes))", 0).communicate()
    assert printed == "8\n", problems


def test_objects_join_processes_that_were_started_again(tmp_path: Path, registry: Path) -> None:
    script = start(tmp_path, "print(len(run().episodes))", 0.05)
    eventually((tmp_path / "acts").exists)
    (world,) = [
        process for process in Path("/proc").glob("[0-9]*") if "sim-proc" in command(process) and f"={registry}\0" in variables(process)
    ]
    os.kill(int(world.name), signal.SIGKILL)
    printed, problems = script.communicate()
    assert printed == "8\n", problems
    assert "starting again" in problems


def command(process: Path) -> str:
    return read(process / "cmdline").split("\0")[0]


def variables(process: Path) -> str:
    return read(process / "environ")


def read(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def test_changed_code_is_refused_where_there_is_no_source(tmp_path: Path) -> None:
    program = """
from memtransfer import Memory, evaluate

class Recalls(Memory):
    embeddings = False
    def recall(self, query):
        return [] if query.step in {1, 2} else ["NOTE"]

evaluate(memory=Recalls(), frame_size=64, max_steps=3, limit=1, starts="original", out="run")
"""
    for note, status in (("a", 0), ("a", 0), ("b", 1)):
        text = program.replace("NOTE", note)
        done = subprocess.run([sys.executable, "-"], input=text, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == status, done.stderr
    assert "code of memory recalls" in done.stderr


def test_changed_code_is_refused_and_a_changed_call_is_not(tmp_path: Path) -> None:
    script = """
        from memtransfer import Memory, evaluate
        def words(): return "turn"
        class Mine(Memory):
            embeddings = False
            def recall(self, query): return [words()]
        print(len(evaluate(policy="random", memory=Mine(), out="run", limit=2, max_steps=3, frame_size=64, starts="original").episodes))
    """

    def printed(text: str) -> tuple[str, str]:
        (tmp_path / "script.py").write_text(textwrap.dedent(text))
        ended = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True)
        return ended.stdout, ended.stderr

    assert printed(script)[0] == "2\n"
    assert printed(script.replace("limit=2", "limit=3"))[0] == "3\n"
    nothing, problems = printed(script.replace('"turn"', '"go"'))
    assert nothing == "" and "code of memory mine" in problems, problems
    assert "as `fresh=True` does), or choose another `out`" in problems and "--" not in problems, problems


def test_a_world_of_a_module_is_a_world_of_the_run(tmp_path: Path) -> None:
    import corridor_world

    settings = {**SHORT, "limit": 2, "max_steps": 30}
    result = evaluate(world=corridor_world.Corridor, policy="imitate", memory=[Nothing(), "full-context"], out=tmp_path / "run", **settings)
    assert len(result.scores) == 2 and len(result.episodes) == 4


def test_a_world_of_a_script_is_a_world_of_the_run(tmp_path: Path) -> None:
    source = (Path(__file__).parent.parent / "examples/corridor_world.py").read_text()
    call = 'evaluate(world=Corridor, policy="expert", out="run", limit=2, frame_size=64, starts="original")'
    use = f"import urllib.request\nfrom memtransfer import evaluate\nresult = {call}\nurllib.request.urlopen(result.view())\nprint(result.scores['sr'].tolist())\n"
    (tmp_path / "script.py").write_text(source.split("if __name__")[0] + f"{use}")
    ended = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True)
    assert (ended.returncode, set(ended.stdout.strip("[]\n").split(", "))) == (0, {"100.0"}), ended.stderr


def test_the_example_compares_memories(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import compare_memories

    result = compare_memories.compare(1, str(tmp_path / "run"))
    assert set(result.episodes["memory"]) == {"top-3", "working", "episodic"}


def test_a_run_does_not_start_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MEMTRANSFER_ATTACH", str(tmp_path))
    with pytest.raises(RunError, match="serve it with `run`, not `evaluate`"):
        evaluate(out=tmp_path / "run")


@pytest.mark.parametrize(
    ("style", "shown"),
    [
        ("TERMINAL", "\r\x1b[2K[#.] 1/2\r\x1b[2Ka note\n\r\x1b[2K[##] 2/2\r\x1b[2Kfinished\n"),
        ("NOTEBOOK", "\r[#.] 1/2\ra note  \n\rfinished\n"),
        ("LINES", "[#.] 1/2\na note\nfinished\n"),
        ("NOTES", "a note\n"),
    ],
)
def test_progress_replaces_itself_and_notes_stay(style: str, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    from memtransfer._program import Screen, Style

    screen = Screen(Style[style], {"`sh -c relay`": "policy"}, {})
    printed = "\r\x1b[2K[#.] 1/2|\r\x1b[2Ka note\r\n|\r\x1b[2K[##] 2/2|\r\x1b[2Kmemtransfer: `sh -c relay` ended. To resume:\r\n  /bin/memtransfer run --x\r\n"
    for chunk in printed.split("|"):
        screen.receive(chunk.encode())
    screen.close("finished")
    printed_by_us = capsys.readouterr()
    assert (printed_by_us.out, printed_by_us.err) == ((shown, "") if style == "NOTEBOOK" else ("", shown))
    assert screen.notes == ["a note", "memtransfer: policy ended. To resume:", "  the same call of `evaluate`"]


@pytest.mark.parametrize(("term", "style"), [("xterm", "TERMINAL"), ("dumb", "LINES"), (None, "LINES")])
def test_a_terminal_without_a_cursor_gets_lines(term: str | None, style: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from memtransfer._program import Style, style_of_screen

    monkeypatch.delenv("TERM", raising=False)
    if term is not None:
        monkeypatch.setenv("TERM", term)
    terminal, end = os.openpty()
    with open(terminal), open(end, "w") as screen:
        monkeypatch.setattr(sys, "stderr", screen)
        assert style_of_screen(progress=True) is Style[style]


def test_progress_is_as_wide_as_the_terminal_and_not_cut_without_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl
    import struct
    import termios

    from memtransfer._program import _open_terminal

    def columns() -> int:
        ends = _open_terminal()
        try:
            return os.get_terminal_size(ends[1]).columns
        finally:
            for end in ends:
                os.close(end)

    terminal, end = os.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("4H", 20, 70, 0, 0))
    with open(terminal), open(end, "w") as screen, open(tmp_path / "log", "w") as log:
        monkeypatch.setattr(sys, "stderr", screen)
        assert columns() == 70
        monkeypatch.setattr(sys, "stderr", log)
        assert columns() == 200


def test_logs_and_long_calls_have_lines_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    from memtransfer._program import Screen, Style

    calls: list[str] = []
    screen = Screen(Style.LINES, {}, {"out": "out"}, lambda _: calls)
    bar, logged = "\r\x1b[2K[#.] 1/2, 3 s left", "2026-01-01T10:00:00.123456Z  WARN"
    for chunk in (bar, f"{logged} llm: slow\r\n", f"{bar}{logged} shm_types::registry: a process of run 12ab is still alive; when\r\n"):
        screen.receive(chunk.encode())
    calls.append("memory slow (build)")
    screen._shown_s = float("-inf")
    screen.receive(b"\r\x1b[2K[#.] 1/2, SR 5.0 %, 1 min 03 s left")
    screen.receive(b"ended at once by a second SIGINT\r\nuse another --out\r\n")
    screen.close("")
    assert capsys.readouterr().err.splitlines() == [
        "[#.] 1/2, 3 s left",
        f"{logged} llm: slow",
        "[#.] 1/2, SR 5.0 %, waiting for memory slow (build)",
        "ended at once by a second SIGINT",
        "use another `out`",
    ]
    assert screen.left_behind and screen.notes == ["ended at once by a second SIGINT", "use another `out`"]


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("--max-steps: 0 is too small", "max_steps: 0 is too small"),
        ("remove it (as `run --fresh` does), or choose another --out", "remove it (as `fresh=True` does), or choose another `out`"),
        ("  max-steps: 5 there, 6 now", "  max_steps: 5 there, 6 now"),
        ("`--memory none` is for --memory-cmd", "`memory='none'` is for `memory`"),
        ("no program `x` in `x --out y`; see `memtransfer doctor --policy openai`", None),
        ("--fast is no flag, and so is an --out-of-date", None),
        ("  memtransfer conformance --policy-cmd 'python my_policy.py'", None),
    ],
)
def test_messages_name_arguments_rather_than_flags(line: str, shown: str | None) -> None:
    from memtransfer._program import _in_python
    from memtransfer.evaluation import _KEYWORDS

    assert _in_python(line, _KEYWORDS) == (line if shown is None else shown)
