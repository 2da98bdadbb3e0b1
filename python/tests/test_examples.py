"""The examples' own parts. That they walk episodes of the benchmark is tested by the harness."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from memtransfer import Action, Feedback, Frame, Heading, Pose, Request

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))

import pixels_policy  # noqa: E402
import random_policy  # noqa: E402


def request(step: int = 0, value: int = 150) -> Request:
    return Request(
        lane=0,
        step=step,
        episode=1,
        episode_seed=5,
        repeat=1,
        instruction="Find a blue barrel.",
        pose=Pose(3, 12, Heading.N),
        feedback=Feedback.START,
        frame=Frame.of(np.full((64, 64, 4), value, dtype=np.uint8)),
    )


def test_the_random_walk_is_its_seed() -> None:
    policy = random_policy.Random()
    walk = policy.act([request(step) for step in range(200)])
    assert walk == [policy.act([request(step)])[0] for step in range(200)]
    assert set(walk) == set(Action)


def test_bare_floor_is_told_from_what_stands_on_it() -> None:
    policy = pixels_policy.Pixels()
    free = policy.act([request(step) for step in range(50)])
    assert free.count(Action.FORWARD) > 30
    blocked = policy.act([request(step, value=60) for step in range(50)])
    assert Action.FORWARD not in blocked
