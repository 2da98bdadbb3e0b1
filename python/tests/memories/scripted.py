"""A memory with one trait, for tests.

    scripted.py TRAIT [FILE]
"""

import sys

import numpy as np

from memtransfer import Action, FrameGone, Heading, Memory, Plan, Source, Steps, Text, View, run


class Scripted(Memory):
    """Supplies nothing."""

    name = "scripted"

    def recall(self, query):
        return []


class Checks(Scripted):
    """Checks what it is given, and writes what it saw to a file."""

    frames = True
    seen = {"banks": 0, "queries": 0, "ends": 0, "gone": 0}

    def build(self, demonstrations):
        self.demonstrations = demonstrations
        for demonstration in demonstrations:
            steps = len(demonstration)
            assert steps > 1 and demonstration.poses.shape == (steps, 3)
            assert demonstration[0].pose.heading in Heading and demonstration[-1].action is None
            assert demonstration.actions[-1] == -1 and demonstration[0].action in Action
            rows = demonstration.embeddings
            assert rows.shape[0] == steps and rows.dtype == np.float32 and not rows.flags.writeable
            assert np.allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-3)
            assert len(demonstration.frames) == steps
            pixels = demonstration.frames[0].pixels
            assert pixels.shape[2] == 4 and not pixels.flags.writeable
            assert demonstration.route().startswith(f'## "{demonstration.instruction}"\n- start: You are in ')
        self.episodes = {}
        self.seen["banks"] += 1

    def begin_episode(self, episode):
        assert episode.image_budget > 0 and episode.text_budget > 0 and episode.repeat == 1
        self.episodes[episode.id] = [episode.instruction, 0, None]

    def observe(self, step):
        assert step.step == self.episodes[step.episode][1]
        self.episodes[step.episode][1] += 1
        if step.frame is None:
            assert step.embedding is None
            self.seen["ends"] += 1

    def recall(self, query):
        instruction, steps, earlier = self.episodes[query.episode]
        assert query.instruction == instruction and query.step == steps - 1
        assert len(query.window) == min(query.step, 6)
        if query.window:
            last = query.window[-1]
            assert last.action == query.last_action and last.frame.pixels.shape[2] == 4
        assert query.embedding.shape == self.demonstrations[0].embeddings.shape[1:]
        assert not query.embedding.flags.writeable
        assert query.frame.pixels.any()
        if earlier is not None and earlier.frame.is_gone:
            try:
                assert not earlier.frame.pixels
            except FrameGone:
                self.seen["gone"] += 1
        self.episodes[query.episode][2] = query
        self.seen["queries"] += 1
        with open(sys.argv[2], "w", encoding="utf-8") as file:
            file.write(repr(self.seen))
        return [
            Steps(0, query.step % 3, count=2, distance=0.25),
            Text("a note", [Source(0)]),
            View(0, 1, "a caption"),
            "another note",
            Steps(0, count=None, views=[0, 2]),
            Plan([Source(0, 0, 2), Action.TURN_LEFT, 0, "turn right", self.demonstrations[0].actions[0]]),
        ]

    def end_episode(self, end):
        del self.episodes[end.episode]

    def store_bytes(self):
        return 1234

    def tokens(self):
        return 7


class RaisesInBuild(Scripted):
    def build(self, demonstrations):
        raise RuntimeError("cannot build")


class RaisesInOne(Scripted):
    """Raises in the episodes of one task."""

    def recall(self, query):
        if query.instruction == sys.argv[2]:
            raise RuntimeError("cannot recall this")
        return []


class ReturnsNone(Scripted):
    def recall(self, query):
        return None


class ReturnsNumbers(Scripted):
    def recall(self, query):
        return [3]


class Negative(Scripted):
    def recall(self, query):
        return [Steps(-1)]


class TooFar(Scripted):
    def recall(self, query):
        return [Steps(0, 99_999, 1)]


class PlansUnknownAction(Scripted):
    def recall(self, query):
        return [Plan([Action.FORWARD, 7])]


class PlansTooFar(Scripted):
    def recall(self, query):
        return [Plan([Source(0, 99_999, 1)])]


class PlansUnknownDemonstration(Scripted):
    def recall(self, query):
        return [Plan([Source(99)])]


class PlansNothing(Scripted):
    def recall(self, query):
        return [Plan([])]


class PlansWords(Scripted):
    def recall(self, query):
        return [Plan("move forward")]


class TooMany(Scripted):
    def recall(self, query):
        return ["note"] * 9


class Unmakable(Scripted):
    def __init__(self):
        raise RuntimeError("cannot be made")


if __name__ == "__main__":
    run({kind.__name__: kind for kind in (Scripted, *Scripted.__subclasses__())}[sys.argv[1]])
