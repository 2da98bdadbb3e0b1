"""A world in which hardly anything happens, at once: a run with it measures the time of the harness and this package.

    memtransfer run --world-cmd "python step_at_once.py" --policy random --memory working --lanes 64 --runs 20
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from memtransfer.world import DONE, Case, Episode, Field, Observation, World, main

PRESSES = 50


class StepAtOnce(World):
    name, version = "step-at-once", "1"
    rules = "You sit before a key."
    actions = ["press the key", *(f"wait {seconds} s" for seconds in range(1, 60))]
    state = [Field("presses")]

    def cases(self) -> Iterator[Case]:
        presses = [0] * PRESSES
        for number in range(50):
            yield Case(f"press-{number}", f"Press the key {PRESSES} times.", {"original": presses, "new": presses})

    def reset(self, episode: Episode) -> Observation:
        self.presses = 0
        return self.observe()

    def step(self, action: int) -> Observation:
        self.presses += action == 0
        return self.observe()

    def observe(self) -> Observation:
        # All states look alike, so one picture is rendered.
        return Observation([self.presses], DONE, self.presses, PRESSES, state_hash=0)

    def render(self, pixels: NDArray[np.uint8]) -> None:
        pixels[:] = 255


if __name__ == "__main__":
    main(StepAtOnce)
