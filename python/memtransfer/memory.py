"""The memory interface: what a memory is given, and the items it supplies.

    from memtransfer import Memory, Steps, run

    class Nearest(Memory):
        def build(self, demonstrations):
            self.demonstrations = demonstrations

        def recall(self, query):
            similar = [d.embeddings @ query.embedding for d in self.demonstrations]
            number = max(range(len(similar)), key=lambda number: similar[number].max())
            return [Steps(number, first=similar[number].argmax())]

    run(Nearest())

A memory names steps of demonstrations by number. The run looks up their views and actions, so a memory cannot supply
anything that it was not given. The guide is `docs/memory.md` of the project.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from memtransfer._native import Frame
from memtransfer.codes import Action, Feedback
from memtransfer.declaration import WAREHOUSE, InState, WorldDeclaration
from memtransfer.request import ReadWhenUsed

if TYPE_CHECKING:
    # A policy needs no NumPy, which takes longer to import than everything else here.
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class DemonstrationStep(InState):
    """One step of a demonstration."""

    state: Sequence[float]
    """The expert's state."""
    action: Action | int | None
    """The expert's action there, an `Action` in the warehouse; `None` at the end of the demonstration."""
    feedback: Feedback | int
    """The result of the action before, a `Feedback` in the warehouse."""
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)
    """What the world says of itself."""


class _NoFrames(tuple[Frame, ...]):
    """The frames of demonstrations for a memory that has not declared that it looks at them."""

    __slots__ = ()

    def __getitem__(self, step: Any) -> Any:
        raise IndexError("there are no frames: set `frames = True` in the memory's class, with scope 'case'")


@dataclass(frozen=True, slots=True, eq=False)
class Demonstration(Sequence[DemonstrationStep]):
    """An expert's demonstration of a task: a sequence of steps, and the same steps as arrays.

    Demonstrations are numbered from 0, in the order of `Memory.build`; steps from 0 within a demonstration.
    """

    instruction: str
    """The demonstrated task, in English."""
    states: NDArray[np.float32]
    """By step: the numbers of the expert's state, which `world.state` names."""
    actions: NDArray[np.int32]
    """By step: the number of the expert's action; -1 at the end, where there is none."""
    feedback: NDArray[np.int32]
    """By step: the number of the feedback to the action before."""
    embeddings: NDArray[np.float32]
    """By step: the embedding of the view, of length 1. Read-only, and the run's own memory: nothing is copied. It has
    no columns if `Memory.embeddings` is false."""
    frames: Sequence[Frame] = ()
    """By step: the view. Empty unless `Memory.frames` is true. Pixels are available while `Memory.build` runs: copy
    what you keep."""
    world: WorldDeclaration = WAREHOUSE
    """What the world says of itself."""

    def __post_init__(self) -> None:
        if not self.frames:
            object.__setattr__(self, "frames", _NoFrames())

    def __len__(self) -> int:
        return len(self.states)

    @property
    def poses(self) -> NDArray[np.int32]:
        """By step: column (from the west), row (from the south), and the code of the heading, in worlds whose states are poses.

        Raises:
            AttributeError: The world has no poses.
        """
        for state in self.states[:1]:
            self.world.pose(state.tolist())
        import numpy as np

        return self.states.astype(np.int32)

    def __getitem__(self, step: Any) -> Any:
        if isinstance(step, slice):
            return [self[number] for number in range(*step.indices(len(self)))]
        action = int(self.actions[step])
        return DemonstrationStep(
            tuple(self.states[step].tolist()),
            None if action < 0 else self.world.action(action),
            self.world.told(int(self.feedback[step])),
            self.world,
        )

    def __iter__(self) -> Iterator[DemonstrationStep]:
        return (self[step] for step in range(len(self)))

    def route(self) -> str:
        """Returns the demonstration as text: the task, the start, the actions, and the end.

        It is in the grammar of summaries (`docs/documents.md` of the project), which the policy `grounded` reads. For example

            ## "Find a blue barrel."
            - start: You are in column 14, row 11, and face south.
            - move forward 3, turn right, move forward 5
            - end: You are in column 9, row 8, and face west.
        """
        taken: list[str] = []
        for step in range(len(self) - 1):
            words = self.world.action_words(int(self.actions[step]))
            if (self.states[step] == self.states[step + 1]).all():
                words += f' ("{self.world.feedback[self.feedback[step + 1]]}")'
            taken.append(words)
        rows = [(words, len(list(row))) for words, row in groupby(taken)]
        actions = ", ".join(words if times == 1 else f"{words} {times}" for words, times in rows)
        start, end = (self.world.sentence(self.states[step].tolist()) for step in (0, -1))
        lines = [f'## "{self.instruction}"', f"- start: {start}", f"- {actions}", f"- end: {end}"]
        return "\n".join(line for line in lines if line != "- ")


