"""The closed sets of values in requests and answers. Their codes are those of the wire."""

from __future__ import annotations

import enum


class _Code(enum.IntEnum):
    """A code with the words that prompts, logs and messages use for it."""

    words: str

    def __new__(cls, code: int, words: str) -> _Code:
        member = int.__new__(cls, code)
        member._value_ = code
        member.words = words
        return member


class Action(_Code):
    """One of the seven actions of a step."""

    FORWARD = 0, "move forward"
    """Moves one cell along the heading."""
    BACKWARD = 1, "move backward"
    """Moves one cell against the heading; the heading stays."""
    LEFT = 2, "move left"
    """Moves one cell to the left; the heading stays."""
    RIGHT = 3, "move right"
    """Moves one cell to the right; the heading stays."""
    TURN_LEFT = 4, "turn left"
    """Turns 90 degrees anticlockwise in place."""
    TURN_RIGHT = 5, "turn right"
    """Turns 90 degrees clockwise in place."""
    TURN_AROUND = 6, "turn around"
    """Turns 180 degrees in place."""


class Feedback(_Code):
    """The result of the last action. It never says whether a target was reached."""

    START = 0, "The episode has just begun."
    MOVED = 1, "You moved."
    TURNED = 2, "You turned."
    BLOCKED = 3, "Something blocks the way: you did not move."
    """The agent stayed in place; the step counts."""
    NOT_UNDERSTOOD = 4, "Your last answer was not understood: you did not move."
    """The policy's answer held no action. The agent stayed in place; the step counts."""


class Heading(_Code):
    """The direction the agent faces."""

    N = 0, "north"
    E = 1, "east"
    S = 2, "south"
    W = 3, "west"


class Outcome(_Code):
    """Whether an answer holds an action, and if not, why."""

    ACTED = 0, "acted"
    UNREADABLE = 1, "unreadable"
    """The answer holds text, but no action."""
    EMPTY = 2, "empty"
    """The answer holds no text."""
    REFUSED = 3, "refused"
    """The model refused to answer."""
    CUT_OFF = 4, "cut-off"
    """The answer was cut off at the bound on its tokens, before it named an action."""


class DocumentKind(_Code):
    """The kind of a document that memory supplies."""

    SUMMARY = 0, "summary"
    """Object locations, landmarks and routes."""
    SEMANTIC = 1, "semantic"
    """General knowledge about the warehouse and navigation."""
    TRAJECTORIES = 2, "trajectories"
    """Demonstrations. In a request they are segments, not documents."""
    NOTE = 3, "note"
    """A text of a memory that is not built in."""
