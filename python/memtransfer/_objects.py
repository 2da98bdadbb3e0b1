"""Serves objects of this process as the policy and the memories of a run that it has started.

For each object the run starts a small process, `_relay.py`, which tells this process the folder to join, and lives as long as the
object's service. The service is a thread of this process: objects of a notebook, or of a script without a main guard, cannot be moved
to another process. The native services release the interpreter while they wait.
"""

from __future__ import annotations

import logging
import os
import secrets
import shlex
import shutil
import socket
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, TypeAlias

from memtransfer import _native
from memtransfer._program import output_of
from memtransfer._relay import SOCKET
from memtransfer.errors import AttachError, BusError, RunError
from memtransfer.memory import Memory
from memtransfer.policy import Policy
from memtransfer.serving import code_of_object, described, maker_of

_PYTHON, _RELAY = "_MEMTRANSFER_PYTHON", "_MEMTRANSFER_RELAY"
"""Variables for the commands of objects, which are therefore the same in every installation."""

Served: TypeAlias = Policy | Memory | type[Memory]


def name_of(served: Served) -> str:
    """Returns the name of an object among those of its run: `policy`, or `memory` and its name."""
    return "policy" if isinstance(served, Policy) else f"memory {described(served)[0]}"


def command_of(served: Served) -> str:
    """Returns the command that stands for an object in a run."""
    words = " ".join(shlex.quote(word) for word in name_of(served).split(" ", 1))
    kind = served if isinstance(served, type) else type(served)
    # The last word is not used: reports say it in place of the command.
    object_in_words = f"an object of class {kind.__name__} of the calling program"
    return shlex.join(["sh", "-c", f'exec "${_PYTHON}" -IS "${_RELAY}" {words}', object_in_words])


class Objects:
    """The services of the objects of a run. A context manager: the services end with the run, and the socket with the context."""

    broken: threading.Event
    """Set once a service has ended with an exception that an object raised: that is no reason to start the run's processes again."""

    def __init__(self, objects: Sequence[Served]) -> None:
        self.broken = threading.Event()
        self._services = {name_of(served): _Service(served, self.broken) for served in objects}
        # An abstract address: nothing is left of it when this process is killed.
        self._address = f"memtransfer-{os.getpid()}-{secrets.token_hex(8)}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)

    @property
    def environment(self) -> dict[str, str]:
        """The variables that the run needs."""
        relay = Path(__file__).with_name("_relay.py")
        return {SOCKET: self._address, _PYTHON: sys.executable, _RELAY: str(relay)}

    @property
    def words(self) -> dict[str, str]:
        """By command of an object: what messages call it."""
        return {command_of(service.served): name for name, service in self._services.items()}

    @property
    def raised(self) -> BaseException | None:
        """The first exception that an object raised."""
        raised = (service.raised for service in self._services.values())
        return next((one for one in raised if one is not None), None)

    def __enter__(self) -> Objects:
        self._socket.bind(f"\0{self._address}")
        self._socket.listen()
        threading.Thread(target=self._accept, name="memtransfer relays", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        # Wakes the thread that accepts.
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def join(self, timeout_s: float) -> None:
        """Waits for services that still run once the run has ended: they notice it within a second, but one that hangs does not."""
        for service in self._services.values():
            service.ended.wait(timeout_s)

    def calls(self, least_s: float) -> list[str]:
        """Returns which objects have been called for at least so long, and what of them: `memory slow (build)`."""
        calls = ((name, service.call(least_s)) for name, service in self._services.items())
        return [f"{name} ({call})" for name, call in calls if call is not None]

    def remove_rest(self) -> None:
        """Removes what the run could not remove because objects used it, as soon as they have ended: in this thread if they have, or else in
        another."""
        if all(service.ended.is_set() for service in self._services.values()):
            self._remove_rest()
        else:
            threading.Thread(target=self._remove_rest, name="memtransfer rest", daemon=True).start()

    def _remove_rest(self) -> None:
        for service in self._services.values():
            service.ended.wait()
        # What cannot be removed here, the next run removes.
        with suppress(RunError):
            output_of(["clean"])
        for folder in {_run_of(service.folder) for service in self._services.values() if service.folder is not None}:
            # What is left is used by this process alone: by what an object has kept, such as the demonstrations of a memory in the traceback
            # of its exception. That stays mapped without names, which nothing would remove when this process ends. A run that is ended at
            # once removes its folder; an object that goes on makes names again that belong to none.
            shutil.rmtree(folder, ignore_errors=True)
            for name in Path("/dev/shm").glob(f"mt{folder.name}_*"):
                name.unlink(missing_ok=True)

    def _accept(self) -> None:
        while True:
            try:
                relay, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._attend, args=(relay,), name="memtransfer object", daemon=True).start()

    def _attend(self, relay: socket.socket) -> None:
        credentials = relay.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        _, user, _ = struct.unpack("3i", credentials)
        with relay.makefile("r", encoding="utf-8") as lines:
            name, folder = (lines.readline().rstrip("\n") for _ in range(2)) if user == os.getuid() else ("", "")
        service = self._services.get(name)
        if service is None or not folder:
            relay.close()
        else:
            service.serve(folder, relay)


