"""The request that a policy receives for one step of one episode, and the answer it returns.

All classes here are plain objects: build them yourself to test a policy without a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from memtransfer._native import Frame, Step
from memtransfer.codes import Action, DocumentKind, Feedback, Heading, Outcome


@dataclass(frozen=True, slots=True)
class Pose:
    """The position and heading of an agent."""

    x: int
    """Column, counted from the west."""
    y: int
    """Row, counted from the south."""
    heading: Heading

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.heading.name}"


@dataclass(frozen=True, slots=True)
class PastStep:
    """One of the last steps of the running episode."""

    frame: Frame
    """The view before the action."""
    action: Action | None
    """The action taken; `None` if the answer held none."""
    feedback: Feedback
    """The result of the action."""


@dataclass(frozen=True, slots=True)
class RememberedStep:
    """One step of a retrieved segment."""

    frame: Frame
    """The remembered view."""
    action: Action | None
    """The expert's action there; `None` at the end of the segment, and in segments without actions."""


@dataclass(frozen=True, slots=True)
class Segment:
    """The stored view closest to the current one, and the steps that followed it."""

    distance: float
    """The cosine distance between the embeddings of the first remembered view and the current view."""
    steps: tuple[RememberedStep, ...]
    """The matched view first. Never empty."""


@dataclass(frozen=True, slots=True)
class Document:
    """A text that memory supplies."""

    id: int
    """Identifies the text within the run: a key to cache what was read in it."""
    kind: DocumentKind
    text: str


@dataclass(frozen=True, slots=True)
class DemonstrationStep:
    """One step of a demonstration."""

    frame: Frame | None
    """The view before the action; `None` unless it is a keyframe."""
    action: Action | None
    """The expert's action there; `None` at the end of the demonstration."""


Trajectory: TypeAlias = tuple[DemonstrationStep, ...]
"""A whole demonstration: every action, and the keyframes. Never empty."""


@dataclass(slots=True, eq=False)
class Request:
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
    pose: Pose
    """The agent's position and heading."""
    feedback: Feedback
    """The result of the last action."""
    frame: Frame
    """The current view."""
    window: Sequence[PastStep] = ()
    """The last steps, oldest first."""
    segment: Segment | None = None
    """What memory retrieved for this step."""
    documents: Sequence[Document] = ()
    """Texts that memory supplies, in order."""
    trajectories: Sequence[Trajectory] = ()
    """Whole demonstrations that memory supplies."""
    starts_as_demonstrated: bool = False
    """Whether a demonstration is known to start in the pose in which this episode started."""

    def images(self) -> int:
        """Returns the number of images: the current view, the window's, the segment's and the keyframes."""
        retrieved = len(self.segment.steps) if self.segment else 0
        keyframes = sum(
            step.frame is not None for trajectory in self.trajectories for step in trajectory
        )
        return 1 + len(self.window) + retrieved + keyframes


class ServedRequest(Request):
    """A request of a run. Each field is read from the step when it is first used."""

    __slots__ = ("_step",)

    def __init__(self, step: Step) -> None:
        self._step = step

    def __getattr__(self, name: str) -> Any:
        # Called only for slots that are not set yet.
        value = self._step.field(name)
        setattr(self, name, value)
        return value

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
    attempts: int = 1
    """Requests sent to the server, failed ones included."""
    replayed: bool = False
    """Whether the reply was stored from an earlier request, so that it cost nothing this time."""
    prompted_ns: int = 0
    """When the prompt was complete (`time.monotonic_ns()`)."""
    sent_ns: int = 0
    """When the request was last sent; 0 if none was."""


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
    """An answer with its details. An `Action`, or an `Outcome` without an action, is its short form."""

    action: Action | None
    """The action to take; `None` if there is none, which `outcome` explains."""
    outcome: Outcome = Outcome.ACTED
    """UNREADABLE, EMPTY or REFUSED if there is no action."""
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


Answer: TypeAlias = Action | Outcome | Decision | Failed | None
"""What a policy may return for a request. `None` stands for `Outcome.UNREADABLE`."""
