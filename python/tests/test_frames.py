"""Pixels are shared memory itself: not copied, not writable, and never another view's."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from peer import Peer, eventually, text

from memtransfer import _wire
from memtransfer import Action, Answer, Frame, FrameGone, Policy, Request
from memtransfer._wire import ComplaintKind


class Looks(Policy):
    """Hands its request to a function, in the middle of `act`."""

    def __init__(self, look: Callable[[Request], object]) -> None:
        self.look = look

    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        for request in batch:
            self.look(request)
        return [Action.FORWARD for _ in batch]


def mapping_of(address: int) -> tuple[str, str]:
    """Permissions and file of the memory mapping that an address of this process lies in."""
    with open("/proc/self/maps", encoding="utf-8") as maps:
        for line in maps:
            span, permissions, *_, path = line.split()
            start, end = (int(part, 16) for part in span.split("-"))
            if start <= address < end:
                return permissions, path
    raise AssertionError(f"nothing is mapped at {address:x}")


def test_pixels_are_shared_memory_and_nobody_writes_to_them() -> None:
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 256, (16, 64, 4), dtype=np.uint8)
    found: dict[str, object] = {}

    def look(request: Request) -> None:
        pixels = request.frame.pixels
        assert pixels is request.frame.pixels
        assert (pixels.shape, pixels.dtype) == ((16, 64, 4), np.uint8)
        assert np.array_equal(pixels, picture)
        found["address"] = pixels.ctypes.data
        # Every look is at the same bytes, and none of them is the array's own.
        assert not pixels.flags.owndata and not pixels[3:, :, :3].flags.owndata
        assert pixels[0].ctypes.data == pixels.ctypes.data
        found["mapping"] = mapping_of(pixels.ctypes.data)
        for write in (
            lambda: pixels.__setitem__((0, 0, 0), 1),
            lambda: pixels[2].fill(0),
            lambda: np.add(pixels, 1, out=pixels),
            lambda: pixels.setflags(write=True),
            lambda: pixels.view().setflags(write=True),
            lambda: np.asarray(request.frame._owner).setflags(write=True),
        ):
            with pytest.raises(ValueError):
                write()
        assert memoryview(pixels).readonly

    with Peer() as peer, peer.serve(Looks(look)) as serving:
        peer.brief()
        peer.step(peer.publish_frame(picture))
        peer.await_(_wire.Decision)
        assert serving.error is None
        permissions, path = found["mapping"]  # type: ignore[misc]
        # The chunk of the simulator's segment, which this process maps without the right to write.
        assert path.startswith(f"/dev/shm/{peer.attach.prefix}") and path.endswith(".data")
        assert permissions == "r--s"
        address = found["address"]
        assert isinstance(address, int) and address % 4096 == 0


def test_what_is_kept_shows_what_it_showed_and_a_frame_that_is_gone_says_so() -> None:
    frames: list[Frame] = []
    kept: list[NDArray[np.uint8]] = []

    def look(request: Request) -> None:
        frames.append(request.frame)
        if request.step == 0:
            # A part of a part: numpy keeps what the memory belongs to all the same.
            kept.append(request.frame.pixels[4:8, :, :3][1:])

    with Peer(capacity=4) as peer, peer.serve(Looks(look)):
        peer.brief()
        first = peer.publish_frame(17)
        peer.step(first)
        peer.await_(_wire.Decision)
        peer.evict(first)
        # Far more frames than there are chunks: all but the kept one are used again and again.
        for step in range(1, 3 * peer.attach.frame_chunks):
            frame = peer.publish_frame(200)
            peer.step(frame, step=step)
            peer.await_(_wire.Decision)
            peer.evict(frame)
        eventually("the last eviction", lambda: frames[-1].is_gone)
        assert (kept[0] == 17).all()
        for frame_object in frames:
            with pytest.raises(FrameGone, match=r"frame \d+ is gone: .* copy what you want to keep"):
                frame_object.pixels  # noqa: B018
        address = kept[0].ctypes.data
        assert mapping_of(address)[1].startswith("/dev/shm/")


def test_a_request_that_is_kept_says_when_it_is_too_late() -> None:
    requests: list[Request] = []
    with Peer() as peer, peer.serve(Looks(requests.append)):
        now, past = peer.publish_frame(1), peer.publish_frame(2)
        peer.brief()
        peer.step(now, window=[(past, 0, 1)])
        peer.await_(_wire.Decision)
        peer.evict(now, past)
        eventually("the evictions", lambda: requests[0].frame.is_gone)
        with pytest.raises(FrameGone, match="before its window was looked at"):
            requests[0].window  # noqa: B018


def test_hoarding_is_said_before_the_simulator_has_no_memory_left() -> None:
    hoard: list[NDArray[np.uint8]] = []

    with Peer(capacity=16) as peer, peer.serve(Looks(lambda it: hoard.append(it.frame.pixels))):
        most = peer.attach.spare_chunks // 2
        peer.brief()
        for step in range(most + 1):
            frame = peer.publish_frame(1)
            peer.step(frame, step=step)
            peer.await_(_wire.Decision)
            peer.evict(frame)
        (complaint,) = peer.await_(_wire.Complaint)
        assert complaint.kind == ComplaintKind.RUN
        said = text(complaint.text, complaint.text_len)
        assert f"still holds the pixels of {most + 1} frames" in said
        assert "frame.pixels.copy()" in said
        # There still was a chunk for another one.
        peer.publish_frame(2)


def test_what_was_kept_and_let_go_is_no_hoard() -> None:
    last: list[NDArray[np.uint8]] = []

    def look(request: Request) -> None:
        last[:] = [request.frame.pixels]

    with Peer(capacity=16) as peer, peer.serve(Looks(look)):
        peer.brief()
        for step in range(2 * peer.attach.spare_chunks):
            frame = peer.publish_frame(1)
            peer.step(frame, step=step)
            peer.await_(_wire.Decision)
            peer.evict(frame)
        time.sleep(0.01)
        assert peer.await_(_wire.Complaint, 0) == []


def test_frames_that_are_not_what_the_run_agreed_on() -> None:
    with Peer() as peer, peer.serve(Looks(lambda _: None)):
        peer.brief()
        good = peer.publish_frame(1)
        peer.last_frame -= 1
        again = peer.publish_frame(2)
        assert again == good
        peer.step(good)
        (complaint,) = peer.await_(_wire.Complaint)
        assert text(complaint.text, complaint.text_len) == (
            f"a frame arrived under id {good}, which names another"
        )
        peer.await_(_wire.Decision)


def test_a_frame_of_one_s_own() -> None:
    picture = np.zeros((2, 3, 4), dtype=np.uint8)
    frame = Frame.of(picture, id=5)
    picture[:] = 9
    assert (frame.id, frame.width, frame.height) == (5, 3, 2)
    assert not frame.pixels.any() and not frame.pixels.flags.writeable
    with pytest.raises(ValueError, match="3 channels"):
        Frame.of(np.zeros((2, 2, 3), dtype=np.uint8))
