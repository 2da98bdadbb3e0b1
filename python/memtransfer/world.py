"""A world of your own: a simulator and its tasks, in which policies and memories are evaluated.

    class Corridor(World):
        name, version = "corridor", "1"
        rules = "You walk along a corridor of ten cells. ..."
        actions = ["walk east", "walk west"]
        state = [Field("cell")]

        def cases(self): ...
        def reset(self, episode): ...
        def step(self, action): ...
        def render(self, pixels): ...

    if __name__ == "__main__":
        main(Corridor)

`memtransfer run --world-cmd "python corridor.py"` evaluates in it. `memtransfer.gym_world` makes worlds of
Gymnasium environments. The guide is `docs/own-world.md` of the project.
"""

from __future__ import annotations

import gc
import json
import math
import operator
import signal
import string
import sys
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from memtransfer import _native
from memtransfer.declaration import Field, WorldDeclaration
from memtransfer.errors import WorldError
from memtransfer.serving import terminated

__all__ = [
    "DONE",
    "MISMATCHES",
    "NO_EFFECT",
    "START",
    "TRAJECTORIES",
    "Case",
    "Episode",
    "Field",
    "Observation",
    "World",
    "WorldError",
    "declaration",
    "main",
]

START, DONE, NO_EFFECT = 0, 1, 2
"""Numbers of the first three sentences of `World.feedback`."""

TRAJECTORIES = ("original", "opposite", "nearby", "distant", "new", "blocked", "after")
"""The names of an expert's trajectories: demonstrations from four starts; references from the start at which a case is tested,
where the way is free and where it is blocked; and a demonstration where it is blocked."""

MISMATCHES = ("light", "labels", "camera-height", "field-of-view", "wording", "stock")
"""What a test can differ in from demonstrations, beside start and way: other light, nothing written, the camera elsewhere above the
floor or with another field of view, the instruction in other words, other things where the task is not about them."""

_DEMONSTRATIONS = ("original", "opposite", "nearby", "distant", "after")


@dataclass(frozen=True, slots=True)
class Case:
    """A task with its starts, and what an expert does from them."""

    id: str
    """1 to 64 letters, digits, `-` and `_`."""
    instruction: str
    """The task, in words."""
    trajectories: Mapping[str, Sequence[int]]
    """The expert's actions, by name (`TRAJECTORIES`). `original` and `new` have to be there."""
    task: str = ""
    """The name of its task in `World.tasks`; the first one's if empty."""
    irrelevant: Sequence[tuple[str, str]] = ()
    """Two demonstrations of other cases that have nothing to do with this one: the ids of their cases, and their names."""
    confusable: Sequence[tuple[str, str]] = ()
    """Two demonstrations of other cases that are like this one and lead elsewhere."""
    data: Any = field(default=None, compare=False)
    """Whatever the world needs to begin an episode."""
    paraphrase: str | None = None
    """The instruction in other words that mean the same, for the mismatch `wording`."""


@dataclass(frozen=True, slots=True)
class Episode:
    """How an episode begins."""

    case: Case
    start: str
    """Where: `original`, `opposite`, `nearby`, `distant` or `new`."""
    blocked: bool
    """Whether the way is blocked."""
    seed: int
    """For random choices of a world that is not deterministic."""
    mismatch: str = "none"
    """In what the world has to differ from demonstrations, beside start and way: `none`, or one of `World.mismatches`."""


@dataclass(slots=True)
class Observation:
    """What a world says after the begin of an episode and after each step."""

    state: Sequence[float]
    """The state of the agent: a number for each field."""
    feedback: int = DONE
    """The number of a sentence of `World.feedback`. After the begin it is always the first."""
    sub_goals: int = 0
    """Sub-goals completed so far."""
    required: int = 1
    """All sub-goals of the task. The task is complete, and the episode ends, when all are completed."""
    failed: bool = False
    """Whether the task can no longer be completed: the episode ends."""
    conflict: bool = False
    """Whether the agent ran in this step into what blocks the way."""
    state_hash: int | None = None
    """A number of 64 bits (0 to 2**64 - 1) that is the same exactly where everything is that determines what is seen and what
    follows. Pictures of such states are rendered once. `None`: every step is rendered. Python's `hash` is not suited: that of texts is
    another in each process."""


