"""Serving over the real bus."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence

import pytest
from peer import Peer, eventually, text

from memtransfer import _wire
from memtransfer import (
    EMPTY,
    Action,
    Answer,
    Decision,
    Failed,
    Feedback,
    Heading,
    Outcome,
    PastStep,
    Policy,
    PolicyError,
    Pose,
    RememberedStep,
    Request,
    Usage,
)
from memtransfer._wire import NO_ACTION, NOT_MEASURED, ComplaintKind, DocumentKind, Role


class Does(Policy):
    """Answers what a function says, and keeps what it saw."""

    name = "does"

    def __init__(self, answer: Callable[[Request], Answer] = lambda _: Action.FORWARD) -> None:
        self.answer = answer
        self.batches: list[list[tuple[int, int]]] = []
        self.resets: list[int] = []

    def facts(self) -> dict[str, str]:
        return {"model": "none"}

    def reset(self, lane: int) -> None:
        self.resets.append(lane)

    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        self.batches.append([(request.lane, request.step) for request in batch])
        return [self.answer(request) for request in batch]


def test_hello_decisions_and_farewell() -> None:
    policy = Does()
    with Peer(lanes=3) as peer:
        with peer.serve(policy) as serving:
            hello = serving.hello
            assert (hello.wire_version, hello.role) == (4, Role.POLICY)
            facts = json.loads(text(hello.facts, hello.facts_len))
            assert facts == {"policy": "does", "sdk": "python", "model": "none"}
            peer.brief(lane=2, episode=7)
            frame = peer.publish_frame(1)
            peer.step(frame, lane=2, episode=7)
            (decision,) = peer.await_(_wire.Decision)
            assert (decision.lane, decision.episode, decision.step) == (2, 7, 0)
            assert (decision.outcome, decision.action) == (Outcome.ACTED, Action.FORWARD)
            assert (decision.images_asked, decision.images, decision.attempts) == (1, 1, 0)
            assert decision.prompt_tokens == NOT_MEASURED
            times = (decision.received_ns, decision.started_ns, decision.decided_ns)
            assert 0 < times[0] <= times[1] <= times[2]
        assert (serving.farewell.frames_held, serving.farewell.complaints) == (1, 0)
    assert policy.resets == [2]


def test_a_request_holds_what_was_sent() -> None:
    seen: list[Request] = []

    def look(request: Request) -> Answer:
        for part in ("window", "segment", "documents", "trajectories"):
            getattr(request, part)
        seen.append(request)
        assert request.frame.pixels[0, 0, 0] == 1
        assert [past.frame.pixels[5, 5, 2] for past in request.window] == [2, 3]
        return Action.LEFT

    with Peer() as peer, peer.serve(Does(look)):
        now, *past = [peer.publish_frame(value) for value in (1, 2, 3, 4, 5)]
        steps = struct.pack("<QBB6xQBB6xQBB6x", past[2], 5, 0, 0, NO_ACTION, 0, past[3], NO_ACTION, 1)
        peer.publish_document(11, DocumentKind.SUMMARY, "Küche im Osten".encode())
        peer.publish_document(12, DocumentKind.TRAJECTORIES, steps, episode=1, lane=0)
        peer.brief(instruction="Find a blue barrel.", seed=99, starts_as_demonstrated=1)
        peer.step(
            now,
            step=2,
            feedback=Feedback.BLOCKED,
            window=[(past[0], Action.TURN_LEFT, 2), (past[1], NO_ACTION, 4)],
            segment=[(past[2], Action.RIGHT), (past[3], NO_ACTION)],
            documents=[11, 12],
        )
        (decision,) = peer.await_(_wire.Decision)
        assert (decision.images_asked, decision.action) == (1 + 2 + 2 + 2, Action.LEFT)
    (request,) = seen
    assert (request.step, request.episode, request.episode_seed, request.repeat) == (2, 1, 99, 1)
    assert request.instruction == "Find a blue barrel."
    assert request.pose == Pose(3, 12, Heading.E)
    assert request.feedback is Feedback.BLOCKED
    assert request.starts_as_demonstrated
    window = list(request.window)
    assert window[0] == PastStep(window[0].frame, Action.TURN_LEFT, Feedback.TURNED)
    assert window[1] == PastStep(window[1].frame, None, Feedback.NOT_UNDERSTOOD)
    segment = request.segment
    assert segment is not None and segment.distance == 0.25
    first, second = segment.steps
    assert (first.action, second) == (Action.RIGHT, RememberedStep(second.frame, None))
    (document,) = request.documents
    assert (document.id, document.kind, document.text) == (
        11,
        DocumentKind.SUMMARY,
        "Küche im Osten",
    )
    one, two = request.trajectories
    assert [step.action for step in one] == [Action.TURN_RIGHT, None] and len(two) == 1
    assert one[0].frame is first.frame and one[1].frame is None
    assert request.images() == 7


def test_what_waits_is_one_batch_by_lane() -> None:
    policy = Does()
    with Peer(lanes=4) as peer:
        with peer.serve(policy):
            frame = peer.publish_frame(1)
            for lane in (3, 0, 2):
                peer.brief(lane=lane, episode=lane + 1)
                peer.step(frame, lane=lane, episode=lane + 1)
            peer.await_(_wire.Decision, 3)
    assert sorted(entry for batch in policy.batches for entry in batch) == [(0, 0), (2, 0), (3, 0)]
    assert all(batch == sorted(batch) for batch in policy.batches)


@pytest.mark.parametrize(
    ("answer", "outcome", "action"),
    [
        (Action.TURN_AROUND, Outcome.ACTED, Action.TURN_AROUND),
        (None, Outcome.UNREADABLE, NO_ACTION),
        (EMPTY, Outcome.EMPTY, NO_ACTION),
        (Outcome.REFUSED, Outcome.REFUSED, NO_ACTION),
        (Decision(Action.BACKWARD), Outcome.ACTED, Action.BACKWARD),
        (Decision(None, Outcome.REFUSED), Outcome.REFUSED, NO_ACTION),
    ],
)
def test_answers_arrive(answer: Answer, outcome: Outcome, action: int) -> None:
    with Peer() as peer, peer.serve(Does(lambda _: answer)):
        peer.brief()
        peer.step(peer.publish_frame(1))
        (decision,) = peer.await_(_wire.Decision)
        assert (decision.outcome, decision.action) == (outcome, action)


def test_usage_arrives() -> None:
    usage = Usage(100, 3, image_tokens=0, attempts=2, replayed=True, prompted_ns=5, sent_ns=6)
    with Peer() as peer, peer.serve(Does(lambda _: Decision(Action.LEFT, images=0, usage=usage))):
        peer.brief()
        peer.step(peer.publish_frame(1))
        (decision,) = peer.await_(_wire.Decision)
        assert (decision.prompt_tokens, decision.completion_tokens) == (100, 3)
        assert (decision.cached_tokens, decision.image_tokens) == (NOT_MEASURED, 0)
        assert (decision.images_asked, decision.images) == (1, 0)
        assert (decision.attempts, decision.replayed) == (2, 1)
        assert (decision.prompted_ns, decision.sent_ns) == (5, 6)


def test_a_decision_has_an_action_or_says_why_not() -> None:
    for action, outcome in [(None, Outcome.ACTED), (Action.LEFT, Outcome.EMPTY)]:
        with pytest.raises(ValueError, match="an action and the outcome ACTED, or neither"):
            Decision(action, outcome)


def test_a_failure_ends_its_episode_without_a_result() -> None:
    with Peer() as peer, peer.serve(Does(lambda _: Failed("the server is down"))):
        peer.brief(lane=1, episode=4)
        peer.step(peer.publish_frame(1), lane=1, episode=4)
        (complaint,) = peer.await_(_wire.Complaint)
        assert complaint.kind == ComplaintKind.EPISODE
        assert (complaint.lane, complaint.episode) == (1, 4)
        assert text(complaint.text, complaint.text_len) == "the server is down"


def test_an_exception_costs_its_own_episode_and_no_other(capsys: pytest.CaptureFixture[str]) -> None:
    def answer(request: Request) -> Answer:
        if request.lane == 1:
            raise RuntimeError("cannot do lane 1")
        return Action.RIGHT

    with Peer(lanes=3) as peer, peer.serve(Does(answer)):
        frame = peer.publish_frame(1)
        for lane in range(3):
            peer.brief(lane=lane, episode=lane + 1)
        for lane in range(3):
            peer.step(frame, lane=lane, episode=lane + 1)
        decisions = peer.await_(_wire.Decision, 2)
        assert [decision.lane for decision in decisions] == [0, 2]
        (complaint,) = peer.await_(_wire.Complaint)
        assert (complaint.kind, complaint.lane, complaint.episode) == (ComplaintKind.EPISODE, 1, 2)
        said = text(complaint.text, complaint.text_len)
        assert said == "policy does raised RuntimeError: cannot do lane 1"
    assert "Traceback" in capsys.readouterr().err


def test_a_policy_that_always_raises_stops_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    def answer(request: Request) -> Answer:
        raise KeyError("weights")

    with Peer() as peer, peer.serve(Does(answer)):
        frame = peer.publish_frame(1)
        complaints = []
        for episode in range(1, 9):
            peer.brief(episode=episode)
            peer.step(frame, episode=episode)
            complaints += peer.await_(_wire.Complaint)
        eventually(
            "the run to be stopped",
            lambda: complaints.extend(peer.await_(_wire.Complaint, 0))
            or any(complaint.kind == ComplaintKind.RUN for complaint in complaints),
        )
        (halt,) = (complaint for complaint in complaints if complaint.kind == ComplaintKind.RUN)
        assert "failure 8 in a row" in text(halt.text, halt.text_len)


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ([], "policy broken answered 0 of 1 requests: it must answer each once"),
        ([Action.LEFT] * 2, "policy broken answered 2 of 1 requests"),
        (None, "policy broken returned None from act"),
        ([3], r"policy broken answered 3 \(int\): an answer is"),
        ([Outcome.ACTED], "policy broken answered <Outcome.ACTED: 0>"),
        (
            [Decision(Action.LEFT, usage=Usage(prompt_tokens=-1))],
            "does not fit into a message",
        ),
    ],
)
def test_a_broken_contract_ends_serving(answers: list[Answer], said: str) -> None:
    class Broken(Policy):
        name = "broken"

        def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
            return answers

    with Peer() as peer:
        serving = peer.serve(Broken())
        serving.thread.start()
        peer.await_(_wire.Hello)
        peer.brief()
        peer.step(peer.publish_frame(1))
        with pytest.raises(PolicyError, match=said):
            serving.end()


def test_messages_that_cannot_be_used_are_complained_about() -> None:
    policy = Does()
    with Peer() as peer, peer.serve(policy):
        peer.brief()
        frame = peer.publish_frame(1)
        said = set()

        def complaints(count: int) -> None:
            said.update(text(it.text, it.text_len) for it in peer.await_(_wire.Complaint, count))

        peer.step(frame, feedback=9)
        complaints(1)
        peer.step(frame, step=1, documents=[77])
        complaints(1)
        peer.step(frame + 5, step=2)
        complaints(1)
        peer.step(frame, lane=9)
        complaints(2)
        assert said == {
            "observation for lane 0, step 0: 9 is not a feedback (0 to 4)",
            "lane 0, step 1: document 77 was never published",
            f"lane 0, step 2: frame {frame + 5} is not in the store, so it was evicted too early or "
            "never published",
            "observation for lane 9: the run has 2",
            "recall for lane 9: the run has 2",
        }
        peer.step(frame, step=3)
        (decision,) = peer.await_(_wire.Decision)
        assert decision.step == 3
    assert policy.batches == [[(0, 3)]]


def test_serving_goes_on_in_a_new_generation() -> None:
    policy = Does()
    with Peer() as peer, peer.serve(policy):
        peer.brief()
        peer.step(peer.publish_frame(1))
        peer.await_(_wire.Decision)
        # As when a process of the run died: nobody says stop, everything is started anew.
        peer.write(generation=2)
        peer.join()
        peer.await_(_wire.Hello)
        peer.brief(episode=2)
        peer.step(peer.publish_frame(1), episode=2)
        (decision,) = peer.await_(_wire.Decision)
        assert decision.episode == 2
    assert policy.resets == [0, 0]


def test_spinning_finds_what_waits() -> None:
    with Peer() as peer:
        peer.write(wait={"spin_us": 200_000})
        with peer.serve(Does()):
            peer.brief()
            for step in range(5):
                peer.step(peer.publish_frame(1), step=step)
                peer.await_(_wire.Decision)


def test_late_and_early_messages() -> None:
    policy = Does()
    with Peer() as peer, peer.serve(policy):
        frame = peer.publish_frame(1)
        peer.brief(episode=5)
        peer.step(frame, episode=4)
        peer.step(frame, episode=5, step=1)
        (decision,) = peer.await_(_wire.Decision)
        assert (decision.episode, decision.step) == (5, 1)
        peer.send(_wire.Observation(lane=0, episode=5, step=2, last=1))
        peer.step(frame, episode=5, step=2)
        peer.brief(episode=6)
        peer.step(frame, episode=6)
        (decision,) = peer.await_(_wire.Decision)
        assert decision.episode == 6
    eventually("two batches", lambda: policy.batches == [[(0, 1)], [(0, 0)]])
