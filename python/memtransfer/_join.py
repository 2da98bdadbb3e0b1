"""Joining what belongs together: a lane's brief, its observation and the recall for the same step.

Pure: the bytes of messages in, complete steps out. Messages are input from other processes, so each is
checked here, and a bad one is a `BadMessage` that names the value and leaves everything as it was.
"""

from __future__ import annotations

import struct

from memtransfer import _wire
from memtransfer._documents import ACTIONS
from memtransfer._layout import layout, place, repeated
from memtransfer.request import Pose

_BRIEF = layout(
    _wire.PolicyBrief,
    "episode",
    "seed",
    "lane",
    "instruction_len",
    "repeat",
    "starts_as_demonstrated",
    "instruction",
)
_OBSERVATION = layout(
    _wire.Observation, "episode", "frame", "lane", "step", "pose", "feedback", "last"
)
_RECALL = layout(
    _wire.Recall,
    "episode",
    "lane",
    "step",
    "distance",
    "window_len",
    "segment_len",
    "documents_len",
    "documents",
)
_WINDOW_AT, _ = place(_wire.Recall, "window")
_WINDOW = repeated(_wire.PastStep, _wire.MAX_WINDOW, "frame", "action", "feedback")
_SEGMENT_AT, _ = place(_wire.Recall, "segment")
_SEGMENT = repeated(_wire.SegmentStep, _wire.MAX_SEGMENT, "frame", "action")
_IDS = [struct.Struct(f"<{count}Q") for count in range(_wire.MAX_DOCUMENTS + 1)]

_FEEDBACKS = tuple(_wire.Feedback)
_KNOWN_ACTIONS = frozenset(ACTIONS)
_KNOWN_FEEDBACKS = frozenset(int(feedback) for feedback in _FEEDBACKS)


class BadMessage(ValueError):
    """A message cannot be used: which, and why."""


class Observed:
    """What an observation says."""

    __slots__ = ("feedback", "frame", "pose", "step")

    def __init__(self, step: int, frame: int, pose: Pose, feedback: _wire.Feedback) -> None:
        self.step = step
        self.frame = frame
        self.pose = pose
        self.feedback = feedback


class Recalled:
    """What a recall says. Window and segment are as on the wire: frame, action and (window) feedback of one
    entry after the other. Their codes have been checked.
    """

    __slots__ = ("distance", "documents", "segment", "step", "window")

    def __init__(
        self,
        step: int,
        distance: float,
        window: tuple[int, ...],
        segment: tuple[int, ...],
        documents: tuple[int, ...],
    ) -> None:
        self.step = step
        self.distance = distance
        self.window = window
        self.segment = segment
        self.documents = documents


class Lane:
    """The running episode of a lane, and what has come for its current step."""

    __slots__ = (
        "episode",
        "instruction",
        "observed",
        "recalled",
        "repeat",
        "running",
        "seed",
        "starts_as_demonstrated",
    )

    def __init__(self) -> None:
        self.episode = 0
        self.seed = 0
        self.repeat = 0
        self.instruction = ""
        self.starts_as_demonstrated = False
        self.running = False
        self.observed: Observed | None = None
        self.recalled: Recalled | None = None


