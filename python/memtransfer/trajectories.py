"""The trajectories of a run, and the views of their poses.

    from memtransfer.trajectories import Recording

    recording = Recording("runs/quick-grounded")
    for episode in recording.iter_episodes():
        views = recording.views(episode)

A run folder holds poses and actions, and no images: views are rendered when they are asked for.
"""

from __future__ import annotations

import json
import operator
import os
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from memtransfer import _native
from memtransfer.codes import Action, Feedback, Heading

_ACTIONS, _FEEDBACK, _HEADINGS = tuple(Action), tuple(Feedback), tuple(Heading)


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """An episode of a run, or a demonstration. Step `t` is the moment after `t` actions."""

    id: str
    """The episode's key in the log, or `demonstration/START/CASE`."""
    case: str
    """The id of the case."""
    task: int
    """The task's number, 1 to 10."""
    instruction: str
    """The task in words."""
    start: str
    """The start: `original` or `new`, or which of the case's demonstrations it is."""
    variant: int
    """The number of the world that it took place in."""
    poses: NDArray[np.uint8]
    """Column, row and heading (see `Heading`) at every step, as (steps + 1, 3)."""
    feedback: tuple[Feedback, ...]
    """What the agent was told at every step."""
    actions: tuple[Action | None, ...]
    """One fewer than poses; `None` for an answer in which no action could be read: the agent stayed in place."""
    sub_goals: tuple[int, ...]
    """The steps at which sub-goals were completed."""
    required: int
    """The number of sub-goals of the task."""
    success: bool
    """Whether the last action completed the task."""
    failure: tuple[str, int] | None
    """The kind of failure, and the step of the event that its rule is about; the end where it is about none."""
    environment: tuple[str, str] | None
    """The start and the route with which the Gymnasium environment begins as it does. `None` where none does: in a stream, with a
    mismatch, and for a demonstration in another world."""
    closed: tuple[tuple[int, int], ...]
    """The closed cells, as column and row."""
    targets: tuple[tuple[str, str, tuple[int, int]], ...]
    """The items that the task is about: letter, name, and the cell before it."""
    reference: tuple[tuple[int, int], ...]
    """The cells of the expert's path from the same start."""
    record: dict[str, Any] | None
    """The episode's line in the log; `None` for a demonstration."""

    @property
    def headings(self) -> list[Heading]:
        """The heading at every step."""
        return [_HEADINGS[heading] for heading in self.poses[:, 2]]

    @property
    def decided(self) -> list[int]:
        """The steps at which an action was chosen: all but those whose answer could not be read."""
        return [step for step, action in enumerate(self.actions) if action is not None]

    @property
    def observed(self) -> list[int]:
        """The steps whose observations an environment gives that is asked for the actions that could be read: the start, and the step
        after each of them. At an answer that could not be read the agent stayed in place."""
        return [0, *(step + 1 for step in self.decided)]

    @property
    def unread(self) -> int:
        """The number of answers in which no action could be read."""
        return self.actions.count(None)


class Recording:
    """A run folder and the world that it took place in."""

    def __init__(
        self, folder: str | os.PathLike[str], frame_size: int | tuple[int, int] | None = None
    ) -> None:
        """Reads a run.

        Args:
            folder: The run's folder.
            frame_size: Width and height of a view in pixels, the width a multiple of 64; `None` for the run's own.

        Raises:
            FileNotFoundError: The folder holds no run.
            ValueError: The run cannot be read, for example because another version wrote it.
        """
        size = None if frame_size is None else sides(frame_size)
        self._run = _native.RecordedRun(folder, size)
        self.manifest: dict[str, Any] = json.loads(self._run.manifest())
        """The run's settings, versions and hashes."""

    @property
    def notices(self) -> list[str]:
        """What a user must know about the run, for example that the world's files have changed since."""
        return self._run.notices

    @property
    def policy_label(self) -> str:
        """The policy, and what its figures stand for where it is no model: `grounded, scripted stand-in`."""
        return self._run.policy_label

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height of a view in pixels."""
        return self._run.size_px

    def episodes(self) -> list[Trajectory]:
        """Returns the episodes that have a result, all of them, in the order of the log: that in which they ended."""
        return list(self.iter_episodes())

    def iter_episodes(self) -> Iterator[Trajectory]:
        """Reads the episodes that have a result one at a time, in the order of the log. Warns of each damaged line, which is left
        out."""
        episodes = self._run.episodes()
        for text in episodes:
            yield _trajectory(json.loads(text))
        for line in episodes.damaged:
            warnings.warn(f"damaged, left out: {line}", stacklevel=2)

    def demonstrations(self) -> list[Trajectory]:
        """Returns the demonstrations that the run's memories could be built from. Each ends with the step that completes the
        task, without the expert's turn towards the rack after it."""
        return [_trajectory(fields) for fields in json.loads(self._run.demonstrations())]

    def floor(self, variant: int) -> NDArray[np.bool_]:
        """Returns which cells of a world are free floor, as (rows, columns), row 0 in the south. Cells of a closed passage
        are not."""
        return np.array([[square == "." for square in row] for row in self._run.floor(variant)])

    def views(self, trajectory: Trajectory) -> NDArray[np.uint8]:
        """Renders the view at every step: what the policy was shown, which in a control run is not what is there; of a
        demonstration, what memory was given. As (steps + 1, height, width, 3), read-only."""
        width, height = self.frame_size
        pixels = self._run.views(trajectory.variant, trajectory.poses.tolist(), trajectory.record is not None)
        return np.frombuffer(pixels, np.uint8).reshape(-1, height, width, 3)


def sides(frame_size: int | Iterable[int]) -> tuple[int, int]:
    """Returns width and height, which may be given as one number for both."""
    both = frame_size if isinstance(frame_size, Iterable) else (frame_size, frame_size)
    try:
        width, height = map(operator.index, both)
    except (TypeError, ValueError) as error:
        raise TypeError(f"frame_size must be an integer, or width and height, not {frame_size!r}") from error
    if width < 1 or height < 1:
        raise ValueError(f"frame_size must be positive, not {frame_size!r}")
    return width, height


def _trajectory(fields: dict[str, Any]) -> Trajectory:
    actions = (None if code is None else _ACTIONS[code] for code in fields.pop("actions"))
    return Trajectory(
        poses=np.array(fields.pop("poses"), np.uint8),
        feedback=tuple(_FEEDBACK[code] for code in fields.pop("feedback")),
        actions=tuple(actions),
        **{name: _tuples(value) if isinstance(value, list) else value for name, value in fields.items()},
    )


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