class World(ABC):
    """A simulator of one episode at a time. Each lane of a run has an instance of its own, in one process and one thread."""

    name: str
    """Small letters, digits and hyphens."""
    version: str
    """The version of the rules. Change it with whatever changes results."""
    rules: str
    """The first part of a model's prompt: what the agent is, how the world works, what the actions do, what the feedback means."""
    actions: Sequence[str]
    """The words of the actions, small letters: at most 62."""
    letters: str = ""
    """A letter or digit for each action in logs; chosen by position if empty."""
    state: Sequence[Field]
    """The numbers of a state: at most 16."""
    state_sentence: str = ""
    """A state in a sentence of the prompt, `{name}` for a field; names and numbers if empty."""
    feedback: Sequence[str] = (
        "The episode has just begun.",
        "The action was carried out.",
        "The action changed nothing.",
        "Your last answer was not understood: nothing happened.",
    )
    """What an agent is told after an action. The first is for the begin, the last for an answer that could not be read."""
    tasks: Mapping[str, str] = {"task": "all tasks"}
    """The names of the kinds of tasks, and the groups that they are in."""
    failures: Mapping[str, str] = {}
    """Kinds of failure that the world has words for, and what they mean. `facts` can name one."""
    mismatches: Sequence[str] = ()
    """What `Episode.mismatch` may be, of `MISMATCHES`. `wording` is no business of `reset`: each case has a paraphrase then."""
    deterministic: bool = True
    """Whether the same actions lead from the same start to the same states and pictures, always and everywhere."""
    _cases: Mapping[str, Case] | None = None
    """The cases by id: those of the program, so that they are listed once and not for each lane."""

    @abstractmethod
    def cases(self) -> Iterable[Case]:
        """Returns the cases, always the same in the same order."""

    @abstractmethod
    def reset(self, episode: Episode) -> Observation:
        """Begins an episode. What it raises ends the episode without a result."""

    @abstractmethod
    def step(self, action: int) -> Observation:
        """Takes an action. Not called after the end of an episode."""

    @abstractmethod
    def render(self, pixels: NDArray[np.uint8]) -> None:
        """Draws what the agent sees now into `pixels`, of the shape (height, width, 4): red, green, blue and alpha, the first row at
        the top. The array is shared memory: fill it, and do not keep it."""

    def facts(self) -> Mapping[str, Any]:
        """Returns facts of the episode that has ended, for its record, of what JSON can hold. `failure`, a dict with `kind` and `step`,
        says in one of the words of `failures` why it failed."""
        return {}

    def _reset(self, case: str, start: str, blocked: bool, mismatch: str, seed: int) -> tuple[Any, ...]:
        if self._cases is None:
            self._cases = {listed.id: listed for listed in self.cases()}
        observation = self.reset(Episode(self._cases[case], start, blocked, seed, mismatch))
        return self._told("reset", observation, START)

    def _step(self, action: int) -> tuple[Any, ...]:
        observation = self.step(action)
        return self._told("step", observation)

    def _told(self, method: str, observation: Observation, feedback: int | None = None) -> tuple[Any, ...]:
        """The numbers of an observation, checked as far as this world does not do it later. `feedback` replaces its own."""
        if not isinstance(observation, Observation):
            raise WorldError(f"{method} returned {observation!r}, which is no Observation")
        state = [float(number) for number in observation.state]
        if not all(map(math.isfinite, state)):
            raise WorldError(f"{method}: the state {state} has a number that is not finite")
        return (
            state,
            _number(f"{method}: the feedback", observation.feedback if feedback is None else feedback, len(self.feedback)),
            _number(f"{method}: the number of sub-goals", observation.sub_goals, 2**32),
            _number(f"{method}: the number of sub-goals that are required", observation.required, 2**32),
            bool(observation.failed),
            bool(observation.conflict),
            None
            if observation.state_hash is None
            else _number(f"{method}: the hash of the state", observation.state_hash, 2**64),
        )

    def _render(self, pixels: Any) -> None:
        array = np.asarray(pixels)
        kept = weakref.ref(array)
        self.render(array)
        del array
        if kept() is not None:
            gc.collect()
        if kept() is not None:
            raise WorldError("render keeps the array that it was given, or a view of it: keep a copy instead")

    def _facts(self) -> str:
        facts = self.facts()
        try:
            return json.dumps(dict(facts), allow_nan=False, default=_plain)
        except (TypeError, ValueError) as error:
            raise WorldError(f"facts: {facts!r} cannot be written as JSON: {error}") from error


