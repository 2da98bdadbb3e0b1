"""What a world says of itself: the meaning of states, actions and feedback.

The built-in world is the warehouse (`WAREHOUSE`). Its actions are the members of `Action`, its feedback those of `Feedback`, and a
state of it is a `Pose`. In any other world, actions and feedback are plain numbers: places in the lists of its declaration.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from memtransfer import _native
from memtransfer.codes import Action, Feedback, Heading

_ACTIONS, _FEEDBACK, _HEADINGS = tuple(Action), tuple(Feedback), tuple(Heading)


@dataclass(frozen=True, slots=True)
class Pose:
    """The position and heading of an agent."""

    x: int
    """Column, counted from the west."""
    y: int
    """Row, counted from the south."""
    heading: Heading

    @property
    def state(self) -> tuple[float, ...]:
        """The same as a state of the warehouse."""
        return float(self.x), float(self.y), float(self.heading)

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.heading.name}"


@dataclass(frozen=True, slots=True)
class Field:
    """A number of a state."""

    name: str
    words: Sequence[str] = ()
    """The words for 0, 1, 2 and so on, if it is a choice among some."""
    digits: int = 0
    """Digits after the point in prompts, where it is a number."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "words", tuple(self.words))


@dataclass(frozen=True, slots=True)
class WorldDeclaration:
    """What agents do, see and are told in a world, in words. All requests of a run have the same object."""

    name: str
    version: str
    rules: str
    """The first part of a model's prompt."""
    actions: tuple[str, ...]
    """The words of the actions: those of action 0, 1 and so on."""
    letters: str
    """The letters of the actions in logs."""
    state: tuple[Field, ...]
    """The numbers of a state."""
    state_sentence: str
    """A state in a sentence of the prompt, with `{name}` for a number."""
    feedback: tuple[str, ...]
    """The sentences of feedback 0, 1 and so on. The first is for the begin of an episode, the last for an answer that could not be
    read."""
    deterministic: bool
    """Whether the same actions lead from the same start to the same states and views."""

    def action_words(self, action: int) -> str:
        """Returns the words of an action.

        Raises:
            ValueError: The world has no such action.
        """
        if not 0 <= action < len(self.actions):
            raise ValueError(f"{action} is no action of the world {self.name}, which has {len(self.actions)}")
        return self.actions[action]

    def action(self, action: int) -> Action | int:
        """Returns an action as runs give it: an `Action` if the world has the warehouse's actions, otherwise the number."""
        return _ACTIONS[action] if self.actions == WAREHOUSE.actions else action

    def told(self, feedback: int) -> Feedback | int:
        """Returns a feedback as runs give it: a `Feedback` if the world has the warehouse's sentences, otherwise the number."""
        return _FEEDBACK[feedback] if self.feedback == WAREHOUSE.feedback else feedback

    def pose(self, state: Sequence[float]) -> Pose:
        """Returns the pose that a state is.

        Raises:
            AttributeError: States of this world are no poses.
        """
        if self.state != WAREHOUSE.state:
            names = ", ".join(field.name for field in self.state)
            raise AttributeError(
                f"the world {self.name} has no poses: its states have the numbers {names}, which are in `state`"
            )
        x, y, heading = (int(number) for number in state)
        if (x, y, heading) != tuple(state) or heading not in range(len(_HEADINGS)):
            raise AttributeError(f"the state {tuple(state)} is no pose")
        return Pose(x, y, _HEADINGS[heading])

    def sentence(self, state: Sequence[float]) -> str:
        """Returns a state in a sentence, as prompts have it."""
        values = {
            field.name: field.words[int(number)] if field.words else f"{number:.{field.digits}f}"
            for field, number in zip(self.state, state)
        }
        return re.sub(r"\{([^{}]*)\}", lambda name: values.get(name[1], name[0]), self.state_sentence)

    def json(self) -> str:
        """Returns the declaration as runs write it (`world.json`)."""
        return json.dumps(
            {
                "name": self.name,
                "version": self.version,
                "rules": self.rules,
                "actions": [{"letter": letter, "words": words} for letter, words in zip(self.letters, self.actions)],
                "state": [{"name": of.name, "words": list(of.words), "digits": of.digits} for of in self.state],
                "state_sentence": self.state_sentence,
                "feedback": list(self.feedback),
                "is_deterministic": self.deterministic,
            }
        )


@cache
def parse(text: str) -> WorldDeclaration:
    """Returns the declaration that runs write as `text`: the same object for the same text."""
    fields = json.loads(text)
    return WorldDeclaration(
        name=fields["name"],
        version=fields["version"],
        rules=fields["rules"],
        actions=tuple(action["words"] for action in fields["actions"]),
        letters="".join(action["letter"] for action in fields["actions"]),
        state=tuple(Field(of["name"], of.get("words", ()), of["digits"]) for of in fields["state"]),
        state_sentence=fields["state_sentence"],
        feedback=tuple(fields["feedback"]),
        deterministic=fields["is_deterministic"],
    )


WAREHOUSE = parse(_native.warehouse_declaration())
"""The built-in world."""


class InState:
    """The pose of what is in a state of a world, for worlds whose states are poses."""

    __slots__ = ()
    state: Sequence[float]
    world: WorldDeclaration

    @property
    def pose(self) -> Pose:
        """The agent's position and heading, in worlds whose states are poses, as in the warehouse.

        Raises:
            AttributeError: The world has no poses.
        """
        return self.world.pose(self.state)
