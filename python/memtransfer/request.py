"""The request that a policy receives for one step of one episode, and the answer it returns.

All classes here are plain objects: build them yourself to test a policy without a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypeAlias

from memtransfer._native import Frame, MemoryStep, Step
from memtransfer.codes import Action, DocumentKind, Feedback, Outcome
from memtransfer.declaration import WAREHOUSE, InState, WorldDeclaration


@dataclass(frozen=True, slots=True)
class PastStep:
    """One of the last steps of the running episode."""

    frame: Frame
    """The view before the action."""
    action: Action | int | None
    """The action taken, an `Action` in the warehouse; `None` if the answer held none."""
    feedback: Feedback | int
    """The result of the action, a `Feedback` in the warehouse."""


@dataclass(frozen=True, slots=True)
class Document:
    """An item of memory: a text."""

    id: int
    """Identifies the text within the run: a key to cache what was read in it."""
    kind: DocumentKind
    """Summary, semantic or note."""
    text: str


@dataclass(frozen=True, slots=True)
class RememberedStep:
    """One step of a demonstration."""

    frame: Frame | None
    """The view before the action; `None` if it is not supplied. Demonstrations have their keyframes only."""
    action: Action | int | None
    """The expert's action there, an `Action` in the warehouse; `None` at the end of the segment, and in segments without actions."""


Trajectory: TypeAlias = tuple[RememberedStep, ...]
"""The steps of a whole demonstration: every action, and the keyframes. Never empty."""


@dataclass(frozen=True, slots=True)
class Segment:
    """An item of memory: consecutive steps of a demonstration."""

    distance: float | None
    """The distance between what was retrieved and the query; `None` if memory tells none. For episodic memory, the
    cosine distance between the embeddings of the first view and the current view."""
    instruction: str
    """The task of the demonstration, in English: that of this episode, or another."""
    steps: tuple[RememberedStep, ...]
    """The steps, in order. Never empty."""
    is_whole: bool = False
    """Whether these are all steps of the demonstration."""

    @property
    def is_trajectory(self) -> bool:
        """Whether this is a demonstration that is supplied whole, and was not retrieved by its distance."""
        return self.is_whole and self.distance is None


@dataclass(frozen=True, slots=True)
class RememberedView:
    """An item of memory: a view with a caption."""

    frame: Frame
    caption: str
    """The caption; may be empty."""
    instruction: str
    """The task of the demonstration that shows the view, in English."""


@dataclass(frozen=True, slots=True)
class PlannedActions:
    """A part of a plan: actions that come from the same place."""

    actions: tuple[Action | int, ...]
    """The actions, each an `Action` in the warehouse. Never empty."""
    instruction: str | None = None
    """The task of the demonstration in which an expert took them, in English; `None` if memory chose them itself."""


@dataclass(frozen=True, slots=True)
class SuppliedPlan:
    """An item of memory: actions that it proposes to take one after the other, from this step on."""

    parts: tuple[PlannedActions, ...]
    """Its parts, in order. Never empty."""

    @property
    def actions(self) -> tuple[Action | int, ...]:
        """The actions of all parts."""
        return tuple(action for part in self.parts for action in part.actions)


Item: TypeAlias = Document | Segment | RememberedView | SuppliedPlan
"""What memory supplies for a step is a list of items."""


@dataclass(slots=True, eq=False)
class Request(InState):
    """Everything a policy may use to decide one step."""

    lane: int
    """The lane the episode runs in. Use it only to keep state apart."""
    step: int
    """Number of steps taken so far."""
    episode: int
    """Identifies the episode within the run."""
    episode_seed: int
    """The seed for policies that draw at random."""
    repeat: int
    """The repetition of the run, from 1. Equal requests of one repetition may be given the same answer."""
    instruction: str
    """The task, in English."""
    state: Sequence[float]
    """The agent's state: the numbers that `world.state` names. In the warehouse it is a pose: see `pose`."""
    feedback: Feedback | int
    """The result of the last action: a `Feedback` in the warehouse, elsewhere its number among `world.feedback`."""
    frame: Frame
    """The current view."""
    window: Sequence[PastStep] = ()
    """The last steps, oldest first."""
    items: Sequence[Item] = ()
    """What memory supplies, the most important first."""
    starts_as_demonstrated: bool = False
    """Whether a demonstration is known to start in the pose in which this episode started."""
    demonstrated_elsewhere: bool = False
    """Whether the demonstrations are known to have taken place in another warehouse."""
    world: WorldDeclaration = field(default=WAREHOUSE, repr=False)
    """What the world says of itself."""

    @property
    def documents(self) -> Sequence[Document]:
        """The texts among the items."""
        return [item for item in self.items if isinstance(item, Document)]

    @property
    def segments(self) -> Sequence[Segment]:
        """The retrieved segments among the items. Episodic memory supplies these."""
        segments = [item for item in self.items if isinstance(item, Segment)]
        return [segment for segment in segments if not segment.is_trajectory]

    @property
    def segment(self) -> Segment | None:
        """The first of the retrieved segments; `None` if there is none."""
        return next(iter(self.segments), None)

    @property
    def trajectories(self) -> Sequence[Trajectory]:
        """The demonstrations that memory supplies whole. Full-context memory supplies these."""
        segments = [item for item in self.items if isinstance(item, Segment)]
        return [segment.steps for segment in segments if segment.is_trajectory]

    @property
    def plans(self) -> Sequence[SuppliedPlan]:
        """The plans among the items."""
        return [item for item in self.items if isinstance(item, SuppliedPlan)]

    def images(self) -> int:
        """Returns the number of images: the current view, the window's and those of the items."""
        steps = [step for item in self.items if isinstance(item, Segment) for step in item.steps]
        views = sum(isinstance(item, RememberedView) for item in self.items)
        return 1 + len(self.window) + sum(step.frame is not None for step in steps) + views


