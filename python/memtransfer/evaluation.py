"""Evaluation of policies, memories and worlds of a Python process.

    from memtransfer import evaluate

    result = evaluate(policy="grounded", memory=[TopThree(), "episodic"], suite="rq1", limit=20, out="runs/mine")
    result.scores
    result.compare("top-3/new/unchanged/original", "episodic/new/unchanged/original")

`evaluate` starts `memtransfer run`, serves the objects that it is given, and returns what the run's folder holds. Policies and
memories are served by threads of this process, so they can be defined in a notebook, or in a script without a main guard; a world is
served by a process of its own. The guide is `docs/python.md` of the project.
"""

from __future__ import annotations

import html
import importlib
import json
import multiprocessing.process
import os
import pickle
import re
import shlex
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PosixPath
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict
from urllib.parse import quote

from memtransfer import _objects, _program
from memtransfer._names import did_you_mean
from memtransfer._relay import ATTACH
from memtransfer._world_process import PICKLE
from memtransfer.errors import MemTransferError, RunError
from memtransfer.memory import Memory
from memtransfer.policy import Policy
from memtransfer.serving import is_memory

if TYPE_CHECKING:
    import pandas as pd
    from typing_extensions import Unpack

    from memtransfer.world import World

PolicyArgument: TypeAlias = "Policy | str"
"""A policy: an object, the name of a built-in one, or a command."""

MemoryArgument: TypeAlias = "Memory | type[Memory] | str"
"""A memory: an object, a class, the name of a built-in one, or a command."""

WorldArgument: TypeAlias = "Callable[[], World] | str"
"""A world: a class, or what else makes it for each lane, or a command."""

Numbers: TypeAlias = "int | Sequence[int]"
Words: TypeAlias = "str | Sequence[str]"
Switch: TypeAlias = "bool | str"
File: TypeAlias = "str | os.PathLike[str]"

_END_S = 5.0
"""How long the services of objects may take to notice the end of their run."""


class Settings(TypedDict, total=False):
    """Further arguments of `evaluate`: the flags of `memtransfer run`, whose help explains them, with underscores. What is a list there
    can be a sequence; what is `on` or `off` can be a bool."""

    fresh: bool
    """Whether to remove an earlier run from the folder, and start over."""
    trace: File
    allow_commands: bool
    # What is run.
    world_book: File
    starts: Words
    """`original` (where a demonstration starts), `new` (where none does)."""
    routes: Words
    """`unchanged`, `blocked` (a passage of the demonstrations is closed; new starts only)."""
    demos: Words
    """Sets of demonstrations, each a condition of its own: `original`, `opposite`, `nearby`, `distant`, several of these joined by `+`, `4`
    for all four, `irrelevant`, `confusable`, `after`, `before-after`, `after-before`, `elsewhere`, `bank-N` for N of all cases."""
    cases: Words
    """By id (`t03-07`), task (`t03`), number (`37`) or range (`1-10`)."""
    limit: int
    """The number of the selected cases that are run, balanced over the tasks and their groups."""
    arms: Words
    """What the memories of a suite of streams are built from: `frozen`, `learning`, `oracle`, `wrong`."""
    streams: int
    rounds: int
    orders: Words
    """Of the blocks of streams: `drawn`, `reversed`, `shuffled`."""
    feedback: str
    """What a memory that learns is told at the end of an episode: `none`, `success`, `sub-goals`."""
    runs: int
    """Repetitions of every episode, each with its own seed."""
    seed: int
    """The number that the seed of every episode is derived from."""
    max_steps: int
    """Steps after which an episode ends."""
    assets: File
    elsewhere: File
    # What the agent is given.
    window: Numbers
    horizon: int
    hits: int
    segment: Words
    """What a retrieved segment holds: `actions` (with their views), `images`."""
    keyframes: int
    memory_images: int
    memory_text_bytes: int
    hint: Switch | Sequence[str]
    mismatch: Words
    """In what episodes differ from the demonstrations: each of these by itself."""
    documents: File
    frame_size: int
    """Width and height of a frame in pixels, a multiple of 64."""
    frames: str
    """What frames show: `rendered`, or as a control `blank`, `swapped`, `blank-all`."""
    plates: Switch
    labels: Switch
    appearance_seed: int
    encoder: str
    encoder_file: File
    # The model of the policy `openai`.
    model: str
    base_url: Words
    image_format: str
    image_budget: int
    answer_tokens: int
    prompt: File
    reasoning: str
    system_role: str
    extra_body: str | Mapping[str, Any]
    header: Words
    """Further headers of requests, each `NAME: VALUE`. Other users of the machine can see them while the run lasts."""
    max_connections: int
    endpoint_limit: int
    endpoint_limit_folder: File
    max_retries: int
    request_timeout: int
    """Seconds."""
    server_patience: int
    """Seconds."""
    stop_without_action: int
    response_cache: Switch | os.PathLike[str]
    prices: File
    max_tokens_total: int
    max_cost: float | str
    # How it is run.
    log_prompts: bool
    lanes: int
    """Episodes that run at the same time, and so the largest batch of a policy."""
    worlds: int
    encoder_threads: int
    provider: str
    frame_budget: int
    backend: str
    """What renders: `wgpu`, `cpu`."""
    adapter: str
    warm_views: bool
    spin_us: int
    step_timeout: int
    """Seconds that a policy has for an answer."""
    memory_timeout: int
    """Seconds that a memory has for an answer."""
    start_timeout: int
    """Seconds that the processes and objects have to get ready."""


