"""Documents: what memory supplies that is too large for a message, published once and then named by id."""

from __future__ import annotations

from ctypes import string_at
from itertools import groupby
from typing import TYPE_CHECKING

from memtransfer import _wire
from memtransfer._frames import Frame
from memtransfer._layout import layout
from memtransfer.request import DemonstrationStep, Document, Trajectory

if TYPE_CHECKING:
    from memtransfer._bus import Bus

_HEADER = layout(_wire.DocumentHeader, "id", "episode", "lane", "kind")
_STEP = layout(_wire.TrajectoryStep, "frame", "action", "trajectory")

ACTIONS: dict[int, _wire.Action | None] = {
    _wire.NO_ACTION: None,
    **{int(action): action for action in _wire.Action},
}
"""Every code that an action has on the wire, and what it means."""


class Published:
    """A document as it was received."""

    __slots__ = ("_demonstrations", "_shown", "episode", "frames", "lane", "text")

    def __init__(self, id: int, episode: int, lane: int, kind: int, content: bytes) -> None:
        """Raises `ValueError` when it is no document."""
        self.episode = episode
        self.lane = lane
        self.text: Document | None = None
        self.frames: frozenset[int] = frozenset()
        self._demonstrations: list[list[tuple[int, int, int]]] = []
        self._shown: tuple[Trajectory, ...] | None = None
        if kind == _wire.DocumentKind.TRAJECTORIES:
            self._read_trajectories(content)
        elif kind in (_wire.DocumentKind.SUMMARY, _wire.DocumentKind.SEMANTIC):
            self.text = Document(id, _wire.DocumentKind(kind), content.decode("utf-8"))
        else:
            raise ValueError(f"{kind} is not a document kind (0 summary, 1 semantic, 2 trajectories)")

    def _read_trajectories(self, content: bytes) -> None:
        if len(content) % _STEP.size:
            raise ValueError(f"{len(content)} bytes is not whole trajectory steps of 16 bytes")
        steps: list[tuple[int, int, int]] = list(_STEP.iter_unpack(content))
        for _, action, _ in steps:
            if action not in ACTIONS:
                raise ValueError(f"{action} is not an action (0 to 6)")
        numbers = [number for _, _, number in steps]
        if numbers != sorted(numbers):
            raise ValueError("a mixture of trajectories is not one after the other")
        self.frames = frozenset(frame for frame, _, _ in steps if frame != _wire.NO_FRAME)
        self._demonstrations = [list(run) for _, run in groupby(steps, key=lambda step: step[2])]

    @property
    def images(self) -> int:
        """Keyframes of its demonstrations."""
        return sum(
            frame != _wire.NO_FRAME for steps in self._demonstrations for frame, _, _ in steps
        )

    def trajectories(self, frames: dict[int, Frame]) -> tuple[Trajectory, ...]:
        """Its demonstrations, made once: frames keep their ids for as long as the document is named."""
        if self._shown is None:
            self._shown = tuple(
                tuple(
                    DemonstrationStep(
                        frames[frame] if frame != _wire.NO_FRAME else None, ACTIONS[action]
                    )
                    for frame, action, _ in steps
                )
                for steps in self._demonstrations
            )
        return self._shown


class DocumentStore:
    """Every document that can still be named."""

    def __init__(self, bus: Bus) -> None:
        self._receiver = bus.documents()
        self.documents: dict[int, Published] = {}

    def take_waiting(self) -> list[str]:
        """Takes the documents that wait; returns what was wrong with those that cannot be used."""
        bad = []
        while (sample := self._receiver.receive()) is not None:
            header = string_at(sample.user_header_ptr, _HEADER.size)
            content = string_at(sample.payload_ptr, sample.header.number_of_elements)
            # Given back before the next is taken: a receiver may hold one.
            del sample
            id, episode, lane, kind = _HEADER.unpack(header)
            if id == _wire.NO_DOCUMENT or id in self.documents:
                bad.append(f"document {id}: {id} is not an id that names no other document")
                continue
            try:
                self.documents[id] = Published(id, episode, lane, kind, content)
            except ValueError as problem:
                bad.append(f"document {id}: {problem}")
        return bad

    def begin(self, lane: int, episode: int) -> None:
        """Episode `episode` begins in `lane`: what belonged to the lane's earlier ones is forgotten."""
        # Tickets grow, and what belongs to a later episode has come early.
        over = [
            id
            for id, document in self.documents.items()
            if document.episode != 0 and document.lane == lane and document.episode < episode
        ]
        for id in over:
            del self.documents[id]