class ReadWhenUsed:
    """Reads each field from the step when it is first used. Its subclasses have the slot `_step`, and a dataclass as their
    other base: the class of their copies.
    """

    __slots__ = ()
    _step: Any

    def __init__(self, step: Step | MemoryStep) -> None:
        self._step = step

    def __getattr__(self, name: str) -> Any:
        # Called only for slots that are not set yet. `copy` and `pickle` look up special methods before `_step` is set.
        if name.startswith("_"):
            raise AttributeError(name)
        value = self._step.field(name)
        setattr(self, name, value)
        return value

    def __reduce__(self) -> tuple[Any, ...]:
        _, plain = type(self).__bases__
        return plain, tuple(getattr(self, field.name) for field in fields(plain))


class ServedRequest(ReadWhenUsed, Request):
    """A request of a run. Each field is read from the step when it is first used."""

    __slots__ = ("_step",)
    _step: Step

    def images(self) -> int:
        return self._step.images


@dataclass(frozen=True, slots=True)
class Usage:
    """The cost of asking a language model. `None` means not measured."""

    prompt_tokens: int | None = None
    """Tokens of the prompt."""
    completion_tokens: int | None = None
    """Tokens of the reply."""
    cached_tokens: int | None = None
    """Tokens of the prompt that the server took from its cache."""
    image_tokens: int | None = None
    """Tokens of the prompt's images."""
    memory_tokens: int | None = None
    """Tokens of the prompt that memory supplied; an estimate."""
    reusable_tokens: int | None = None
    """Tokens of the prompt that a server with a prefix cache can reuse; an estimate."""
    attempts: int = 1
    """Requests sent to the server, failed ones included."""
    replayed: bool = False
    """Whether the reply was stored from an earlier request, so that it cost nothing this time."""
    prompted_ns: int = 0
    """When the prompt was complete (`time.monotonic_ns()`)."""
    sent_ns: int = 0
    """When the request was last sent; 0 if none was."""
    finish_reason: str | None = None
    """Why the reply ended, in the server's terms, such as `stop` or `length`. The log keeps 46 bytes."""
    reasoned: bool | None = None
    """Whether the model reasoned before it answered."""
    model: str | None = None
    """The model that the reply names. The log keeps 128 bytes."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A conversation with a model, for the prompt log. Ignored in runs without `--log-prompts`."""

    messages: Sequence[Mapping[str, Any]]
    """The messages in the format of OpenAI-compatible servers: `role`, and `content` that is a text or a list
    of parts. The log stores each image once."""
    reply: str | None = None
    """The model's reply; `None` if there was none."""
    unread: str | None = None
    """Why no action could be read in the reply; `None` if one could."""

    def __post_init__(self) -> None:
        for message in self.messages:
            if not isinstance(message, Mapping):
                raise TypeError(
                    f"a message of an exchange is a {type(message).__name__}, but must be a mapping with "
                    "role and content"
                )
        for name in ("reply", "unread"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise TypeError(f"{name} of an exchange is a {type(value).__name__}, but must be text")


@dataclass(frozen=True, slots=True)
class Decision:
    """An answer with its details. An action, or an `Outcome` without an action, is its short form."""

    action: Action | int | str | None
    """The action to take: an `Action` in the warehouse; its number or its words in any world. `None` if there is none, which
    `outcome` explains."""
    outcome: Outcome = Outcome.ACTED
    """UNREADABLE, EMPTY, REFUSED or CUT_OFF if there is no action."""
    images: int | None = None
    """Images shown to the model; `None` for all of the request's."""
    usage: Usage | None = None
    """The cost of asking a model; `None` if none was asked."""
    exchange: Exchange | None = field(default=None, compare=False, repr=False)
    """The conversation with the model, for the prompt log."""

    def __post_init__(self) -> None:
        if (self.action is None) == (self.outcome is Outcome.ACTED):
            raise ValueError(
                f"a decision has an action and the outcome ACTED, or neither: {self.action!r} with "
                f"{self.outcome!r}"
            )


@dataclass(frozen=True, slots=True)
class Failed:
    """No decision is possible for a reason outside the policy, such as a server that is down. The episode
    ends without a result and is not scored; the same command runs it again.
    """

    why: str
    exchange: Exchange | None = field(default=None, compare=False, repr=False)
    """The conversation with the model, for the prompt log."""


Answer: TypeAlias = Action | int | str | Outcome | Decision | Failed | None
"""What a policy may return for a request: an action, which can be given by its number or its words, an outcome without an action,
or one of both with its details. `None` stands for `Outcome.UNREADABLE`."""