_REPEATED = frozenset(("header",))
"""Flags that are given once for each value."""

_VALUELESS = frozenset(("fresh", "allow_commands", "log_prompts", "warm_views"))
"""Flags without a value."""

_ARGUMENTS = ("policy", "memory", "world", "suite", "out", "progress")
"""The arguments of `evaluate` that are no settings."""

_KEYWORDS = {
    **{name.replace("_", "-"): name for name in (*Settings.__annotations__, *_ARGUMENTS)},
    **{f"{name}-cmd": name for name in ("policy", "memory", "world")},
}
"""By flag of `memtransfer run`: the argument of `evaluate` that stands for it."""

_OWN_CODE = {"To run them again:": "To run them again with repaired code: `fresh=True`, or another `out`. With the same code:"}
"""What messages say where code of the user takes part."""


def evaluate(
    *,
    out: File,
    policy: PolicyArgument | None = None,
    memory: MemoryArgument | Sequence[MemoryArgument] | None = None,
    world: WorldArgument | None = None,
    suite: File | None = None,
    progress: bool = True,
    **settings: Unpack[Settings],
) -> Result:
    """Runs a suite and returns its result. The same call again resumes a run that was stopped, and returns at once if nothing is missing.

    Each of `policy`, `memory` and `world` is an object of this process or a text: a text of letters, digits and hyphens is a name, any
    other a command, such as `"python my_policy.py"`. Policies and memories that are objects are called from threads: one for the policy
    and one for each memory, so the methods of one object never overlap.

    Args:
        out: The folder of the run.
        policy: What decides; `grounded`, the scripted stand-in, if it is left out.
        memory: The memories that are compared, at most 8 of your own; the built-in ones if it is left out. Each bank of demonstrations gets
            a deep copy of a memory, or an instance of a class.
        world: A world of your own in place of the warehouse. A class of a notebook or script is sent to a process of its own with
            cloudpickle, which has to be installed; one of a module is imported there.
        suite: The name of a shipped suite (`memtransfer ls suites`), or a suite file; `quick` if it is left out.
        progress: Whether progress is shown: on standard error, or in the output of a notebook's cell. `False` shows notes only.
        **settings: The flags of `memtransfer run`, with underscores: see `Settings`.

    Raises:
        RunError: The run could not begin, as with a memory whose name is not valid, or not all episodes could be finished: the message is
            the run's own. If an object raised an exception, it is the cause. Finished episodes are kept: `Result(out)` reads them.
        KeyboardInterrupt: The run was interrupted. It has stopped cleanly, and the same call resumes it. A second interrupt ends it at once.
        TypeError: There is no such setting, an argument is of the wrong type, or a memory cannot be copied: pass its class.
        ValueError: Two memories have the same name, `memory` is empty, or a memory's `scope` is not valid.
    """
    if os.environ.get(ATTACH):
        raise RunError(f"this process was started by a run, which {ATTACH} names: serve it with `run`, not `evaluate`")
    if getattr(multiprocessing.process.current_process(), "_inheriting", False):
        raise RunError(
            "this process was started by multiprocessing and imports the main program, which calls `evaluate` again: put the call "
            'under `if __name__ == "__main__":`'
        )
    objects: list[_objects.Served] = []
    arguments = [
        *_policy_flags(policy, objects),
        *_memory_flags(memory, objects),
        *([] if suite is None else ["--suite", os.fspath(suite)]),
        *_setting_flags(settings),
        *([] if progress else ["--quiet"]),
        *["--out", os.fspath(out)],
    ]
    path = Path(out).absolute()
    served_world = None if world is None else _WorldCommand.of(world)
    with _served(served_world) as world_variables, _objects.Objects(objects) as services:
        command = [_program.find_program(), "run", *arguments]
        if served_world is not None:
            command += ["--world-cmd", served_world.command]
        variables = {**services.environment, **world_variables}
        is_own = bool({"--policy-cmd", "--memory-cmd", "--world-cmd"} & set(command))
        words = {**services.words, **(_OWN_CODE if is_own else {})}
        screen = _program.Screen(_program.style_of_screen(progress), words, _KEYWORDS, services.calls)
        ended = _program.attend(command, variables, services.broken, screen, f"finished: {path}")
        services.join(_END_S)
        if screen.left_behind or ended.interrupted:
            services.remove_rest()
    raised = services.raised
    if services.broken.is_set() and raised is not None:
        message = str(raised) if isinstance(raised, MemTransferError) else f"{type(raised).__name__}: {raised}".removesuffix(": ")
        raise RunError(message, ended.status) from raised
    if ended.interrupted:
        raise KeyboardInterrupt
    if ended.status != 0:
        raise RunError(_program.message_in(ended.notes), ended.status) from raised
    return Result(path, served_world)


