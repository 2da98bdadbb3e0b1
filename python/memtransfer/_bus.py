"""Joining a run, and one typed queue for each kind of message. The only module that knows iceoryx2.

The services are opened with the same numbers as by the Rust side (`shm-types/src/bus.rs`): whoever comes
first creates a service, and everybody else must ask for what is there.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import time
from ctypes import memmove, string_at
from typing import Any

import iceoryx2 as iox2

from memtransfer import _wire
from memtransfer._attach import Attach
from memtransfer.errors import AttachError, BusError

RECEIVERS_PATIENCE_S = 60.0
"""How long the first message on a service waits for its receivers."""

GONE_SENDERS = 16
"""Senders that may be gone and have left messages in the same receiver. Every look at a queue goes over a place for
each, so a large number makes every look slow."""

FAILURES: tuple[type[BaseException], ...] = tuple(
    value
    for name, value in vars(iox2).items()
    if isinstance(value, type) and issubclass(value, Exception) and not name.startswith("_")
)
"""What iceoryx2 raises: a class for each operation, and no common one."""


class Bus:
    """A process's place in a run. This package is the policy; its tests play the others."""

    def __init__(self, attach: Attach, role: _wire.Role = _wire.Role.POLICY) -> None:
        self.attach = attach
        self._membership = _hold(attach)
        iox2.set_log_level_from_env_or(iox2.LogLevel.Error)
        try:
            self._node = (
                iox2.NodeBuilder.new()
                .config(_config(attach))
                .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
                .create(iox2.ServiceType.Ipc)
            )
            # The bell before any receiver: a message that gets in finds a bell to ring.
            self._listener = self._doorbell(role).listener_builder().create()
        except iox2.ListenerCreateError as error:
            raise BusError(
                f"the run has a {role.words} already: only one can take part, so end one of the two, or "
                "give this one a run of its own"
            ) from error
        except FAILURES as error:
            raise BusError(f"cannot join the run in {attach.root}: {error}") from error

    def builder(self, name: str) -> Any:
        """A builder for this generation's service `name`."""
        full = f"{self.attach.generation}/{name}"
        return self._node.service_builder(iox2.ServiceName.new(full))

    def receiver(self, message: type[ctypes.Structure]) -> Receiver:
        """The receiving end for messages of this type."""
        route = _wire.SERVICES[message]
        try:
            subscriber = self.service(message).subscriber_builder().create()
        except FAILURES as error:
            raise BusError(f"cannot receive on {route.name}: {error}") from error
        most = self._queue_len(route) * len(route.senders)
        return Receiver(subscriber, route.name, ctypes.sizeof(message), most)

    def sender(self, message: type[ctypes.Structure]) -> Sender:
        """The sending end for messages of this type."""
        route = _wire.SERVICES[message]
        try:
            return Sender(self.service(message), route.name, self.attach.count(route.receivers))
        except FAILURES as error:
            raise BusError(f"cannot send on {route.name}: {error}") from error

    def frames(self) -> SliceReceiver:
        """The receiving end of the frame store: whole frames, as pages."""
        chunks = self.attach.frame_chunks
        # Before Python 3.13 ctypes knows the size of `Page` alone: its alignment is asked for beside it.
        builder = (
            self.builder(_wire.FRAME_SERVICE)
            .publish_subscribe(iox2.Slice[_wire.Page])
            .user_header(_wire.FrameHeader)
            .payload_alignment(iox2.Alignment.new(_wire.PAGE_BYTES))
        )
        return self._slices(builder, "frame", 2, 3, borrowed=chunks, buffer=chunks)

    def documents(self) -> SliceReceiver:
        """The receiving end of documents, as bytes."""
        builder = (
            self.builder(_wire.DOCUMENT_SERVICE)
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .user_header(_wire.DocumentHeader)
        )
        buffer = _wire.document_queue_len(self.attach.lanes)
        return self._slices(builder, "document", 1, 2, borrowed=1, buffer=buffer)

    def _slices(
        self, builder: Any, name: str, subscribers: int, nodes: int, *, borrowed: int, buffer: int
    ) -> SliceReceiver:
        try:
            service = (
                builder.enable_safe_overflow(False)
                .history_size(0)
                .max_publishers(1)
                .max_subscribers(subscribers)
                .max_nodes(nodes)
                .subscriber_max_borrowed_samples(borrowed)
                .subscriber_max_buffer_size(buffer)
                .open_or_create()
            )
            return SliceReceiver(service.subscriber_builder().create(), name)
        except FAILURES as error:
            raise BusError(f"cannot receive on {name}: {error}") from error

    def leave(self) -> None:
        """Lets the run go. Every receiver, sender and bell has to be gone before."""
        os.close(self._membership)

    def bell(self, of: _wire.Role) -> Bell:
        """The button to a neighbour's doorbell."""
        try:
            return Bell(self._doorbell(of).notifier_builder().create())
        except FAILURES as error:
            raise BusError(f"cannot reach the {of.words}'s doorbell: {error}") from error

    def wait(self, timeout_ms: int) -> bool:
        """Waits until somebody rings, for about so long at most; whether anybody rang. Look through all
        queues either way.
        """
        try:
            if self.attach.spin_us:
                spin_until = time.monotonic_ns() + 1000 * self.attach.spin_us
                while time.monotonic_ns() < spin_until:
                    if self._listener.try_wait():
                        return True
            return bool(self._listener.timed_wait(iox2.Duration.from_millis(timeout_ms)))
        except iox2.ListenerWaitError as error:
            if "Interrupt" in str(error):
                # A signal, whose handler has its turn when this returns.
                return False
            raise BusError(f"waiting at the doorbell: {error}") from error

    def service(self, message: type[ctypes.Structure]) -> Any:
        """The service that messages of this type travel on."""
        route = _wire.SERVICES[message]
        senders, receivers = len(route.senders), len(route.receivers)
        return (
            self.builder(route.name)
            .publish_subscribe(message)
            .enable_safe_overflow(False)
            .history_size(0)
            .max_publishers(senders)
            .max_subscribers(receivers)
            .max_nodes(senders + receivers)
            .subscriber_max_borrowed_samples(1)
            .subscriber_max_buffer_size(self._queue_len(route))
            .open_or_create()
        )

    def _queue_len(self, route: _wire.Service) -> int:
        """Messages that can wait for one receiver from one sender."""
        return _wire.queue_len(route.traffic, self.attach.frame_capacity, self.attach.lanes)

    def _doorbell(self, of: _wire.Role) -> Any:
        roles = len(_wire.Role)
        return (
            self.builder(f"doorbell/{of.words}")
            .event()
            .max_listeners(1)
            .max_notifiers(roles)
            # One more than there are roles: whoever comes to a role that is taken gets as far as being told so.
            .max_nodes(roles + 1)
            .event_id_max_value(0)
            .open_or_create()
        )


