"""The frame store: every view lies once in shared memory, and is held here under its id.

# Why no view ever shows other pixels
A chunk of the store gets new pixels only when every holder of its sample has let go. A sample is held by
a `SharedPixels`, and that by the frame until its eviction, and by every numpy array that was ever made of
it (numpy keeps the object whose memory it shows). So an array that a policy keeps goes on showing what it
showed, and its chunk is not used again. A *frame* that was evicted has no pixels any more, and says so.

What a policy keeps too much of the simulator runs out of. That is noticed here (`hoarded`) before it
comes to that.
"""

from __future__ import annotations

import gc
import hashlib
import weakref
from ctypes import string_at
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from memtransfer import _wire
from memtransfer._attach import Attach
from memtransfer._layout import layout
from memtransfer.errors import FrameGone

if TYPE_CHECKING:
    from memtransfer._bus import Bus

_HEADER = layout(_wire.FrameHeader, "id", "width", "height", "content_hash")
_HEADER_BYTES = _HEADER.size
_EVICTION = layout(_wire.Eviction, "frame")


class SharedPixels:
    """A sample of shared memory that numpy can look at, read-only and without a copy."""

    __slots__ = ("__array_interface__", "__weakref__", "_sample")

    def __init__(self, sample: Any, shape: tuple[int, int, int]) -> None:
        self._sample = sample
        self.__array_interface__ = {
            "version": 3,
            "shape": shape,
            "typestr": "|u1",
            # The second says read-only, and numpy has no way to undo it.
            "data": (sample.payload_ptr, True),
        }


class Frame:
    """A view. Its pixels lie in shared memory and never change."""

    __slots__ = ("_owner", "_pixels", "content_hash", "height", "id", "width")

    id: int
    """Names the pixels. Good for caching what was seen in them, since it is never used again within a run;
    which number it is means nothing."""
    content_hash: bytes
    """First 16 bytes of the BLAKE3 hash of the pixels: equal pixels, equal hash, whatever the run."""
    width: int
    """Pixels in a row."""
    height: int
    """Rows."""

    def __init__(
        self, id: int, content_hash: bytes, width: int, height: int, owner: SharedPixels | None
    ) -> None:
        self.id = id
        self.content_hash = content_hash
        self.width = width
        self.height = height
        self._owner = owner
        self._pixels: NDArray[np.uint8] | None = None

    @classmethod
    def of(
        cls, pixels: NDArray[np.uint8], id: int = 1, content_hash: bytes | None = None
    ) -> Frame:
        """A frame of one's own pixels (height x width x 4), to test a policy with. Without a `content_hash`
        it gets another one than the harness would give it, which is as good.
        """
        height, width, channels = pixels.shape
        if channels != 4:
            raise ValueError(f"pixels have {channels} channels, and a frame has 4 (RGBA)")
        own = np.array(pixels, dtype=np.uint8, order="C")
        if content_hash is None:
            content_hash = hashlib.blake2b(own.data, digest_size=16).digest()
        frame = cls(id, content_hash, width, height, None)
        frame._pixels = own
        frame._pixels.setflags(write=False)
        return frame

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """RGBA, 8 bits each: an array of shape (height, width, 4), rows top to bottom. It shows the shared
        memory itself and cannot be written to; `frame.pixels.copy()` is one's own.

        An array that is kept keeps its piece of shared memory from being used again, and the run has few to
        spare: copy what is to be kept.

        Raises `FrameGone` when the run has let go of the frame, which it does not before every request
        that shows it has been answered.
        """
        pixels = self._pixels
        if pixels is None:
            if self._owner is None:
                raise FrameGone(
                    f"frame {self.id} is gone: the run has let go of it since the request that showed it "
                    "was answered; copy what you want to keep (frame.pixels.copy())"
                )
            pixels = self._pixels = np.asarray(self._owner)
        return pixels

    @property
    def is_gone(self) -> bool:
        """Whether the run has let go of the frame."""
        return self._pixels is None and self._owner is None

    def __repr__(self) -> str:
        return f"Frame({self.id}, {self.width} x {self.height})"


class FrameStore:
    """Every frame that is resident."""

    def __init__(self, bus: Bus) -> None:
        attach: Attach = bus.attach
        self._evictions = bus.receiver(_wire.Eviction)
        self._receiver = bus.frames()
        self._shape = (attach.height, attach.width, 4)
        self._pages = attach.pages
        self.frames: dict[int, Frame] = {}
        """By id. Look here first, and if something is missing call `take_waiting` and look again."""
        self.taken = 0
        """Frames that were ever taken hold of."""
        self._kept: list[weakref.ref[SharedPixels]] = []
        self.most_kept = attach.spare_chunks // 2
        """Evicted frames that may still be shown by something."""

    def take_waiting(self) -> list[str]:
        """Takes hold of the frames that wait; returns what was wrong with those that cannot be used."""
        bad = []
        while (sample := self._receiver.receive()) is not None:
            header = string_at(sample.user_header_ptr, _HEADER_BYTES)
            id, width, height, content_hash = _HEADER.unpack(header)
            rows, columns, _ = self._shape
            pages = sample.header.number_of_elements
            if (height, width) != (rows, columns) or pages != self._pages:
                bad.append(
                    f"frame {id} is {width} x {height} in {pages} pages instead of {columns} x {rows} "
                    f"in {self._pages}"
                )
            elif id == _wire.NO_FRAME or id in self.frames:
                names = "none" if id == _wire.NO_FRAME else "another"
                bad.append(f"a frame arrived under id {id}, which names {names}")
            else:
                owner = SharedPixels(sample, self._shape)
                self.frames[id] = Frame(id, content_hash, width, height, owner)
                self.taken += 1
        return bad

    def apply_evictions(self) -> list[str]:
        """Lets go of every frame that was evicted; returns what was wrong with frames that arrived."""
        bad: list[str] = []
        for message in self._evictions.drain():
            (id,) = _EVICTION.unpack(message)
            if id not in self.frames:
                # Never asked for, so still in the queue.
                bad += self.take_waiting()
            frame = self.frames.pop(id, None)
            if frame is not None:
                owner = frame._owner
                assert owner is not None
                kept = weakref.ref(owner)
                frame._owner = frame._pixels = owner = None
                if kept() is not None:
                    self._kept.append(kept)
        return bad

    def hoarded(self) -> int:
        """How many evicted frames something still shows, if they are so many that the simulator will run
        out of memory for new ones; otherwise 0.
        """
        if len(self._kept) <= self.most_kept:
            return 0
        self._forget_what_is_gone()
        if len(self._kept) > self.most_kept:
            # Some may be held by nothing but each other.
            gc.collect()
            self._forget_what_is_gone()
        return len(self._kept) if len(self._kept) > self.most_kept else 0

    def _forget_what_is_gone(self) -> None:
        self._kept = [kept for kept in self._kept if kept() is not None]

    def close(self) -> None:
        """Lets go of everything."""
        for frame in self.frames.values():
            frame._owner = frame._pixels = None
        self.frames.clear()
