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
a view or an expert's action that it was not given. The guide is `docs/memory.md` of the project.
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
    """One step of a demonstration.

    Attributes:
        state: The expert's state.
        action: The expert's action there, an `Action` in the warehouse; `None` at the end of the demonstration.
        feedback: The result of the action before, a `Feedback` in the warehouse.
        world: What the world says of itself.
    """

    state: Sequence[float]
    action: Action | int | None
    feedback: Feedback | int
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)


class _NoFrames(tuple[Frame, ...]):
    """The frames of demonstrations for a memory that has not declared that it looks at them."""

    __slots__ = ()

    def __getitem__(self, step: Any) -> Any:
        raise IndexError("there are no frames: set `frames = True` in the memory's class, with scope 'case'")


@dataclass(frozen=True, slots=True, eq=False)
class Demonstration(Sequence[DemonstrationStep]):
    """An expert's demonstration of a task: a sequence of steps, and the same steps as arrays.

    Demonstrations are numbered from 0, in the order of `Memory.build`; steps from 0 within a demonstration.

    Attributes:
        instruction: The demonstrated task, in English.
        states: (steps, numbers of a state): the expert's state at each step, whose numbers `world.state` names. In the
            warehouse column, row, heading.
        actions: (steps,): the number of the expert's action at each step, an `Action` in the warehouse; -1 at the end,
            where there is none.
        feedback: (steps,): the number of the feedback to the action before, a `Feedback` in the warehouse.
        embeddings: (steps, dimension): the embedding of the view at each step, of length 1. Read-only, and the run's
            own memory: nothing is copied. It has no columns if `Memory.embeddings` is false.
        frames: The view at each step, whose `pixels` are (height, width, 4), RGBA in 8 bits. Empty unless
            `Memory.frames` is true. Pixels are available while `Memory.build` runs: copy what you keep.
        world: What the world says of itself.
    """

    instruction: str
    states: NDArray[np.float32]
    actions: NDArray[np.int32]
    feedback: NDArray[np.int32]
    embeddings: NDArray[np.float32]
    frames: Sequence[Frame] = ()
    world: WorldDeclaration = WAREHOUSE

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
    """An episode that begins.

    Attributes:
        id: Identifies the episode within the run.
        lane: The lane the episode runs in. Episodes of several lanes run at the same time.
        instruction: The agent's task, in English.
        seed: The seed for memories that draw at random.
        repeat: The repetition of the run, from 1.
        image_budget: Maximum number of images in an answer.
        text_budget: Maximum number of bytes of text in an answer.
        learns: Whether the memory learns from the episode. If not, the episode must not change what it answers in later
            ones.
    """

    id: int
    lane: int
    instruction: str
    seed: int
    repeat: int
    image_budget: int
    text_budget: int
    learns: bool = False


@dataclass(frozen=True, slots=True)
class EpisodeEnd:
    """The end of an episode.

    Attributes:
        episode: Identifies the episode within the run.
        lane: The lane.
        demonstration: The number under which items can name the episode's steps from now on, as those of a
            demonstration; `None` unless the memory learns from the episode.
        success: Whether the task was completed; `None` if the memory is not told.
        sub_goals: The steps at which sub-goals were completed, in order; `None` if the memory is not told.
    """

    episode: int
    lane: int
    demonstration: int | None = None
    success: bool | None = None
    sub_goals: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class RecentStep(InState):
    """One of the agent's last steps.

    Attributes:
        frame: The view before the action.
        state: The state before the action.
        action: The action taken, an `Action` in the warehouse; `None` if the policy's answer held none.
        feedback: The result of the action, a `Feedback` in the warehouse.
        world: What the world says of itself.
    """

    frame: Frame
    state: Sequence[float]
    action: Action | int | None
    feedback: Feedback | int
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)


@dataclass(slots=True, eq=False)
class Query(InState):
    """The agent's state at a step of an episode.

    Attributes:
        episode: Identifies the episode within the run.
        lane: The lane the episode runs in.
        step: Number of steps taken so far.
        instruction: The agent's task, in English.
        state: The agent's state: the numbers that `world.state` names. In the warehouse it is a pose, column, row and
            heading: see `pose`.
        last_action: The action that led here, an `Action` in the warehouse; `None` at the start, and if the policy's
            answer held none.
        feedback: The result of the last action: a `Feedback` in the warehouse, elsewhere its number among
            `world.feedback`.
        frame: The current view, whose `pixels` are (height, width, 4), RGBA in 8 bits; `None` at the end of an episode,
            in `Memory.observe`.
        embedding: (dimension,): the embedding of the current view, of length 1; `None` at the end of an episode, and if
            `Memory.embeddings` is false.
        window: The last steps, oldest first; empty in `Memory.observe`.
        image_budget: Maximum number of images in the answer.
        text_budget: Maximum number of bytes of text in the answer.
        world: What the world says of itself.
    """

    episode: int
    lane: int
    step: int
    instruction: str
    state: Sequence[float]
    last_action: Action | int | None
    feedback: Feedback | int
    frame: Frame | None = None
    embedding: NDArray[np.float32] | None = None
    window: Sequence[RecentStep] = ()
    image_budget: int = 0
    text_budget: int = 0
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)