def _hold(attach: Attach) -> int:
    """Takes part in the run for as long as the file is open: nobody cleans it away meanwhile."""
    path = attach.root / "lock"
    try:
        lock = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        fcntl.flock(lock, fcntl.LOCK_SH)
        # A cleaner that came first has removed the file that is now locked.
        path.stat()
    except OSError as error:
        raise AttachError(f"cannot join the run in {attach.root}: {error}") from error
    return lock


def _config(attach: Attach) -> Any:
    """The run's own iceoryx2 settings; nothing is read from anywhere."""
    config = iox2.config.default()
    config.global_cfg.prefix = iox2.FileName.new(attach.prefix)
    config.global_cfg.root_path = iox2.Path.new(str(attach.root))
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = GONE_SENDERS
    return config


class Receiver:
    """The receiving end of a service of fixed messages."""

    def __init__(self, subscriber: Any, name: str, size: int, most: int) -> None:
        self._receive = subscriber.receive
        self._size = size
        self._most = most
        self._name = name

    def drain(self) -> list[bytes]:
        """Every message that waits, in order. No more than can wait at once, so a sender that never stops
        cannot keep this process here.
        """
        messages: list[bytes] = []
        receive, size, most = self._receive, self._size, self._most
        try:
            sample = receive()
            while sample is not None:
                messages.append(string_at(sample.payload_ptr, size))
                # Given back before the next is taken: a receiver may hold one.
                sample = None
                if len(messages) == most:
                    break
                sample = receive()
        except FAILURES as error:
            raise BusError(f"{self._name}: {error}") from error
        return messages


class SliceReceiver:
    """The receiving end of a service of slices with a header."""

    def __init__(self, subscriber: Any, name: str) -> None:
        self._receive = subscriber.receive
        self._name = name

    def receive(self) -> Any | None:
        """The next sample that waits. It keeps its memory where it is until it is dropped."""
        try:
            return self._receive()
        except FAILURES as error:
            raise BusError(f"{self._name}: {error}") from error


class Sender:
    """The sending end of a service of fixed messages."""

    def __init__(self, service: Any, name: str, receivers: int) -> None:
        self._service = service
        self._publisher = (
            service.publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
            .create()
        )
        self._name = name
        self._receivers = receivers
        self._complete = False

    def send(self, message: bytes) -> None:
        """Puts `message` into every receiver's queue. Rings nobody. The first call waits until all
        receivers are there.
        """
        if not self._complete:
            self._wait_for_receivers()
        try:
            loan = self._publisher.loan_uninit()
            memmove(loan.payload_ptr, message, len(message))
            reached = loan.assume_init().send()
        except FAILURES as error:
            raise BusError(f"{self._name}: {error}") from error
        if reached < self._receivers:
            raise BusError(
                f"{self._name}: reached {reached} of {self._receivers} receivers, the others are gone, "
                "hang, or have never looked"
            )

    def _wait_for_receivers(self) -> None:
        deadline = time.monotonic() + RECEIVERS_PATIENCE_S
        while (
            self._service.dynamic_config.number_of_subscribers < self._receivers
            and time.monotonic() < deadline
        ):
            time.sleep(0.001)
        self._complete = True


class Bell:
    """Rings one neighbour's doorbell."""

    def __init__(self, notifier: Any) -> None:
        self._notify = notifier.notify

    def ring(self) -> None:
        """Wakes the neighbour. Call it once after a batch of messages."""
        try:
            self._notify()
        except FAILURES as error:
            raise BusError(f"ringing a doorbell: {error}") from error
