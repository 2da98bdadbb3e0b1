"""The serve loop: drain, join, decide, answer, ring once."""

from __future__ import annotations

import json
import logging
import os
import signal
import struct
import sys
import threading
import time
import traceback
from collections.abc import Iterable
from pathlib import Path
from types import FrameType

from memtransfer import _attach, _wire
from memtransfer._attach import Attach
from memtransfer._bus import Bus
from memtransfer._documents import DocumentStore, Published
from memtransfer._frames import FrameStore
from memtransfer._join import BadMessage, Join, Lane, Observed, Recalled
from memtransfer._layout import layout, place
from memtransfer._process import Orchestrator
from memtransfer._prompt_log import Json, PromptLog
from memtransfer._served import ServedRequest
from memtransfer.errors import AttachError, BusError, MemTransferError, PolicyError, PromptLogError
from memtransfer.policy import Policy
from memtransfer.request import Answer, Decision, Failed, Usage

LONGEST_SLEEP_MS = 500
"""How long the loop sleeps when nobody rings. Then it looks whether the run goes on at all."""

A_MOMENT_MS = 1
"""How long to wait for a message that is on its way and rings no bell."""

RESTART_PATIENCE_S = 30.0
"""How long a run whose transport failed may take to start its processes again."""

FAILURES_IN_A_ROW = 8
"""Exceptions of the policy without an answer in between, until the run is asked to stop."""

log = logging.getLogger("memtransfer")

_HELLO = layout(_wire.Hello, "wire_version", "role", "pid", "facts_len", "facts")
_COMPLAINT = layout(
    _wire.Complaint, "episode", "role", "count", "kind", "lane", "text_len", "text"
)
_FAREWELL = layout(_wire.Farewell, "role", "frames_held", "complaints")
_DECISION = layout(
    _wire.Decision,
    "episode",
    "received_ns",
    "started_ns",
    "prompted_ns",
    "sent_ns",
    "decided_ns",
    "lane",
    "step",
    "prompt_tokens",
    "completion_tokens",
    "cached_tokens",
    "image_tokens",
    "memory_tokens",
    "images_asked",
    "images",
    "attempts",
    "outcome",
    "action",
    "replayed",
)
_, _MOST_FACTS = place(_wire.Hello, "facts")
_, _MOST_TEXT = place(_wire.Complaint, "text")
_NONE = _wire.NOT_MEASURED


def run(policy: Policy) -> None:
    """Lets `policy` decide in the run that `MEMTRANSFER_ATTACH` names, until the run ends.

    Returns when the run is over. When it cannot take part, or the policy breaks its contract, the process
    ends with a message: status 2 or 1. A signal ends it quietly, with status 128 and its number.
    """
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _end) if in_main else None
    try:
        serve(policy, _attach.folder_from_environment())
    except PolicyError as error:
        sys.exit(_said(error, 1))
    except MemTransferError as error:
        sys.exit(_said(error, 2))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


def _end(number: int, _frame: FrameType | None) -> None:
    sys.exit(128 + number)


def _said(error: MemTransferError, status: int) -> int:
    print(f"memtransfer: {error}", file=sys.stderr)
    return status


def serve(policy: Policy, folder: Path) -> None:
    """Lets `policy` decide in the run whose folder is `folder`, until the run ends. Goes on when the run
    starts its processes again.

    Raises `AttachError` when the run cannot be taken part in, `BusError` when its transport fails,
    `PromptLogError` when a prompt log cannot be begun, and `PolicyError` when the policy breaks its contract.
    """
    attach = _attach.read(folder)
    orchestrator = Orchestrator(attach.orchestrator_pid)
    try:
        orchestrator.takes_this_process_along()
        later: Attach | None = attach
        while later is not None:
            attach = later
            later = _serve_generation(policy, attach, orchestrator)
    finally:
        orchestrator.close()