def _policy_flags(policy: PolicyArgument | None, objects: list[_objects.Served]) -> list[str]:
    if policy is None:
        return []
    if isinstance(policy, Policy):
        objects.append(policy)
        return ["--policy-cmd", _objects.command_of(policy)]
    if isinstance(policy, type) and issubclass(policy, Policy):
        raise TypeError(f"policy is the class {policy.__name__}: pass an object, {policy.__name__}(...)")
    if not isinstance(policy, str):
        raise TypeError(f"policy is {policy!r}, which is neither a Policy nor a str")
    return ["--policy" if _is_name(policy) else "--policy-cmd", policy]


def _memory_flags(
    memory: MemoryArgument | Sequence[MemoryArgument] | None, objects: list[_objects.Served]
) -> list[str]:
    if memory is None:
        return []
    flags: list[str] = []
    names: list[str] = []
    several = [memory] if isinstance(memory, str) or is_memory(memory) else _sequence_of("memory", memory)
    if not several or any(isinstance(one, str) and not one.strip() for one in several):
        raise ValueError(f"memory is {memory!r}, which names none: leave it out for the built-in ones")
    for one in several:
        if is_memory(one):
            name = _objects.name_of(one)
            if any(_objects.name_of(other) == name for other in objects):
                raise ValueError(f"there are two objects of the name {name}: give one of them another `name`")
            objects.append(one)
            flags += ["--memory-cmd", _objects.command_of(one)]
        elif not isinstance(one, str):
            raise TypeError(f"memory is {one!r}, which is neither a Memory, the class of one nor a str")
        elif _is_name(one):
            names.append(one)
        else:
            flags += ["--memory-cmd", one]
    if "external" in names:
        raise ValueError("memory is 'external': pass the memory itself, or the command that starts it")
    return ["--memory", ",".join(names) or "none", *flags]


