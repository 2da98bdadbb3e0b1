"""robotmem: what the expert did, found by BM25 and sorted by the distance to where the agent is.

That distance is one of cells, not of views, so items are supplied without it.

robotmem searches with a model of its own unless `embed_backend` is "none". It then needs SQLite only.
"""

import logging
from collections.abc import Sequence

from robotmem.sdk import RobotMemory

from memtransfer import Action, Demonstration, Heading, Memory, Pose, Query, Steps, run

HITS = 100  # robotmem's most; it sorts by distance only what BM25 has found
LONGEST = 300  # characters of a note


class Robotmem(Memory):
    name = "robotmem"
    embeddings = False

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        self.store = RobotMemory(db_path=":memory:", embed_backend="none")
        for number, demonstration in enumerate(demonstrations):
            for first, step in enumerate(demonstration):
                if not isinstance(step.action, Action):
                    continue
                note = (
                    f"{demonstration.instruction} Demonstration {number}, step {first}: "
                    f"{step.action.words} at column {step.pose.x}, row {step.pose.y}"
                )
                self.store.learn(
                    note[:LONGEST],
                    context={
                        "spatial": {"position": self.position(step.pose)},
                        "params": {"demonstration": number, "first": first},
                    },
                )

    def recall(self, query: Query) -> Sequence[Steps]:
        if not query.instruction.strip():
            return []  # robotmem refuses to search for nothing
        near = {"field": "spatial.position", "target": self.position(query.pose)}
        found = self.store.recall(query.instruction, n=HITS, spatial_sort=near)
        return [Steps(**memory["params"]) for memory in found[:1]]

    @staticmethod
    def position(pose: Pose) -> list[float]:
        # A quarter turn is as far as half a cell.
        east, north = {Heading.N: (0, 1), Heading.E: (1, 0), Heading.S: (0, -1), Heading.W: (-1, 0)}[
            pose.heading
        ]
        return [pose.x, pose.y, 0.35 * east, 0.35 * north]


logging.getLogger("robotmem").setLevel(logging.ERROR)
run(Robotmem)