@dataclass(frozen=True, slots=True)
class Episode:
    """An episode that begins."""

    id: int
    """Identifies the episode within the run."""
    lane: int
    """The lane the episode runs in. Episodes of several lanes run at the same time."""
    instruction: str
    """The agent's task, in English."""
    seed: int
    """The seed for memories that draw at random."""
    repeat: int
    """The repetition of the run, from 1."""
    image_budget: int
    """Maximum number of images in an answer."""
    text_budget: int
    """Maximum number of bytes of text in an answer."""
    learns: bool = False
    """Whether the memory learns from the episode. If not, the episode must not change what it answers in later ones."""


@dataclass(frozen=True, slots=True)
class EpisodeEnd:
    """The end of an episode."""

    episode: int
    """Identifies the episode within the run."""
    lane: int
    """The lane."""
    demonstration: int | None = None
    """The number under which items can name the episode's steps from now on, as those of a demonstration; `None` unless
    the memory learns from the episode."""
    success: bool | None = None
    """Whether the task was completed; `None` if the memory is not told."""
    sub_goals: tuple[int, ...] | None = None
    """The steps at which sub-goals were completed, in order; `None` if the memory is not told."""


@dataclass(frozen=True, slots=True)
class RecentStep(InState):
    """One of the agent's last steps."""

    frame: Frame
    """The view before the action."""
    state: Sequence[float]
    """The state before the action."""
    action: Action | int | None
    """The action taken, an `Action` in the warehouse; `None` if the policy's answer held none."""
    feedback: Feedback | int
    """The result of the action, a `Feedback` in the warehouse."""
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)
    """What the world says of itself."""


@dataclass(slots=True, eq=False)
class Query(InState):
    """The agent's state at a step of an episode."""

    episode: int
    """Identifies the episode within the run."""
    lane: int
    """The lane the episode runs in."""
    step: int
    """Number of steps taken so far."""
    instruction: str
    """The agent's task, in English."""
    state: Sequence[float]
    """The agent's state: the numbers that `world.state` names. In the warehouse it is a pose: see `pose`."""
    last_action: Action | int | None
    """The action that led here, an `Action` in the warehouse; `None` at the start, and if the policy's answer held none."""
    feedback: Feedback | int
    """The result of the last action: a `Feedback` in the warehouse, elsewhere its number among `world.feedback`."""
    frame: Frame | None = None
    """The current view; `None` at the end of an episode, in `Memory.observe`."""
    embedding: NDArray[np.float32] | None = None
    """The embedding of the current view, of length 1; `None` at the end of an episode, and if `Memory.embeddings` is
    false."""
    window: Sequence[RecentStep] = ()
    """The last steps, oldest first; empty in `Memory.observe`."""
    image_budget: int = 0
    """Maximum number of images in the answer."""
    text_budget: int = 0
    """Maximum number of bytes of text in the answer."""
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)
    """What the world says of itself."""


class ServedQuery(ReadWhenUsed, Query):
    """A query of a run. Each field is read from the step when it is first used."""

    __slots__ = ("_step",)