class ServedQuery(ReadWhenUsed, Query):
    """A query of a run. Each field is read from the step when it is first used."""

    __slots__ = ("_step",)


@dataclass(frozen=True, slots=True)
class Source:
    """Consecutive steps of a demonstration, as the origin of a text or of a part of a plan.

    Attributes:
        demonstration: Number of the demonstration.
        first: The first step.
        count: Maximum number of steps, which end with the demonstration; `None` for all.
    """

    demonstration: int
    first: int = 0
    count: int | None = None


@dataclass(frozen=True, slots=True)
class Text:
    """An item: a text.

    Attributes:
        text: The text.
        sources: The steps that the text is about; none if it is about the memory as a whole.
    """

    text: str
    sources: Sequence[Source] = ()

    def __post_init__(self) -> None:
        for source in self.sources:
            if not isinstance(source, Source):
                raise TypeError(f"sources are Source objects, not {source!r}: write Source(demonstration, first, count)")


@dataclass(frozen=True, slots=True)
class Steps:
    """An item: consecutive steps of a demonstration.

    Attributes:
        demonstration: Number of the demonstration.
        first: The first step.
        count: Maximum number of steps, which end with the demonstration; `None` for all. By default 7, as many as
            episodic memory supplies at the standard settings.
        views: Whether to supply the steps' views, or the ascending numbers of the steps whose views are supplied. Each
            view counts against the image budget.
        actions: Whether to supply the expert's actions. The last step is always supplied without one.
        distance: The distance between the first step and the query, if there is one. Prompts word it as a cosine
            distance of views, from 0 to 2: leave out one that means something else.
    """

    demonstration: int
    first: int = 0
    count: int | None = 7
    views: bool | Sequence[int] = True
    actions: bool = True
    distance: float | None = None


@dataclass(frozen=True, slots=True)
class View:
    """An item: one view of a demonstration, with a caption.

    Attributes:
        demonstration: Number of the demonstration.
        step: The step.
        caption: What the prompt says of it.
        distance: The distance between the view and the query, if there is one.
    """

    demonstration: int
    step: int
    caption: str = ""
    distance: float | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """An item: actions to take one after the other, from the state of the query on.

        Plan([Source(0, 5, 3), Action.TURN_LEFT, Source(1, 12)])

    plans the expert's actions at steps 5 to 7 of demonstration 0, a turn, and what the expert did from step 12 of demonstration 1
    to its end.

    Attributes:
        parts: In order, each a `Source`, for the expert's actions at its steps, or an action that the memory chose itself, by its
            number or its words, in the warehouse an `Action`. A step without an action, such as the last of a demonstration, adds
            none. At most 1024 actions.
    """

    parts: Sequence[Source | Action | int | str]

    def __post_init__(self) -> None:
        if isinstance(self.parts, str | Source | int):
            raise TypeError(f"parts is a list of Source objects and actions, not {self.parts!r}")


MemoryItem: TypeAlias = Text | Steps | View | Plan | str
"""What `Memory.recall` may return a list of. A `str` stands for a `Text` without sources."""


class Memory(ABC):
    """A memory of one bank of demonstrations. Subclass it and pass an instance, or the class, to `memtransfer.run`.

    A run has many banks: each gets a memory of its own, which is a deep copy of the instance, or a new instance of the
    class.

    Attributes:
        name: The name in conditions, logs and tables: 1 to 24 lower-case letters, digits and hyphens. If empty, the
            name of the class: `TopThree` is called `top-three`.
        version: The version, for the run's manifest.
        scope: What a bank holds: the demonstrations of one `case`, or those of `all` cases.
        embeddings: Whether the memory uses embeddings of views. If not, none are computed for it, which saves time.
        frames: Whether the memory looks at pixels of demonstrations. With scope `all` there are none.
        deterministic: Whether equal episodes get equal answers, whatever else the memory was asked.
        learns: Whether the memory learns from episodes of streams. If so, override `save` and `load`.
    """

    name: str = ""
    version: str = "1"
    scope: str = "case"
    embeddings: bool = True
    frames: bool = False
    deterministic: bool = True
    learns: bool = False

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