def _run_of(folder: Path) -> Path:
    """Returns the folder of a run: that which a policy joins, or around that which a memory joins."""
    return folder.parent if folder.name.startswith("memory-") else folder


def _native_service(served: Served) -> Callable[[str, bool], None]:
    """Returns what serves an object in the folder of a run. It has no frame in Python: between `_Service._serve` and a method of the object
    is none."""
    code = code_of_object(served)
    if isinstance(served, Policy):
        return partial(_native.serve, served, code)
    return partial(_native.serve_memory, maker_of(served), (*described(served), code))


class _Service:
    """The service of one object."""

    def __init__(self, served: Served, broken: threading.Event) -> None:
        self.served = served
        self.folder: Path | None = None
        """The folder that the service has joined, in that of the run in shared memory."""
        self.raised: BaseException | None = None
        self.ended = threading.Event()
        self.ended.set()
        self._broken = broken
        self._native = _native_service(served)
        # The run may start its processes again: the service before ends within a second, unless the object hangs.
        self._turn = threading.Lock()
        self._relay: socket.socket | None = None
        self._thread: int | None = None
        self._call: tuple[FrameType | None, float] = (None, 0.0)

    def call(self, least_s: float) -> str | None:
        """Returns the name of the method of the object that runs now; `None` if none does, or none that an earlier call has seen at least so
        long ago."""
        frame = None if self._thread is None else sys._current_frames().get(self._thread)
        inner = None
        while frame is not None and frame.f_code is not _Service._serve.__code__:
            inner, frame = frame, frame.f_back
        if inner is None or frame is None:
            self._call = (None, 0.0)
            return None
        if self._call[0] is not inner:
            self._call = (inner, time.monotonic())
        return inner.f_code.co_name if time.monotonic() - self._call[1] >= least_s else None

    def serve(self, folder: str, relay: socket.socket) -> None:
        """Serves the object in this thread, until the run or its processes end."""
        with self._turn, relay:
            self.ended.clear()
            self._relay = relay
            self._thread, self.folder = threading.get_ident(), Path(folder)
            try:
                status = self._serve(folder)
                self.tell(f"\0{status}")
            finally:
                self._relay, self._thread, self._call = None, None, (None, 0.0)
                self.ended.set()

    def _serve(self, folder: str) -> int:
        """Returns the exit status of a process that would serve the object."""
        with _prints_of(self):
            try:
                self._native(folder, True)
            except (AttachError, BusError) as error:
                self.tell(f"memtransfer: {error}\n")
                return 2
            except BaseException as error:  # Whatever it is, the caller of `evaluate` raises it.
                self.note(error)
                self._broken.set()
                return 1
        return 0

    def note(self, raised: BaseException) -> None:
        """Keeps the first exception, and sends the traceback of each to the run's log."""
        self.raised = self.raised or raised
        self.tell("".join(traceback.format_exception(raised)))

    def tell(self, text: str) -> None:
        """Sends text to the run's log."""
        relay = self._relay
        with suppress(OSError):
            if relay is not None:
                relay.sendall(text.encode())


_LOGGER = logging.getLogger("memtransfer")
"""What the native services write to."""

_services: dict[int, _Service] = {}
"""By thread: the service that it runs."""

_hook_lock = threading.Lock()
_hook_before: list[Callable[[type[BaseException], BaseException, TracebackType | None], Any]] = []


def _hook(kind: type[BaseException], raised: BaseException, trace: TracebackType | None) -> None:
    service = _services.get(threading.get_ident())
    if service is None:
        _hook_before[0](kind, raised, trace)
    else:
        service.note(raised)


def _is_for_the_screen(record: logging.LogRecord) -> bool:
    service = _services.get(threading.get_ident())
    if service is not None:
        service.tell(f"{record.levelname}: {record.getMessage()}\n")
    return service is None


@contextmanager
def _prints_of(service: _Service) -> Generator[None, None, None]:
    """Gives `service` the exceptions and log messages of the native service that this thread runs. They would be printed: the native
    service calls `sys.excepthook` for each exception of an object, and a notebook would be full of them."""
    with _hook_lock:
        if not _services:
            _hook_before[:] = [sys.excepthook]
            sys.excepthook = _hook
            _LOGGER.addFilter(_is_for_the_screen)
        _services[threading.get_ident()] = service
    try:
        yield
    finally:
        with _hook_lock:
            del _services[threading.get_ident()]
            if not _services:
                _LOGGER.removeFilter(_is_for_the_screen)
                if sys.excepthook is _hook:
                    sys.excepthook = _hook_before[0]
