"""What a policy is given for one step of one episode, and what it answers. Plain objects: build them
yourself to test a policy without a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from memtransfer._frames import Frame
from memtransfer._wire import Action, DocumentKind, Feedback, Heading, Outcome


@dataclass(frozen=True, slots=True)
class Pose:
    """Where an agent stands and which way it faces."""

    x: int
    """Column, growing east."""
    y: int
    """Row, growing north."""
    heading: Heading

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.heading.name}"


@dataclass(frozen=True, slots=True)
class PastStep:
    """One past step of the running episode."""

    frame: Frame
    """The view before the action."""
    action: Action | None
    """What was done there; `None` when the answer could not be read."""
    feedback: Feedback
    """What the world said to it."""


@dataclass(frozen=True, slots=True)
class RememberedStep:
    """One view of a retrieved segment."""

    frame: Frame
    """The remembered view."""
    action: Action | None
    """What the expert did there; `None` at the end of the segment, and everywhere in one of images alone."""


@dataclass(frozen=True, slots=True)
class Segment:
    """What memory found for this step: the stored view nearest to the current one, and what followed."""

    distance: float
    """Cosine distance between the embeddings of the first remembered view and the current one."""
    steps: tuple[RememberedStep, ...]
    """The matched view, then the views that the expert's actions led to. Never empty."""


@dataclass(frozen=True, slots=True)
class Document:
    """A text that memory supplies as it stands."""

    id: int
    """Names the text. Good for caching what was read in it; which number it is means nothing."""
    kind: DocumentKind
    """Summary or semantic."""
    text: str


@dataclass(frozen=True, slots=True)
class DemonstrationStep:
    """One step of a demonstration that memory supplies whole."""

    frame: Frame | None
    """The view before the action, where it is a keyframe."""
    action: Action | None
    """What the expert did there; `None` at the end of the demonstration."""


Trajectory = tuple[DemonstrationStep, ...]
"""A demonstration from its start to its end: every action, and keyframes. Never empty."""


@dataclass(slots=True, eq=False)
class Request:
    """Everything that a policy may use to decide one step."""

    lane: int
    """The lane the episode runs in. For a policy's own book-keeping; it means nothing."""
    step: int
    """Steps taken so far."""
    episode: int
    """Names the episode: never used again within a run, and which number it is means nothing."""
    episode_seed: int
    """A policy that draws at random draws from this."""
    repeat: int
    """Which repetition of the run this is, from 1. Equal requests of one repetition are the same request,
    and may be given the same answer."""
    instruction: str
    """What is asked for, in English."""
    pose: Pose
    """Where the agent is."""
    feedback: Feedback
    """What the world said to the last action."""
    frame: Frame
    """What the agent sees."""
    window: Sequence[PastStep] = ()
    """The last steps, oldest first."""
    segment: Segment | None = None
    """What memory retrieved for this step, if it retrieves."""
    documents: Sequence[Document] = ()
    """Texts that memory supplies, in order."""
    trajectories: Sequence[Trajectory] = ()
    """Demonstrations that memory supplies whole."""
    starts_as_demonstrated: bool = False
    """Whether a demonstration is known to have started in the pose this episode started in."""

    def images(self) -> int:
        """Images in the request: the current view, the window's, the segment's and the keyframes."""
        retrieved = len(self.segment.steps) if self.segment else 0
        keyframes = sum(
            step.frame is not None for trajectory in self.trajectories for step in trajectory
        )
        return 1 + len(self.window) + retrieved + keyframes


@dataclass(frozen=True, slots=True)
class Usage:
    """What asking a language model took. `None`: nobody told."""

    prompt_tokens: int | None = None
    """Tokens of the prompt."""
    completion_tokens: int | None = None
    """Tokens of the answer."""
    cached_tokens: int | None = None
    """Tokens of the prompt that the server had computed before and took from its own cache."""
    image_tokens: int | None = None
    """Tokens of the prompt's images."""
    memory_tokens: int | None = None
    """Tokens of the prompt that are injected memory, an estimate."""
    attempts: int = 1
    """Requests that were sent, failed ones included."""
    replayed: bool = False
    """The reply is one that was kept from an earlier request: it cost nothing this time."""
    prompted_ns: int = 0
    """When the prompt was built (`time.monotonic_ns()`)."""
    sent_ns: int = 0
    """When the request was sent, the last time if several times; 0 where none was."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """For the prompt log: what was said to a model and what it said. Costs nothing where there is none."""

    messages: Sequence[Mapping[str, Any]]
    """The messages, as an OpenAI-compatible server takes them: `role`, and `content` that is a text or a list
    of parts. Of an image that is in them only its name is written into the entry."""
    reply: str | None = None
    """The reply, as it came; `None` where none did."""
    unread: str | None = None
    """Why no action could be read in it; `None` where one could."""

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
    """An answer in full. An `Action`, or an `Outcome` without one, is short for it."""

    action: Action | None
    """Do this. `None`: there is no action, and `outcome` says why."""
    outcome: Outcome = Outcome.ACTED
    """Without an action: UNREADABLE, EMPTY or REFUSED."""
    images: int | None = None
    """Images the policy was shown for it; `None`: all that the request holds."""
    usage: Usage | None = None
    """What asking a model took; `None` where none was asked."""
    exchange: Exchange | None = field(default=None, compare=False, repr=False)
    """What was said to a model and what it said, for the prompt log; `None` where none was asked."""

    def __post_init__(self) -> None:
        if (self.action is None) == (self.outcome is Outcome.ACTED):
            raise ValueError(
                f"a decision has an action and the outcome ACTED, or neither: {self.action!r} with "
                f"{self.outcome!r}"
            )


@dataclass(frozen=True, slots=True)
class Failed:
    """An answer that says: no decision can be had, for a reason that is not the policy's, such as a server
    that is down. The episode ends without a result, and is not scored.
    """

    why: str
    exchange: Exchange | None = field(default=None, compare=False, repr=False)
    """What was said to a model, for the prompt log."""


Answer = Action | Outcome | Decision | Failed | None
"""What a policy may answer to a request. `None` is `Outcome.UNREADABLE`."""