def _sequence_of(name: str, value: Any) -> list[Any]:
    if not isinstance(value, Sequence):
        raise TypeError(f"{name} is {value!r}, which is no sequence")
    return list(value)


def _is_name(text: str) -> bool:
    """Whether a text is a name, or several, rather than a command. A word that is no program is a misspelt name."""
    is_word = re.fullmatch(r"[A-Za-z0-9_-]+", text) is not None
    return re.fullmatch(r"[a-z0-9-]+(,[a-z0-9-]+)*", text) is not None or (is_word and shutil.which(text) is None)


def _setting_flags(settings: Mapping[str, Any]) -> list[str]:
    """The flags of settings. Their values are checked by the program."""
    flags: list[str] = []
    for name, value in settings.items():
        if name not in Settings.__annotations__:
            known = [*Settings.__annotations__, *_ARGUMENTS]
            raise TypeError(f"there is no setting {name!r}{did_you_mean(name, known)}")
        flag = f"--{name.replace('_', '-')}"
        if value is None:
            continue
        if name in _VALUELESS:
            if not isinstance(value, bool):
                raise TypeError(f"{name} is {value!r}, which is no bool")
            flags += [flag] if value else []
        elif name in _REPEATED:
            for one in [value] if isinstance(value, str) else _sequence_of(name, value):
                flags += [flag, _text_of(name, one)]
        else:
            flags += [flag, _text_of(name, value)]
    return flags