@dataclass(frozen=True, slots=True)
class Source:
    """Consecutive steps of a demonstration, as the origin of a text."""

    demonstration: int
    """Number of the demonstration."""
    first: int = 0
    """The first step."""
    count: int | None = None
    """Maximum number of steps, which end with the demonstration; `None` for all."""


@dataclass(frozen=True, slots=True)
class Text:
    """An item: a text."""

    text: str
    sources: Sequence[Source] = ()
    """The steps that the text is about; none if it is about the memory as a whole."""

    def __post_init__(self) -> None:
        for source in self.sources:
            if not isinstance(source, Source):
                raise TypeError(f"sources are Source objects, not {source!r}: write Source(demonstration, first, count)")


@dataclass(frozen=True, slots=True)
class Steps:
    """An item: consecutive steps of a demonstration."""

    demonstration: int
    """Number of the demonstration."""
    first: int = 0
    """The first step."""
    count: int | None = 7
    """Maximum number of steps, which end with the demonstration; `None` for all. By default as many as episodic memory
    supplies at the standard settings."""
    views: bool | Sequence[int] = True
    """Whether to supply the steps' views, or the ascending numbers of the steps whose views are supplied. Each view counts
    against the image budget."""
    actions: bool = True
    """Whether to supply the expert's actions. The last step is always supplied without one."""
    distance: float | None = None
    """The distance between the first step and the query, if there is one. Prompts word it as a cosine distance
    of views, from 0 to 2: leave out one that means something else."""


@dataclass(frozen=True, slots=True)
class View:
    """An item: one view of a demonstration, with a caption."""

    demonstration: int
    """Number of the demonstration."""
    step: int
    """The step."""
    caption: str = ""
    distance: float | None = None
    """The distance between the view and the query, if there is one."""


MemoryItem: TypeAlias = Text | Steps | View | str
"""What `Memory.recall` may return a list of. A `str` stands for a `Text` without sources."""


class Memory(ABC):
    """A memory of one bank of demonstrations. Subclass it and pass an instance, or the class, to `memtransfer.run`.

    A run has many banks: each gets a memory of its own, which is a deep copy of the instance, or a new instance of the
    class.
    """

    name: str = ""
    """The name in conditions, logs and tables: 1 to 24 lower-case letters, digits and hyphens. If empty, the name of
    the class: `TopThree` is called `top-three`."""
    version: str = "1"
    """The version, for the run's manifest."""
    scope: str = "case"
    """What a bank holds: the demonstrations of one `case`, or those of `all` cases."""
    embeddings: bool = True
    """Whether the memory uses embeddings of views."""
    frames: bool = False
    """Whether the memory looks at pixels of demonstrations. With scope `all` there are none."""
    deterministic: bool = True
    """Whether equal episodes get equal answers, whatever else the memory was asked."""
    learns: bool = False
    """Whether the memory learns from episodes of streams. If so, override `save` and `load`."""

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        """Builds the memory, once, before anything else."""

    def begin_episode(self, episode: Episode) -> None:
        """Called when an episode begins. Episodes of several lanes can use the same memory at the same time."""

    def observe(self, step: Query) -> None:
        """Called at each step of an episode before `recall`, and at the end of the episode, where `frame` is `None`."""

    @abstractmethod
    def recall(self, query: Query) -> Sequence[MemoryItem]:
        """Returns what to supply for a step: at most 8 items, the most important first; an empty list for nothing.

        An item that does not fit into what is left of the image or text budget is dropped whole.
        """

    def end_episode(self, end: EpisodeEnd) -> None:
        """Called when an episode is over, or was given up."""

    def save(self, folder: Path) -> None:
        """Writes what the memory has learned into an empty folder: all that `load` needs beside the demonstrations."""

    def load(self, folder: Path) -> None:
        """Restores what `save` has written. Called after `build` with the same demonstrations. From then on the memory
        has to answer as the one that was saved."""

    def store_bytes(self) -> int | None:
        """Returns the size of what the memory stores, if it is known."""
        return None

    def tokens(self) -> int | None:
        """Returns the tokens of the memory's own requests to a model in the last `recall`, if it counts them."""
        return None
