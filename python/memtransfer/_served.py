"""A request as it is served: the parts that not every policy looks at are made when they are looked at."""

from __future__ import annotations

from typing import Any

from memtransfer._documents import ACTIONS, Published
from memtransfer._frames import Frame
from memtransfer._join import Lane, Observed, Recalled
from memtransfer._wire import Feedback
from memtransfer.errors import FrameGone
from memtransfer.request import PastStep, RememberedStep, Request, Segment

_FEEDBACKS = tuple(Feedback)


class ServedRequest(Request):
    """Fields that are not set yet are made by `__getattr__`, once."""

    __slots__ = ("_frames", "_images", "_published", "_recalled")

    def __init__(
        self,
        number: int,
        lane: Lane,
        observed: Observed,
        recalled: Recalled,
        frames: dict[int, Frame],
        published: list[Published],
    ) -> None:
        self.lane = number
        self.step = observed.step
        self.episode = lane.episode
        self.episode_seed = lane.seed
        self.repeat = lane.repeat
        self.instruction = lane.instruction
        self.pose = observed.pose
        self.feedback = observed.feedback
        self.frame = frames[observed.frame]
        self.starts_as_demonstrated = lane.starts_as_demonstrated
        self._recalled = recalled
        self._frames = frames
        self._published = published
        images = 1 + len(recalled.window) // 3 + len(recalled.segment) // 2
        for document in published:
            images += document.images
        self._images = images

    def images(self) -> int:
        return self._images

    def __getattr__(self, name: str) -> Any:
        make = _MAKERS.get(name)
        if make is None:
            raise AttributeError(f"a request has no {name!r}")
        try:
            value = make(self)
        except KeyError as missing:
            raise FrameGone(
                f"frame {missing} is gone: the request was answered before its {name} was looked at"
            ) from None
        setattr(self, name, value)
        return value

    def _make_window(self) -> tuple[PastStep, ...]:
        codes, frames = iter(self._recalled.window), self._frames
        return tuple(
            PastStep(frames[frame], ACTIONS[action], _FEEDBACKS[feedback])
            for frame, action, feedback in zip(codes, codes, codes)
        )

    def _make_segment(self) -> Segment | None:
        codes, frames = iter(self._recalled.segment), self._frames
        steps = tuple(
            RememberedStep(frames[frame], ACTIONS[action]) for frame, action in zip(codes, codes)
        )
        return Segment(self._recalled.distance, steps) if steps else None


_MAKERS: dict[str, Any] = {
    "window": ServedRequest._make_window,
    "segment": ServedRequest._make_segment,
    "documents": lambda request: tuple(
        document.text for document in request._published if document.text is not None
    ),
    "trajectories": lambda request: tuple(
        trajectory
        for document in request._published
        for trajectory in document.trajectories(request._frames)
    ),
}
