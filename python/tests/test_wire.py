"""The structures are as long as the wire says, and their fields lie where they should."""

from __future__ import annotations

import ctypes

import pytest

from memtransfer import _wire
from memtransfer._layout import layout, repeated


@pytest.mark.parametrize(
    ("message", "size"),
    [
        (_wire.Observation, 72),
        (_wire.PolicyBrief, 264),
        (_wire.Eviction, 8),
        (_wire.Recall, 1104),
        (_wire.Decision, 112),
        (_wire.Hello, 512),
        (_wire.Complaint, 512),
        (_wire.Farewell, 48),
        (_wire.Stop, 8),
        (_wire.FrameHeader, 32),
        (_wire.DocumentHeader, 24),
        (_wire.Page, 4096),
        (_wire.PastStep, 16),
        (_wire.SegmentStep, 16),
        (_wire.TrajectoryStep, 16),
    ],
)
def test_sizes(message: type[ctypes.Structure], size: int) -> None:
    assert ctypes.sizeof(message) == size
    name: str = message.type_name()  # type: ignore[attr-defined]
    assert name == f"memtransfer.{message.__name__}"


def test_a_layout_takes_the_fields_that_ctypes_shows() -> None:
    message = _wire.Observation(episode=5, frame=1 << 40, lane=3, step=9, feedback=2, last=1)
    message.pose[0] = 7
    taken = layout(_wire.Observation, "episode", "frame", "lane", "pose", "feedback", "last")
    assert taken.unpack(bytes(message)) == (5, 1 << 40, 3, bytes([7, 0, 0, 0]), 2, 1)
    again = _wire.Observation.from_buffer_copy(taken.pack(5, 1 << 40, 3, bytes([7]), 2, 1))
    assert (again.episode, again.pose[0], again.step, again.last) == (5, 7, 0, 1)


def test_a_repeated_layout_takes_rows() -> None:
    rows = (_wire.PastStep * 2)(_wire.PastStep(8, 1, 2), _wire.PastStep(9, 3, 4))
    none, _, both = repeated(_wire.PastStep, 2, "frame", "action", "feedback")
    assert both.unpack(bytes(rows)) == (8, 1, 2, 9, 3, 4)
    assert none.unpack(b"") == ()
