"""A policy, a memory or a world, one of whose ten cases ends its process or interrupts it: `faulty.py ROLE FAULT [ARGUMENT]...`.

The world is a corridor with ten cases of the same walks. The fault `interrupt` comes three times and then no more; it is counted in the
file that `FAULTY_INTERRUPTS` names. A policy or memory with that fault serves the run whose folder is the first argument, and serves it
again after each interrupt.
"""

import os
import signal
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))

from corridor_world import Corridor

from memtransfer import Memory, Policy, run, serve
from memtransfer.world import Case, main

ROLE, FAULT = sys.argv[1:3]
VICTIM = {"policy": "Walk to cell 7 with parcel 2.", "memory": "Walk to cell 7 with parcel 5.", "world": "Walk to cell 7 with parcel 7."}[ROLE]


def fail(instruction, step):
    """Lets the fault happen in the third step of the victim."""
    if instruction != VICTIM or step != 2:
        return
    if FAULT == "exit":
        sys.exit("I have had enough")
    elif FAULT == "exit-at-once":
        print("I leave", flush=True)
        os._exit(3)
    elif FAULT == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif FAULT == "interrupt":
        count = Path(os.environ["FAULTY_INTERRUPTS"])
        if not count.exists() or len(count.read_text()) < 3:
            with count.open("a") as file:
                file.write("x")
            signal.raise_signal(signal.SIGINT)


class East(Policy):
    """Walks east."""

    name = "east"

    def act(self, batch):
        for request in batch:
            fail(request.instruction, request.step)
        return [0 for _ in batch]


class Nothing(Memory):
    """Supplies nothing."""

    name = "nothing"
    embeddings = False

    def recall(self, query):
        fail(query.instruction, query.step)
        return []


class Parcels(Corridor):
    def cases(self):
        walks = {"original": [0] * 5, "new": [0] * 4}
        return [Case(f"parcel-{n}", f"Walk to cell 7 with parcel {n}.", walks, "reach", data=[7]) for n in range(10)]

    def reset(self, episode):
        self.instruction, self.steps = episode.case.instruction, 0
        return super().reset(episode)

    def step(self, action):
        self.steps += 1
        # The case book is written by acting out the expert's trajectories.
        if "serve" in sys.argv:
            fail(self.instruction, self.steps)
        return super().step(action)


def serve_in_spite_of_interrupts(program):
    while True:
        try:
            return serve(program, sys.argv[3])
        except KeyboardInterrupt:
            print("interrupted", flush=True)


# A test in the background may inherit an ignored SIGINT; a program at a terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)
if ROLE == "world":
    del sys.argv[1:3]
    main(Parcels)
else:
    program = {"policy": East(), "memory": Nothing()}[ROLE]
    (serve_in_spite_of_interrupts if FAULT == "interrupt" else run)(program)