def _text_of(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str | os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return json.dumps(dict(value))
    if isinstance(value, Sequence):
        return ",".join(_text_of(name, one) for one in value)
    return str(value)


@dataclass(frozen=True)
class _WorldCommand:
    """A world as the program starts it."""

    command: str
    pickled: bytes | None = None
    """The world, if it is an object."""

    @classmethod
    def of(cls, world: WorldArgument) -> _WorldCommand:
        if isinstance(world, str):
            return cls(world)
        if not callable(world):
            raise TypeError(f"world is {world!r}, which is neither a str nor what makes a world: pass the class")
        # The word that follows is not used: it is the file whose hash tells changed code.
        inner = 'exec "$_MEMTRANSFER_PYTHON" "$_MEMTRANSFER_WORLD_PROCESS" "$@"'
        file = getattr(sys.modules.get(world.__module__), "__file__", None)
        name = file if file and Path(file).is_file() else getattr(world, "__name__", "world")
        return cls(shlex.join(["sh", "-c", inner, str(name)]), pickle.dumps((sys.path, _pickled(world))))


def _pickled(world: Callable[[], World]) -> bytes:
    try:
        cloudpickle: Any = importlib.import_module("cloudpickle")
    except ModuleNotFoundError:
        if world.__module__ != "__main__":
            return pickle.dumps(world)
        raise ModuleNotFoundError(
            "a world that a notebook or the main program defines is sent to its process with cloudpickle: `pip install cloudpickle`, or "
            "define the world in a module",
            name="cloudpickle",
        ) from None
    pickled: bytes = cloudpickle.dumps(world)
    return pickled


@contextmanager
def _served(world: _WorldCommand | None) -> Generator[dict[str, str], None, None]:
    """Gives the variables of the world's process."""
    if world is None or world.pickled is None:
        yield {}
        return
    # A file in memory, of which nothing is left when this process is killed.
    with open(os.memfd_create("memtransfer-world"), "wb") as file:
        file.write(world.pickled)
        file.flush()
        yield {
            "_MEMTRANSFER_PYTHON": sys.executable,
            "_MEMTRANSFER_WORLD_PROCESS": str(Path(__file__).with_name("_world_process.py")),
            PICKLE: f"/proc/{os.getpid()}/fd/{file.fileno()}",
        }


@dataclass(frozen=True)
class Unpaired:
    """An episode that one side of a comparison has finished and the other has not.

    Attributes:
        case: The case.
        repetition: The repetition, from 1.
        finished_in: The side that has it.
        absence: Why the other side has not.
    """

    case: str
    repetition: int
    finished_in: Literal["a", "b"]
    absence: Literal["given-up", "not-finished", "not-run"]


@dataclass(frozen=True, repr=False)
class Comparison:
    """The difference of two conditions, A minus B, over the pairs of episodes of the same case and repetition.

    Figures are means over cases: first over the pairs of a case, then over the cases. Intervals are of 95 %, over cases. The exact sign
    test asks whether one of the two succeeds in more cases than the other: it counts the cases that succeed more often under A and those
    that succeed more often under B, and leaves out the others. `docs/specification.md`, section 7, has the formulas.

    Attributes:
        a: The first condition.
        b: The second condition.
        difference: Of the success rates, in percentage points.
        interval: Its 95 % interval over cases, in percentage points; `None` for fewer than two cases.
        p: Of the exact two-sided sign test, from 0 to 1: the probability of counts as uneven as `more_under_a` and
            `more_under_b`, or more so, if neither condition were better. Not corrected for several comparisons.
        pairs: The number of pairs of episodes, each of one case and one repetition that both conditions have finished.
        cases: The number of cases of which there is a pair.
        success_a: The success rate of A over the pairs, in percent.
        success_b: The success rate of B over the pairs, in percent.
        more_under_a: The number of cases that succeed more often under A.
        more_under_b: The number of cases that succeed more often under B.
        spl_difference: Of SPL, the success weighted by path length, from -1 to 1.
        spl_interval: Its 95 % interval over cases; `None` for fewer than two cases.
        spl_a: SPL of A, from 0 to 1.
        spl_b: SPL of B, from 0 to 1.
        verdict: Whether A succeeds in more cases than B, or in fewer: p is below 5 %.
        sentence: The verdict in words, with what it follows from; where no difference is shown, with the one that would be shown with a
            probability of 80 %, and the number of cases that it would take to show this one.
        detectable: The smallest difference of the success rates, in percentage points, that would be shown with a probability of 80 % in as
            many cases; `None` where none would.
        more_cases: About how many more cases it would take to show this difference with a probability of 80 %; `None` where one is shown,
            where as many cases are better as worse, and where it would take more than 10,000.
        unpaired: The episodes of either side without one of the same case and repetition in the other. They enter no figure.
        changed_without: The parts of the pairs without which the verdict is another, each left out by itself: `group basic`, `task 9`,
            `repetition 2`, `case t03-07`.
    """

    a: str
    b: str
    difference: float
    interval: tuple[float, float] | None
    p: float | None
    pairs: int
    cases: int
    success_a: float
    success_b: float
    more_under_a: int
    more_under_b: int
    spl_difference: float
    spl_interval: tuple[float, float] | None
    spl_a: float
    spl_b: float
    verdict: Literal["better", "worse", "no-difference-shown"]
    sentence: str
    detectable: float | None
    more_cases: int | None
    unpaired: list[Unpaired]
    changed_without: list[str]

    def __repr__(self) -> str:
        return "\n".join((f"A: {self.a}", f"B: {self.b}", self.sentence, *(f"{name:<12} {text}" for name, text in self._rows())))

    def _repr_html_(self) -> str:
        rows = (f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in self._rows())
        sides = f"<p>A: <code>{html.escape(self.a)}</code><br>B: <code>{html.escape(self.b)}</code></p>"
        return f"{sides}\n<p>{html.escape(self.sentence)}</p>\n<table>{''.join(rows)}</table>"

    def _rows(self) -> list[tuple[str, str]]:
        """What is compared, and the figures in words."""
        p = "" if self.p is None else f", p = {self.p:.2g}"
        cases = f"{self.cases} cases: A better in {self.more_under_a}, worse in {self.more_under_b}"
        success = f"{self.success_a:.1f} % against {self.success_b:.1f} %: {self.difference:+.1f} points{_in_brackets(self.interval, 1)}{p}"
        spl = f"{self.spl_a:.3f} against {self.spl_b:.3f}: {self.spl_difference:+.3f}{_in_brackets(self.spl_interval, 3)}"
        rows = [("success", success), ("SPL", spl), ("of", f"{self.pairs} pairs of episodes, {cases}")]
        if self.unpaired:
            rows.append(("left out", f"{len(self.unpaired)} episodes that only one of the two has finished"))
        if self.changed_without:
            rows.append(("rests on", ", ".join(self.changed_without)))
        return rows


def _in_brackets(interval: tuple[float, float] | None, digits: int) -> str:
    return "" if interval is None else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


class _Page(PosixPath):
    """The path of a page, which a notebook shows as a link."""

    def __repr__(self) -> str:
        return repr(Path(self))

    def _repr_html_(self) -> str:
        path = os.path.relpath(self)
        return f'<a href="{html.escape(quote(path))}" target="_blank">{html.escape(path)}</a>'


class Result:
    """The result of a run, read from its folder when it is asked for. `Result("runs/mine")` reads a run that is there already, finished or
    not.

    Raises:
        RunError: The folder holds no run.
    """

    path: Path
    """The folder of the run."""

    def __init__(self, path: File, world: _WorldCommand | None = None) -> None:
        self.path = Path(path).absolute()
        if not (self.path / "manifest.json").is_file():
            reason = "which holds no run" if self.path.is_dir() else "which is no folder"
            raise RunError(f"there is no result in {self.path}, {reason}: give the `out` of a call of `evaluate`")
        self._world = world

    @property
    def manifest(self) -> dict[str, Any]:
        """The run's settings, versions and hashes, and what each process and object said of itself."""
        manifest: dict[str, Any] = json.loads((self.path / "manifest.json").read_text(encoding="utf-8"))
        return manifest

    @cached_property
    def scores(self) -> pd.DataFrame:
        """One row a condition, with the condition as the index: `episodes`; `sr` (success rate in percent) and `spl` (success weighted by
        path length, 0 to 1), each with the `_low` and `_high` of its 95 % interval over cases; and the other columns of the report's
        `conditions.csv` that have a value.

        Raises:
            ModuleNotFoundError: pandas is missing; the message names the extra that brings it.
        """
        from memtransfer.results import read_scores

        return read_scores(self.path)

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """One row an episode, with the columns of `memtransfer.results.Results.episodes`.

        Raises:
            ModuleNotFoundError: pandas is missing; the message names the extra that brings it.
        """
        from memtransfer.results import read

        return read(self.path).episodes

    def compare(self, a: str, b: str) -> Comparison:
        """Returns the paired difference of two conditions, which are named as in `scores`: what `memtransfer score --compare` prints.

        Raises:
            RunError: There is no such condition, or the two have no pair.
            TypeError: A name is no str.
        """
        for name in (a, b):
            if not isinstance(name, str):
                raise TypeError(f"{name!r} is no name of a condition, which is a str as in the index of `scores`")
        printed = _program.output_of(["score", str(self.path), "--compare", a, b, "--json"], accepted=(0, 1))
        (compared,) = json.loads(printed)
        success, spl = compared["sr"], compared["spl"]
        return Comparison(
            a=compared["a"],
            b=compared["b"],
            difference=success["mean"],
            interval=_interval(success),
            p=compared["p"],
            pairs=compared["pairs"],
            cases=compared["cases"],
            success_a=success["a"],
            success_b=success["b"],
            more_under_a=compared["more_under_a"],
            more_under_b=compared["more_under_b"],
            spl_difference=spl["mean"],
            spl_interval=_interval(spl),
            spl_a=spl["a"],
            spl_b=spl["b"],
            verdict=compared["verdict"],
            sentence=compared["sentence"],
            detectable=compared["detectable"],
            more_cases=compared["more_cases"],
            unpaired=[Unpaired(**episode) for episode in compared["unpaired"]],
            changed_without=[
                f"{kind} {change['without']}"
                for kind in ("group", "task", "repetition", "case")
                for change in compared["robustness"][f"{kind}s"]["changes"]
            ],
        )

    def report(self, out: File | None = None) -> Path:
        """Writes the report into the folder `out`, or into `report` in the run's folder. Returns the path of its page.

        Raises:
            RunError: It cannot be written.
        """
        more = [] if out is None else ["--out", os.fspath(out)]
        printed = _program.output_of(["report", str(self.path), *more], accepted=(0, 1))
        return _Page(os.path.abspath(printed.strip().splitlines()[-1]))

    def view(self, browser: bool = False) -> str:
        """Starts the viewer, which shows every episode step by step, and returns its address. The viewer ends with this process. `browser`
        says whether to open a browser.

        Raises:
            RunError: It cannot be started.
        """
        return self._viewer if not browser else _open(self._viewer)

    @cached_property
    def _viewer(self) -> str:
        command = [_program.find_program(), "view", str(self.path), "--no-browser"]
        if self._world is not None:
            command += ["--world-cmd", self._world.command]
        started: list[str | RunError] = []
        is_started = threading.Event()
        arguments = (command, self._world, started, is_started)
        threading.Thread(target=_keep_viewer, args=arguments, name="memtransfer viewer", daemon=True).start()
        is_started.wait()
        (address,) = started
        if isinstance(address, RunError):
            raise address
        return address

    def __repr__(self) -> str:
        summary = f"Result of {self.path}"
        try:
            return f"{summary}\n{self._main_scores().to_string()}"
        except (ModuleNotFoundError, RunError) as error:
            return f"{summary}: no table, because {error}"

    def _repr_html_(self) -> str:
        summary = f"<p>Result of <code>{html.escape(str(self.path))}</code></p>"
        try:
            return f"{summary}\n{self._main_scores().to_html(border=0)}"
        except (ModuleNotFoundError, RunError) as error:
            return f"{summary}\n<p>No table, because {html.escape(str(error))}</p>"

    def _main_scores(self) -> pd.DataFrame:
        main = ["episodes", "sr", "sr_low", "sr_high", "spl", "spl_low", "spl_high", "mean_steps"]
        scores: pd.DataFrame = self.scores[[name for name in main if name in self.scores]].round(3)
        return scores


def _interval(spread: Mapping[str, Any]) -> tuple[float, float] | None:
    interval = spread["interval"]
    return None if interval is None else (interval["low"], interval["high"])


def _open(address: str) -> str:
    import webbrowser

    webbrowser.open(address)
    return address


def _keep_viewer(
    command: Sequence[str], world: _WorldCommand | None, started: list[str | RunError], is_started: threading.Event
) -> None:
    """Starts the viewer, tells its address, and waits until it ends."""
    try:
        with _served(world) as variables:
            with subprocess.Popen(
                _program.dying_with_this_process(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=_program.environment(variables),
                # An interrupt of this process does not end it.
                start_new_session=True,
                text=True,
            ) as viewer:
                assert viewer.stdout is not None and viewer.stderr is not None
                address = viewer.stdout.readline().strip()
                if not address:
                    raise RunError(_program.message_in(viewer.stderr.read()), viewer.wait())
                started.append(address)
                is_started.set()
                # So that it never waits for its messages to be read.
                viewer.communicate()
    except Exception as error:
        if not started:
            started.append(error if isinstance(error, RunError) else RunError(str(error)))
            is_started.set()
