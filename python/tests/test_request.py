"""Requests, frames and answers that are built without a run."""

from __future__ import annotations

import copy
import pickle
import re

import numpy as np
import pytest

from memtransfer import (
    Action,
    Decision,
    Document,
    DocumentKind,
    Exchange,
    Feedback,
    Frame,
    Heading,
    Item,
    Outcome,
    PlannedActions,
    Pose,
    RememberedStep,
    RememberedView,
    Request,
    Segment,
    SuppliedPlan,
)
from memtransfer.memory import Query, ServedQuery
from memtransfer.request import ServedRequest


def test_codes_have_the_words_of_the_benchmark() -> None:
    assert [action.words for action in Action][4:] == ["turn left", "turn right", "turn around"]
    assert Feedback.BLOCKED.words == "Something blocks the way: you did not move."
    assert (Heading.E.words, Outcome.REFUSED.words) == ("east", "refused")
    assert (Action(3), int(DocumentKind.SEMANTIC)) == (Action.RIGHT, 1)


def test_a_frame_of_own_pixels_is_a_read_only_copy() -> None:
    image = np.zeros((2, 3, 4), dtype=np.uint8)
    frame = Frame.of(image, id=5)
    image[:] = 9
    assert (frame.id, frame.width, frame.height) == (5, 3, 2)
    assert not frame.is_gone and not frame.pixels.any() and not frame.pixels.flags.writeable
    # BLAKE3 of 24 zero bytes.
    assert frame.content_hash == Frame.of(np.zeros((3, 2, 4), dtype=np.uint8)).content_hash
    assert frame != Frame.of(image, id=5) and len({frame, Frame.of(frame.pixels, id=5)}) == 1
    for shape in [(2, 2, 3), (2, 4), (0, 0, 4)]:
        with pytest.raises(ValueError, match=f"shape {re.escape(str(shape))}, but a frame has"):
            Frame.of(np.zeros(shape, dtype=np.uint8))
    for other in [np.float32, np.int64, np.bool_]:
        with pytest.raises(TypeError, match="but those of a frame are uint8"):
            Frame.of(np.zeros((2, 2, 4), dtype=other))  # type: ignore[arg-type]


def test_a_request_counts_its_images() -> None:
    frame = Frame.of(np.zeros((1, 1, 4), dtype=np.uint8))
    request = Request(0, 0, 1, 5, 1, "Find a barrel.", Pose(3, 12, Heading.N).state, Feedback.START, frame)
    assert request.images() == 1 and str(request.pose) == "3,12,N"


def test_what_a_run_supplies_can_be_copied() -> None:
    class AnyStep:
        def field(self, name: str) -> str:
            return name

    for served, plain in [(ServedRequest, Request), (ServedQuery, Query)]:
        original = served(AnyStep())  # type: ignore[arg-type]
        for copied in [copy.copy(original), copy.deepcopy(original), pickle.loads(pickle.dumps(original))]:
            assert (type(copied), copied.window) == (plain, "window")
        with pytest.raises(AttributeError, match="_step"):
            served.__new__(served)._step


def test_a_frame_can_be_copied() -> None:
    frame = Frame.of(np.arange(24, dtype=np.uint8).reshape(2, 3, 4), id=5, content_hash=bytes(range(16)))
    assert copy.copy(frame) is frame
    for copied in [copy.deepcopy(frame), pickle.loads(pickle.dumps(frame))]:
        assert copied == frame and copied is not frame
        assert (copied.pixels == frame.pixels).all() and not copied.pixels.flags.writeable


def test_a_state_of_the_warehouse_is_a_pose() -> None:
    frame = Frame.of(np.zeros((1, 1, 4), dtype=np.uint8))
    request = Request(0, 0, 1, 5, 1, "Find a barrel.", (3.0, 12.0, 2.0), Feedback.START, frame)
    assert request.pose == Pose(3, 12, Heading.S) and request.pose.state == request.state
    assert request.world.name == "warehouse" and request.world.action_words(Action.LEFT) == "move left"
    assert request.world.action(2) is Action.LEFT and request.world.told(3) is Feedback.BLOCKED
    for state in [(3.5, 12.0, 2.0), (3.0, 12.0, 4.0)]:
        request.state = state
        with pytest.raises(AttributeError, match="is no pose"):
            request.pose
    copied = pickle.loads(pickle.dumps(request))
    assert copied.world == request.world and copied.state == request.state


def test_items_are_sorted_by_what_they_are() -> None:
    frame = Frame.of(np.zeros((1, 1, 4), dtype=np.uint8))
    steps = (RememberedStep(frame, Action.LEFT), RememberedStep(None, None))
    note = Document(1, DocumentKind.NOTE, "turn left")
    near, part = Segment(0.5, "Find a cone.", steps, True), Segment(None, "Find a cone.", steps)
    whole = Segment(None, "Find a barrel.", steps, True)
    parts = (PlannedActions((Action.LEFT, Action.LEFT)), PlannedActions((Action.FORWARD,), "Find a cone."))
    view, plan = RememberedView(frame, "a rack", "Find a cone."), SuppliedPlan(parts)
    items: list[Item] = [note, near, part, whole, view, plan]
    request = Request(
        0, 0, 1, 5, 1, "Find a barrel.", Pose(3, 12, Heading.N).state, Feedback.START, frame, items=items
    )
    assert request.documents == [note] and request.segments == [near, part]
    assert request.segment is near and request.trajectories == [steps]
    assert request.plans == [plan] and plan.actions == (Action.LEFT, Action.LEFT, Action.FORWARD)
    assert request.images() == 1 + 3 + 1
    request.items = []
    assert request.segment is None and not request.trajectories and not request.plans


def test_a_decision_has_an_action_or_the_reason_why_not() -> None:
    for action, outcome in [(None, Outcome.ACTED), (Action.LEFT, Outcome.EMPTY)]:
        with pytest.raises(ValueError, match="an action and the outcome ACTED, or neither"):
            Decision(action, outcome)


def test_an_exchange_must_hold_messages() -> None:
    with pytest.raises(TypeError, match="a message of an exchange is a str"):
        Exchange("hello")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="reply of an exchange is a int"):
        Exchange([], reply=3)  # type: ignore[arg-type]


def test_decisions_are_compared_without_their_exchange() -> None:
    said = Decision(Action.LEFT, exchange=Exchange([{"role": "user", "content": "x"}]))
    assert said == Decision(Action.LEFT) and hash(said) == hash(Decision(Action.LEFT))