class Join:
    """All lanes of a run."""

    def __init__(self, lanes: int) -> None:
        self.lanes = [Lane() for _ in range(lanes)]
        self._touched: set[int] = set()
        self._poses: dict[bytes, Pose] = {}

    def brief(self, message: bytes) -> tuple[int, int]:
        """A new episode for a lane; whatever the lane had is dropped. Returns lane and episode."""
        episode, seed, lane, length, repeat, hint, instruction = _BRIEF.unpack(message)
        number = self._number("policy brief", lane)
        try:
            if length > len(instruction):
                raise ValueError
            text = instruction[:length].decode("utf-8")
        except ValueError:
            raise BadMessage(
                f"policy brief for lane {lane}, step 0: a text of {length} bytes is not UTF-8 that fits"
            ) from None
        fresh = Lane()
        fresh.episode, fresh.seed, fresh.repeat = episode, seed, repeat
        fresh.instruction, fresh.starts_as_demonstrated = text, hint != 0
        fresh.running = True
        self.lanes[number] = fresh
        return lane, episode

    def observation(self, message: bytes) -> None:
        """What is true after a step. One that comes late, for an episode that is over, is dropped."""
        episode, frame, number, step, pose, feedback, last = _OBSERVATION.unpack(message)
        lane = self.lanes[self._number("observation", number)]
        if not lane.running or lane.episode != episode:
            return
        if last:
            self.lanes[number] = Lane()
            return
        if frame == _wire.NO_FRAME:
            raise BadMessage(f"observation for lane {number}, step {step}: it names no frame")
        where = self._poses.get(pose)
        if where is None:
            where = self._pose(pose, number, step)
        if feedback not in _KNOWN_FEEDBACKS:
            raise BadMessage(
                f"observation for lane {number}, step {step}: {feedback} is not a feedback (0 to 4)"
            )
        lane.observed = Observed(step, frame, where, _FEEDBACKS[feedback])
        self._touched.add(number)

    def recall(self, message: bytes) -> None:
        """What memory gives for a step. Late ones are dropped."""
        episode, number, step, distance, past, views, papers, ids = _RECALL.unpack(message)
        lane = self.lanes[self._number("recall", number)]
        if not lane.running or lane.episode != episode:
            return
        if past > _wire.MAX_WINDOW or views > _wire.MAX_SEGMENT or papers > _wire.MAX_DOCUMENTS:
            raise _too_many(number, step, past, views, papers)
        window = _WINDOW[past].unpack_from(message, _WINDOW_AT)
        segment = _SEGMENT[views].unpack_from(message, _SEGMENT_AT)
        if not (
            _KNOWN_ACTIONS.issuperset(window[1::3])
            and _KNOWN_FEEDBACKS.issuperset(window[2::3])
            and _KNOWN_ACTIONS.issuperset(segment[1::2])
        ):
            raise _unknown_code(number, step, window, segment)
        documents = _IDS[papers].unpack_from(ids) if papers else ()
        lane.recalled = Recalled(step, distance, window, segment, documents)
        self._touched.add(number)

    def take_ready(self) -> list[tuple[int, Lane, Observed, Recalled]]:
        """Takes every step that has its observation and its recall, by lane."""
        ready = []
        for number in sorted(self._touched):
            lane = self.lanes[number]
            observed, recalled = lane.observed, lane.recalled
            if observed is not None and recalled is not None and observed.step == recalled.step:
                lane.observed = lane.recalled = None
                ready.append((number, lane, observed, recalled))
        self._touched = {number for number in self._touched if self.lanes[number].recalled}
        return ready

    @property
    def is_half(self) -> bool:
        """Whether a recall is here whose observation is not. That is on its way, and rings no bell."""
        return bool(self._touched)

    def _number(self, message: str, lane: int) -> int:
        if lane >= len(self.lanes):
            raise BadMessage(f"{message} for lane {lane}: the run has {len(self.lanes)}")
        return lane

    def _pose(self, pose: bytes, lane: int, step: int) -> Pose:
        x, y, heading, _ = pose
        try:
            where = Pose(x, y, _wire.Heading(heading))
        except ValueError:
            raise BadMessage(
                f"observation for lane {lane}, step {step}: {heading} is not a heading (0 N, 1 E, 2 S, 3 W)"
            ) from None
        if len(self._poses) < 1 << 16:
            self._poses[pose] = where
        return where


def _too_many(lane: int, step: int, past: int, views: int, papers: int) -> BadMessage:
    counts = [
        (past, "past steps", _wire.MAX_WINDOW),
        (views, "remembered views", _wire.MAX_SEGMENT),
        (papers, "documents", _wire.MAX_DOCUMENTS),
    ]
    count, what, most = next(entry for entry in counts if entry[0] > entry[2])
    return BadMessage(f"recall for lane {lane}, step {step}: {count} {what}, at most {most} fit")


def _unknown_code(
    lane: int, step: int, window: tuple[int, ...], segment: tuple[int, ...]
) -> BadMessage:
    actions = [code for code in window[1::3] + segment[1::2] if code not in _KNOWN_ACTIONS]
    feedbacks = [code for code in window[2::3] if code not in _KNOWN_FEEDBACKS]
    wrong = (
        f"{actions[0]} is not an action (0 to 6)"
        if actions
        else f"{feedbacks[0]} is not a feedback (0 to 4)"
    )
    return BadMessage(f"recall for lane {lane}, step {step}: {wrong}")