def _serve_generation(
    policy: Policy, attach: Attach, orchestrator: Orchestrator
) -> Attach | None:
    """Serves until the generation ends: what the next one is attached to, or `None` when it was the last."""
    bus = Bus(attach)
    server: _Server | None = None
    try:
        # Receivers first: nobody sends before every process has said hello.
        server = _Server(bus, policy)
        server.say_hello()
        while not server.turn():
            if not bus.wait(server.sleep_ms()):
                if not orchestrator.lives():
                    log.warning("the run's orchestrator is gone")
                    return None
                later = _next_generation(attach)
                if later is not None or _is_over(attach):
                    return later
        server.say_farewell()
        return None
    except BusError as error:
        # When a process of the run dies, all are started again, and this one has to join again.
        log.debug("%s", error)
        deadline = time.monotonic() + RESTART_PATIENCE_S
        while time.monotonic() < deadline:
            later = _next_generation(attach)
            if later is not None or _is_over(attach) or not orchestrator.lives():
                return later
            time.sleep(0.05)
        raise
    finally:
        if server is not None:
            server.close()
        del server
        bus.leave()


def _next_generation(attach: Attach) -> Attach | None:
    """What a later generation is attached to, if there is one."""
    try:
        later = _attach.read(attach.root)
    except AttachError:
        return None
    return later if later.generation > attach.generation else None


def _is_over(attach: Attach) -> bool:
    """Whether the run has ended: then there is nothing to attach to any more."""
    return not (attach.root / _wire.ATTACH_FILE).exists()


class _Complaints:
    """What this process complains about: counted, logged, and told to the orchestrator."""

    def __init__(self, bus: Bus) -> None:
        self._sender = bus.sender(_wire.Complaint)
        self.count = 0

    def raise_(self, what: object) -> None:
        """A message could not be used. Made on the way of something that already went wrong, so it never
        fails.
        """
        try:
            self._send(_wire.ComplaintKind.MESSAGE, str(what), 0, 0)
        except BusError as error:
            log.debug("the complaint was not delivered: %s", error)

    def end_episode(self, lane: int, episode: int, why: str) -> None:
        """No decision will come for this episode's step."""
        self._send(_wire.ComplaintKind.EPISODE, why, lane, episode)

    def end_run(self, why: str) -> None:
        """There is no point in going on with the run now."""
        self._send(_wire.ComplaintKind.RUN, why, 0, 0)

    def _send(self, kind: _wire.ComplaintKind, what: str, lane: int, episode: int) -> None:
        self.count += 1
        log.warning("%s", what)
        text = what.encode()[:_MOST_TEXT].decode(errors="ignore").encode()
        self._sender.send(
            _COMPLAINT.pack(
                episode, _wire.Role.POLICY, self.count, kind, lane, len(text), text
            )
        )


