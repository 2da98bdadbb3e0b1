"""A run without the harness: this process plays orchestrator, simulator and memory over the real bus."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import iceoryx2 as iox2
import numpy as np
from numpy.typing import NDArray

from memtransfer import Policy, _attach, _wire, serve
from memtransfer._bus import Bus, Sender

WATCHDOG_S = 30.0


def text(buffer: Any, length: int) -> str:
    return bytes(buffer)[:length].decode()


def fill(message: ctypes.Structure, **values: Any) -> ctypes.Structure:
    """`message` with `values`; a text goes into a field and its length beside it."""
    for name, value in values.items():
        if isinstance(value, str):
            value = value.encode()
            setattr(message, f"{name}_len", len(value))
        if isinstance(value, (bytes, list, tuple)):
            field = getattr(message, name)
            for index, element in enumerate(value):
                field[index] = element
        else:
            setattr(message, name, value)
    return message


class Peer:
    """The rest of a run. Use as a context manager."""

    def __init__(
        self,
        lanes: int = 2,
        width: int = 64,
        height: int = 16,
        capacity: int = 16,
        generation: int = 1,
        orchestrator_pid: int | None = None,
    ) -> None:
        self.root = Path(tempfile.mkdtemp(prefix="mtpy", dir="/tmp"))
        (self.root / "lock").touch()
        self.values: dict[str, Any] = {
            "wire_version": _wire.WIRE_VERSION,
            "prefix": f"mt{self.root.name[4:]}_".replace("-", "_")[:16],
            "generation": generation,
            "orchestrator_pid": orchestrator_pid or os.getpid(),
            "crew": ["policy"],
            "lanes": lanes,
            "window": 6,
            "frame": {"width": width, "height": height},
            "frame_capacity": capacity,
            "wait": {"spin_us": 0},
            "frame_control": "rendered",
        }
        self.write()
        self.bus: Bus | None = None
        self.join()

    def write(self, **changes: Any) -> None:
        self.values.update(changes)
        draft = self.root / "attach.json.new"
        draft.write_text(json.dumps(self.values))
        draft.rename(self.root / "attach.json")

    def join(self) -> None:
        """Joins the generation that `attach.json` names."""
        self.leave()
        attach = self.attach = _attach.read(self.root)
        bus = self.bus = Bus(attach, _wire.Role.ORCHESTRATOR)
        heard = (_wire.Decision, _wire.Hello, _wire.Complaint, _wire.Farewell)
        self.inbox = {message: bus.receiver(message) for message in heard}
        self.waiting: dict[type[ctypes.Structure], list[bytes]] = {}
        said = (_wire.PolicyBrief, _wire.Observation, _wire.Recall, _wire.Eviction, _wire.Stop)
        self.senders = {it: Sender(bus.service(it), it.__name__, 1) for it in said}
        self.bell = bus.bell(_wire.Role.POLICY)
        self.frames = self._publisher(
            bus.builder("frame")
            .publish_subscribe(iox2.Slice[_wire.Page])
            .user_header(_wire.FrameHeader)
            .payload_alignment(iox2.Alignment.new(4096)),
            subscribers=2,
            borrowed=attach.frame_chunks,
            buffer=attach.frame_chunks,
            length=attach.pages,
            chunks=attach.frame_chunks,
        )
        self.documents = self._publisher(
            bus.builder("document")
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .user_header(_wire.DocumentHeader),
            subscribers=1,
            borrowed=1,
            buffer=2 * attach.lanes + 64,
            length=16 << 10,
        )
        self.last_frame = 0

    @staticmethod
    def _publisher(
        builder: Any,
        subscribers: int,
        borrowed: int,
        buffer: int,
        length: int,
        chunks: int | None = None,
    ) -> Any:
        publisher = (
            builder.enable_safe_overflow(False)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(subscribers)
            .max_nodes(1 + subscribers)
            .subscriber_max_borrowed_samples(borrowed)
            .subscriber_max_buffer_size(buffer)
            .open_or_create()
            .publisher_builder()
            .initial_max_slice_len(length)
            .max_loaned_samples(1)
            .backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
        )
        if chunks is not None:
            publisher = publisher.override_sample_preallocation(chunks)
        return publisher.create()

    def leave(self) -> None:
        if self.bus is not None:
            self.inbox, self.senders = {}, {}
            del self.bell, self.frames, self.documents
            self.bus.leave()
            self.bus = None

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()
        shutil.rmtree(self.root)
        left = [name for name in os.listdir("/dev/shm") if name.startswith(self.attach.prefix)]
        for name in left:
            os.unlink(f"/dev/shm/{name}")

    def serve(self, policy: Policy) -> Serving:
        """Has `policy` serve in a thread."""
        return Serving(self, policy)

    def send(self, message: ctypes.Structure) -> None:
        self.senders[type(message)].send(bytes(message))

    def publish_frame(self, pixels: NDArray[np.uint8] | int) -> int:
        """A frame with `pixels`, or with every byte this number; its id."""
        attach = self.attach
        sample = self.frames.loan_slice_uninit(attach.pages)
        size = attach.width * attach.height * 4
        if isinstance(pixels, int):
            content = bytes([pixels]) * size
        else:
            content = pixels.tobytes()
        assert len(content) == size
        ctypes.memmove(sample.payload_ptr, content, size)
        self.last_frame += 1
        id = (attach.generation << 40) | self.last_frame
        header = fill(
            _wire.FrameHeader(),
            id=id,
            width=attach.width,
            height=attach.height,
            content_hash=[self.last_frame % 256] * 16,
        )
        ctypes.memmove(sample.user_header_ptr, bytes(header), 32)
        sample.assume_init().send()
        return id

    def publish_document(
        self, id: int, kind: int, content: bytes, episode: int = 0, lane: int = 0
    ) -> None:
        sample = self.documents.loan_slice_uninit(len(content))
        ctypes.memmove(sample.payload_ptr, content, len(content))
        header = fill(_wire.DocumentHeader(), id=id, episode=episode, lane=lane, kind=kind)
        ctypes.memmove(sample.user_header_ptr, bytes(header), 24)
        sample.assume_init().send()

    def brief(self, lane: int = 0, episode: int = 1, **values: Any) -> None:
        values.setdefault("instruction", "Find a blue barrel.")
        self.send(fill(_wire.PolicyBrief(), lane=lane, episode=episode, repeat=1, **values))

    def step(
        self,
        frame: int,
        lane: int = 0,
        episode: int = 1,
        step: int = 0,
        pose: tuple[int, int, int] = (3, 12, 1),
        feedback: int = 0,
        window: Iterable[tuple[int, int, int]] = (),
        segment: Iterable[tuple[int, int]] = (),
        documents: Iterable[int] = (),
    ) -> None:
        """Observation and recall of a step, and a ring."""
        self.send(
            _wire.Observation(
                lane=lane,
                episode=episode,
                step=step,
                frame=frame,
                pose=_wire.WirePose(*pose),
                feedback=feedback,
            )
        )
        recall = _wire.Recall()
        fill(recall, lane=lane, episode=episode, step=step, distance=0.25)
        for index, (view, action, said) in enumerate(window):
            recall.window[index].frame = view
            recall.window[index].action = action
            recall.window[index].feedback = said
            recall.window_len = index + 1
        for index, (view, action) in enumerate(segment):
            recall.segment[index].frame = view
            recall.segment[index].action = action
            recall.segment_len = index + 1
        for index, document in enumerate(documents):
            recall.documents[index] = document
            recall.documents_len = index + 1
        self.send(recall)
        self.bell.ring()

    def evict(self, *frames: int) -> None:
        for frame in frames:
            self.send(_wire.Eviction(frame))
        self.bell.ring()

    def stop(self) -> None:
        self.send(_wire.Stop())
        self.bell.ring()

    def await_(self, message: type[ctypes.Structure], count: int = 1) -> list[Any]:
        """The next messages of this type, `count` at least."""
        found: list[bytes] = []

        def look() -> bool:
            found.extend(self.waiting.pop(message, []))
            found.extend(self.inbox[message].drain())
            return len(found) >= count

        eventually(f"{count} x {message.__name__}", look)
        if message is _wire.Hello:
            # What somebody sends and then ends is kept for receivers that have looked since it began.
            for other, receiver in self.inbox.items():
                self.waiting.setdefault(other, []).extend(receiver.drain())
        return [message.from_buffer_copy(raw) for raw in found]


def eventually(what: str, look: Callable[[], object]) -> None:
    deadline = time.monotonic() + WATCHDOG_S
    while not look():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.001)


class Serving:
    """A policy that serves in a thread. Leaving the context tells it to stop, and raises what it raised."""

    def __init__(self, peer: Peer, policy: Policy) -> None:
        self.peer = peer
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self._serve, args=(policy,), daemon=True)
        self.farewell: Any = None

    def _serve(self, policy: Policy) -> None:
        try:
            serve(policy, self.peer.root)
        except BaseException as error:
            self.error = error

    def __enter__(self) -> Serving:
        self.thread.start()
        (self.hello,) = self.peer.await_(_wire.Hello)
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            return
        if self.error is None and self.thread.is_alive():
            self.peer.stop()
            (self.farewell,) = self.peer.await_(_wire.Farewell)
        self.end()

    def end(self) -> None:
        """Waits until serving has ended, by itself."""
        self.thread.join(WATCHDOG_S)
        assert not self.thread.is_alive(), "serving goes on"
        if self.error is not None:
            error, self.error = self.error, None
            raise error
