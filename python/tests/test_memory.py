"""Memories that are built and asked without a run."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

from memtransfer import (
    Action,
    Demonstration,
    DemonstrationStep,
    Feedback,
    Heading,
    Memory,
    Plan,
    Pose,
    Query,
    Source,
    Steps,
    serve,
)
from memtransfer.declaration import WAREHOUSE, Field


class TopThree(Memory):
    def build(self, demonstrations):
        self.demonstrations = demonstrations

    def recall(self, query):
        rows = self.demonstrations[0].embeddings
        return [Steps(0, int(step)) for step in np.argsort(-rows @ query.embedding)[:3]]


def demonstration() -> Demonstration:
    """North, north, a turn to the east, east."""
    return Demonstration(
        instruction="Find a blue barrel.",
        states=np.array([[3, 4, 0], [3, 5, 0], [3, 6, 0], [3, 6, 1], [4, 6, 1]], dtype=np.float32),
        actions=np.array([0, 0, 5, 0, -1], dtype=np.int32),
        feedback=np.array([0, 1, 1, 2, 1], dtype=np.int32),
        embeddings=np.eye(5, dtype=np.float32),
    )


def test_a_demonstration_is_a_sequence_of_steps() -> None:
    steps = demonstration()
    assert len(steps) == 5
    start = DemonstrationStep(Pose(3, 4, Heading.N).state, Action.FORWARD, Feedback.START)
    end = DemonstrationStep(Pose(4, 6, Heading.E).state, None, Feedback.MOVED)
    assert (steps[0], steps[-1]) == (start, end)
    assert [step.action for step in steps[2:4]] == [Action.TURN_RIGHT, Action.FORWARD]
    assert list(steps)[4] == end
    with pytest.raises(IndexError):
        steps[5]


def test_a_plan_is_a_list_of_sources_and_actions() -> None:
    assert Plan([Source(0, 5, 3), Action.TURN_LEFT, 0, "move left"]).parts[1] is Action.TURN_LEFT
    for part in ("move forward", Action.LEFT, Source(0)):
        with pytest.raises(TypeError, match="parts is a list of Source objects and actions, not"):
            Plan(part)  # type: ignore[arg-type]


def test_a_route_is_the_demonstration_in_words() -> None:
    assert demonstration().route() == (
        '## "Find a blue barrel."\n'
        "- start: You are in column 3, row 4, and face north.\n"
        "- move forward 2, turn right, move forward\n"
        "- end: You are in column 4, row 6, and face east."
    )
    stays = Demonstration(
        "Stay.", *(getattr(demonstration(), name)[:1] for name in ("states", "actions", "feedback", "embeddings"))
    )
    here = "You are in column 3, row 4, and face north."
    assert stays.route() == f'## "Stay."\n- start: {here}\n- end: {here}'
    blocked = demonstration()
    blocked.states[1:3] = blocked.states[0]
    blocked.feedback[1:3] = Feedback.BLOCKED
    vain = f'move forward ("{WAREHOUSE.feedback[Feedback.BLOCKED]}") 2'
    assert f"- {vain}, turn right, move forward\n" in blocked.route()


def test_a_demonstration_in_another_world_has_numbers() -> None:
    world = dataclasses.replace(WAREHOUSE, name="lock", actions=("pull", "turn"), state=(Field("angle", digits=1),), feedback=("Begin.", "What?"))
    world = dataclasses.replace(world, state_sentence="At {angle} {dial}.")
    states = np.array([[0.5], [1.5]], dtype=np.float32)
    codes = np.array([1, -1], dtype=np.int32), np.array([0, 1], dtype=np.int32)
    turns = Demonstration("Turn it.", states, *codes, np.eye(2, dtype=np.float32), world=world)
    assert len(turns) == 2 and turns[0] == DemonstrationStep((0.5,), 1, 0, world)
    assert type(turns[0].action) is int and turns.world.action_words(turns[0].action) == "turn"
    assert turns.route() == '## "Turn it."\n- start: At 0.5 {dial}.\n- turn\n- end: At 1.5 {dial}.'
    for read in (lambda: turns.poses, lambda: turns[0].pose):
        with pytest.raises(AttributeError, match="the world lock has no poses: its states have the numbers angle"):
            read()


def test_frames_that_were_not_declared_are_missing_with_a_reason() -> None:
    assert len(demonstration().frames) == 0
    with pytest.raises(IndexError, match="set `frames = True`"):
        demonstration().frames[0]


def test_a_memory_can_be_asked_without_a_run() -> None:
    memory = TopThree()
    memory.build([demonstration()])
    embedding = np.array([0, 0.2, 0.9, 0.1, 0], dtype=np.float32)
    state = Pose(3, 6, Heading.N).state
    query = Query(1, 0, 0, "Find a blue barrel.", state, None, Feedback.START, embedding=embedding)
    assert [item.first for item in memory.recall(query)] == [2, 1, 3]


def test_what_cannot_be_served_is_named(tmp_path) -> None:
    with pytest.raises(TypeError, match="neither a Policy nor a Memory"):
        serve(3, tmp_path)
    memory = TopThree()
    memory.scope = "some"
    with pytest.raises(ValueError, match="scope of memory top-three is 'some'"):
        serve(memory, tmp_path)
    memory = TopThree()
    memory.version = 2
    with pytest.raises(TypeError, match="version of memory top-three is 2, but must be a str"):
        serve(memory, tmp_path)
    memory = TopThree()
    memory.learns = "yes"
    with pytest.raises(TypeError, match="learns of memory top-three is 'yes', but must be a bool"):
        serve(memory, tmp_path)
    memory.learns = True
    with pytest.raises(TypeError, match="top-three learns: it must override save and load"):
        serve(memory, tmp_path)


def test_a_memory_without_a_run_says_how_to_start_it() -> None:
    program = (
        "from memtransfer import Memory, run\n"
        "class TopThree(Memory):\n"
        "    def recall(self, query): return []\n"
        "run(TopThree)"
    )
    variables = {name: value for name, value in os.environ.items() if name != "MEMTRANSFER_ATTACH"}
    done = subprocess.run([sys.executable, "-c", program], env=variables, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert "memtransfer run --memory-cmd" in done.stderr