def _plain(value: Any) -> Any:
    """A number or an array of numpy as Python's own."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} is of type {type(value).__name__}")


def _number(name: str, value: Any, limit: int) -> int:
    """`value`, an integer from 0 to `limit` - 1."""
    try:
        number = operator.index(value)
    except TypeError:
        raise WorldError(f"{name} is {value!r}, not an integer") from None
    if not 0 <= number < limit:
        raise WorldError(f"{name} is {number}, not one of 0 to {limit - 1}")
    return number


def declaration(world: World) -> WorldDeclaration:
    """Returns what a world says of itself.

    Raises:
        WorldError: It lacks an attribute, or has not a letter for each action.
    """
    for name in ("name", "version", "rules", "actions", "state"):
        if not hasattr(world, name):
            raise WorldError(f"the world {type(world).__name__} has no `{name}`")
    for name in ("name", "version", "rules"):
        if not isinstance(getattr(world, name), str):
            raise WorldError(f"the `{name}` of the world {type(world).__name__} is {getattr(world, name)!r}, not a string")
    count = len(world.actions)
    letters = world.letters or (string.ascii_letters + string.digits)[:count]
    if len(letters) != count:
        raise WorldError(f"the world {world.name} has {count} actions, and letters for {len(letters)}")
    sentence = "State: " + ", ".join(f"{of.name} {{{of.name}}}" for of in world.state) + "."
    return WorldDeclaration(
        name=world.name,
        version=world.version,
        rules=world.rules.strip(),
        actions=tuple(world.actions),
        letters=letters,
        state=tuple(world.state),
        state_sentence=world.state_sentence or sentence,
        feedback=tuple(world.feedback),
        deterministic=world.deterministic,
    )


def _case(world: World, case: Case) -> dict[str, Any]:
    of = f"case {case.id} of the world {world.name}"
    tasks = list(world.tasks)
    task = case.task or tasks[0]
    if task not in tasks:
        raise WorldError(f"{of}: its task {task!r} is none of {', '.join(tasks)}")
    for name in case.trajectories:
        if name not in TRAJECTORIES:
            raise WorldError(f"{of}: the trajectory {name!r} is none of {', '.join(TRAJECTORIES)}")
        if case.trajectories[name] is None:
            raise WorldError(f"{of}: its trajectory `{name}` is None: leave it out, or list its actions")
    for history in (*case.irrelevant, *case.confusable):
        if isinstance(history, str) or len(history) != 2:
            raise WorldError(f"{of}: its history {history!r} is no pair of the id of a case and the name of a demonstration")
        id, name = history
        if name not in _DEMONSTRATIONS:
            raise WorldError(f"{of}: its history {id} {name!r} is none of {', '.join(_DEMONSTRATIONS)}")
    return {
        "id": case.id,
        "task": 1 + tasks.index(task),
        "instruction": case.instruction,
        "paraphrase": case.paraphrase,
        "trajectories": {
            name: [_number(f"{of}: an action of `{name}`", action, len(world.actions)) for action in taken]
            for name, taken in case.trajectories.items()
        },
        "irrelevant": [list(history) for history in case.irrelevant],
        "confusable": [list(history) for history in case.confusable],
    }


def _tasks(world: World, cases: Sequence[Case]) -> dict[str, Any]:
    if not world.tasks:
        raise WorldError(f"the world {world.name} has no tasks")
    if not isinstance(world.tasks, Mapping):
        raise WorldError(f"the tasks of the world {world.name} are {world.tasks!r}, not a dict of tasks and their groups")
    for mismatch in world.mismatches:
        if mismatch not in MISMATCHES:
            raise WorldError(f"the mismatch {mismatch!r} of the world {world.name} is none of {', '.join(MISMATCHES)}")
    if "wording" in world.mismatches:
        for case in cases:
            if not case.paraphrase:
                raise WorldError(f"case {case.id} of the world {world.name} has no paraphrase, and `mismatches` has `wording`")
    numbered = enumerate(world.tasks.items(), start=1)
    return {
        "tasks": [{"number": number, "name": name, "group": group} for number, (name, group) in numbered],
        "failures": [{"name": name, "words": words} for name, words in world.failures.items()],
        "mismatches": list(world.mismatches),
        "cases": [_case(world, case) for case in cases],
    }


def main(world: Callable[[], World]) -> None:
    """Does what the program's arguments say with a world: `memtransfer run --world-cmd` adds them to its command. Exits with status 1
    and a message if that fails. `world` makes an instance; it is called for each lane."""
    # What is printed must not mix with answers.
    sys.stdout = sys.stderr
    try:
        if isinstance(world, World):
            raise WorldError(f"main needs what makes the world for each lane: {type(world).__name__}, not {type(world).__name__}()")
        one = world()
        declared = declaration(one).json()
        cases = list(one.cases())
        tasks = json.dumps(_tasks(one, cases))
        by_id = {case.id: case for case in cases}

        def of_lane() -> World:
            made = world()
            made._cases = by_id
            return made

        # Where it reads standard input, no Python code runs while it waits, so no Python handler would.
        if sys.argv[1:2] != ["serve"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        with terminated():
            _native.world_main(of_lane, declared, tasks, sys.argv[1:])
    except WorldError as error:
        print(f"memtransfer: {error}", file=sys.stderr)
        sys.exit(1)