class _Server:
    def __init__(self, bus: Bus, policy: Policy) -> None:
        self._policy = policy
        self._name = policy.name or type(policy).__name__
        self._hello = bus.sender(_wire.Hello)
        self._farewell = bus.sender(_wire.Farewell)
        self._complaints = _Complaints(bus)
        self._decisions = bus.sender(_wire.Decision)
        self._orchestrator = bus.bell(_wire.Role.ORCHESTRATOR)
        self._briefs = bus.receiver(_wire.PolicyBrief)
        self._observations = bus.receiver(_wire.Observation)
        self._recalls = bus.receiver(_wire.Recall)
        self._stops = bus.receiver(_wire.Stop)
        self._frames = FrameStore(bus)
        self._documents = DocumentStore(bus)
        self._join = Join(bus.attach.lanes)
        self._failures = 0
        self._halted = False
        self._log = PromptLog.open(bus.attach)

    def say_hello(self) -> None:
        facts = {"policy": self._name, "sdk": "python", **self._policy.facts()}
        if not all(isinstance(value, str) for pair in facts.items() for value in pair):
            raise PolicyError(f"policy {self._name}: its facts have to be text: {facts!r}")
        text = json.dumps(facts, ensure_ascii=False, separators=(",", ":")).encode()
        if len(text) > _MOST_FACTS:
            raise PolicyError(
                f"policy {self._name}: its facts take {len(text)} bytes of JSON, and {_MOST_FACTS} fit: "
                "say less"
            )
        self._hello.send(
            _HELLO.pack(_wire.WIRE_VERSION, _wire.Role.POLICY, os.getpid(), len(text), text)
        )
        self._orchestrator.ring()

    def say_farewell(self) -> None:
        self._farewell.send(
            _FAREWELL.pack(_wire.Role.POLICY, self._frames.taken, self._complaints.count)
        )
        self._orchestrator.ring()

    def close(self) -> None:
        self._frames.close()
        if self._log is not None:
            self._log.close()

    def sleep_ms(self) -> int:
        """How long to sleep when nobody rings."""
        return A_MOMENT_MS if self._join.is_half else LONGEST_SLEEP_MS

    def turn(self) -> bool:
        """Answers everything that waits; returns whether it is time to stop."""
        complaints = self._complaints.count
        self._take_messages()
        ready = self._join.take_ready()
        answered = self._answer(ready) if ready else False
        for bad in self._frames.apply_evictions():
            self._complaints.raise_(bad)
        self._look_after_hoarding()
        if answered or self._complaints.count != complaints:
            self._orchestrator.ring()
        return bool(self._stops.drain())

    def _take_messages(self) -> None:
        """Reads all queues. A message that refers to another one was sent after it: queues are therefore
        emptied effect first, and what was in them is looked at cause first.
        """
        recalls = self._recalls.drain()
        observations = self._observations.drain()
        join = self._join
        for brief in self._briefs.drain():
            try:
                lane, episode = join.brief(brief)
            except BadMessage as bad:
                self._complaints.raise_(bad)
                continue
            self._documents.begin(lane, episode)
            self._policy.reset(lane)
        for observation in observations:
            try:
                join.observation(observation)
            except BadMessage as bad:
                self._complaints.raise_(bad)
        for recall in recalls:
            try:
                join.recall(recall)
            except BadMessage as bad:
                self._complaints.raise_(bad)

    def _answer(self, ready: list[tuple[int, Lane, Observed, Recalled]]) -> bool:
        """Has the policy decide all steps at once; whether anything was sent."""
        received_ns = time.monotonic_ns()
        requests = []
        for number, lane, observed, recalled in ready:
            published = self._hold(number, observed, recalled)
            if published is not None:
                requests.append(
                    ServedRequest(number, lane, observed, recalled, self._frames.frames, published)
                )
        if not requests:
            return False
        started_ns = time.monotonic_ns()
        log = self._log
        asked = None if log is None else self._asked(log, requests)
        if log is not None and asked is None:
            return True
        answers = self._decide(requests)
        decided_ns = time.monotonic_ns()
        send, pack = self._decisions.send, _DECISION.pack
        for request, answer in zip(requests, answers):
            message: bytes | None = None
            if type(answer) is _wire.Action:
                images = request._images
                # fmt: off
                message = pack(
                    request.episode, received_ns, started_ns, 0, 0, decided_ns, request.lane,
                    request.step, _NONE, _NONE, _NONE, _NONE, _NONE, images, images, 0, 0, answer, 0,
                )
                # fmt: on
            elif not isinstance(answer, Failed):
                answer = self._in_full(answer)
                message = _on_the_wire(request, answer, (received_ns, started_ns, decided_ns))
            if log is not None and asked is not None:
                # Before the answer leaves: what is decided is in the log.
                times = (received_ns, started_ns, decided_ns)
                if not self._keep(log, request, asked[request.lane], answer, times):
                    return True
            if message is not None:
                send(message)
            elif isinstance(answer, Failed):
                self._complaints.end_episode(request.lane, request.episode, answer.why)
        return True

    def _asked(self, log: PromptLog, requests: list[ServedRequest]) -> dict[int, Json] | None:
        """What the prompt log says of each request, by lane; `None` when it cannot be kept."""
        if log.broken:
            return None
        try:
            return {request.lane: log.asked(request) for request in requests}
        except PromptLogError as error:
            self._break(log, error)
            return None

    def _keep(
        self,
        log: PromptLog,
        request: ServedRequest,
        asked: Json,
        answer: _wire.Action | Decision | Failed,
        times: tuple[int, int, int],
    ) -> bool:
        """Puts an answer into the prompt log. Returns whether things may go on."""
        try:
            log.write(request, asked, answer, times)
        except PromptLogError as error:
            self._break(log, error)
            return False
        return True

    def _break(self, log: PromptLog, error: PromptLogError) -> None:
        """The prompt log cannot be written: nothing more is asked or answered, and the run is to stop."""
        log.broken = True
        self._complaints.end_run(str(error))

    def _hold(
        self, lane: int, observed: Observed, recalled: Recalled
    ) -> list[Published] | None:
        """The documents that a step shows, after seeing to it that everything it shows is there. Without
        that it cannot be decided: `None`.
        """
        published = []
        documents = self._documents.documents
        for id in recalled.documents:
            if id not in documents:
                for bad in self._documents.take_waiting():
                    self._complaints.raise_(bad)
            if id not in documents:
                self._complaints.raise_(
                    f"lane {lane}, step {observed.step}: document {id} was never published"
                )
                return None
            published.append(documents[id])
        shown = {observed.frame, *recalled.window[::3], *recalled.segment[::2]}
        for document in published:
            shown |= document.frames
        frames = self._frames.frames
        if not shown <= frames.keys():
            for bad in self._frames.take_waiting():
                self._complaints.raise_(bad)
            missing = shown - frames.keys()
            if missing:
                self._complaints.raise_(
                    f"lane {lane}, step {observed.step}: frame {min(missing)} is not in the store, so it "
                    "was evicted too early or never published"
                )
                return None
        return published

    def _decide(self, requests: list[ServedRequest]) -> list[Answer]:
        """The policy's answers. Where it raises, each request is put to it alone, so that one that it cannot
        answer costs its own episode and no other.
        """
        try:
            answers = self._checked(self._policy.act(requests), len(requests))
        except PolicyError:
            raise
        except Exception as error:
            if len(requests) == 1:
                return [self._failed(requests[0], error)]
            return [self._decide_alone(request) for request in requests]
        self._failures = 0
        return answers

    def _decide_alone(self, request: ServedRequest) -> Answer:
        try:
            (answer,) = self._checked(self._policy.act([request]), 1)
        except PolicyError:
            raise
        except Exception as error:
            return self._failed(request, error)
        self._failures = 0
        return answer

    def _failed(self, request: ServedRequest, error: Exception) -> Failed:
        """The policy raised `error` on `request`: says so, and asks the run to stop when it always does."""
        traceback.print_exception(type(error), error, error.__traceback__)
        why = f"policy {self._name} raised {type(error).__name__}: {error}"
        self._failures += 1
        if self._failures >= FAILURES_IN_A_ROW and not self._halted:
            self._halted = True
            self._complaints.end_run(
                f"{why}; that was failure {self._failures} in a row without an answer in between, and the "
                "policy's log has the tracebacks"
            )
        return Failed(why)

    def _checked(self, answers: Iterable[Answer] | None, requests: int) -> list[Answer]:
        if answers is None:
            raise PolicyError(
                f"policy {self._name} returned None from act: it must return a list with an answer for "
                "each request"
            )
        answers = list(answers)
        if len(answers) != requests:
            raise PolicyError(
                f"policy {self._name} answered {len(answers)} of {requests} requests: it must answer "
                "each once"
            )
        return answers

    def _in_full(self, answer: Answer) -> Decision:
        if isinstance(answer, Decision):
            return answer
        if answer is None:
            return Decision(None, _wire.Outcome.UNREADABLE)
        if isinstance(answer, _wire.Outcome) and answer is not _wire.Outcome.ACTED:
            return Decision(None, answer)
        raise PolicyError(
            f"policy {self._name} answered {answer!r} ({type(answer).__name__}): an answer is an Action, "
            "UNREADABLE, EMPTY, REFUSED, None, a Decision or Failed"
        )

    def _look_after_hoarding(self) -> None:
        kept = self._frames.hoarded()
        if kept and not self._halted:
            self._halted = True
            self._complaints.end_run(
                f"policy {self._name} still holds the pixels of {kept} frames that the run has let go of, "
                f"and {self._frames.most_kept} can be spared: copy what you want to keep "
                "(frame.pixels.copy()), or raise --frame-budget"
            )


def _on_the_wire(
    request: ServedRequest, decision: Decision, times: tuple[int, int, int]
) -> bytes:
    received_ns, started_ns, decided_ns = times
    usage = decision.usage or _NO_USAGE
    images = request._images if decision.images is None else decision.images
    action = _wire.NO_ACTION if decision.action is None else int(decision.action)
    counts = (
        usage.prompt_tokens,
        usage.completion_tokens,
        usage.cached_tokens,
        usage.image_tokens,
        usage.memory_tokens,
    )
    try:
        return _DECISION.pack(
            request.episode,
            received_ns,
            started_ns,
            usage.prompted_ns,
            usage.sent_ns,
            decided_ns,
            request.lane,
            request.step,
            *(_NONE if count is None else count for count in counts),
            request._images,
            images,
            usage.attempts,
            int(decision.outcome),
            action,
            bool(usage.replayed),
        )
    except struct.error as problem:
        raise PolicyError(f"{decision!r} does not fit into a message: {problem}") from problem


_NO_USAGE = Usage(attempts=0)
