"""Fields are taken from where they lie. That the structures lie as in Rust is asserted when they are imported."""

from __future__ import annotations

from memtransfer import _wire
from memtransfer._layout import layout, repeated


def test_a_layout_takes_the_fields_that_ctypes_shows() -> None:
    message = _wire.Observation(episode=5, frame=1 << 40, lane=3, step=9, feedback=2, last=1)
    message.pose.x = 7
    taken = layout(_wire.Observation, "episode", "frame", "lane", "pose", "feedback", "last")
    assert taken.unpack(bytes(message)) == (5, 1 << 40, 3, bytes([7, 0, 0, 0]), 2, 1)
    again = _wire.Observation.from_buffer_copy(taken.pack(5, 1 << 40, 3, bytes([7]), 2, 1))
    assert (again.episode, again.pose.x, again.step, again.last) == (5, 7, 0, 1)


def test_a_repeated_layout_takes_rows() -> None:
    rows = (_wire.PastStep * 2)(_wire.PastStep(8, 1, 2), _wire.PastStep(9, 3, 4))
    none, _, both = repeated(_wire.PastStep, 2, "frame", "action", "feedback")
    assert both.unpack(bytes(rows)) == (8, 1, 2, 9, 3, 4)
    assert none.unpack(b"") == ()
