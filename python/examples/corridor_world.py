"""A corridor of ten cells: a small world of one's own.

    memtransfer run --world-cmd "python corridor_world.py" --policy random
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from memtransfer.world import DONE, NO_EFFECT, Case, Episode, Field, Observation, World, main

CELLS, EAST, WEST = 10, 0, 1


class Corridor(World):
    name, version = "corridor", "1"
    rules = (
        "You walk along a corridor of ten cells, from cell 0 in the west to cell 9 in the east. Its ends meet: east of cell 9 is "
        "cell 0. You see it from above: you are the white cell. You cannot enter a grey cell."
    )
    actions = ["walk east", "walk west"]
    state = [Field("cell")]
    state_sentence = "You are in cell {cell}."
    feedback = ["The episode has just begun.", "You walked.", "You did not move: there is no way.", "You did not move: say it again."]
    tasks = {"reach": "one place", "visit": "two places"}

    def cases(self) -> Iterator[Case]:
        for goal in (7, 8):
            walks = {"original": [EAST] * (goal - 2), "new": [EAST] * (goal - 3), "blocked": [WEST] * (13 - goal)}
            yield Case(f"reach-{goal}", f"Walk to cell {goal}.", walks, "reach", data=[goal])
            visits = {name: [*walk, WEST] for name, walk in walks.items()}
            instruction = f"Walk to cell {goal}, then to cell {goal - 1}."
            yield Case(f"visit-{goal}", instruction, visits, "visit", data=[goal, goal - 1])

    def reset(self, episode: Episode) -> Observation:
        self.cell = {"original": 2, "new": 3}[episode.start]
        self.goals, self.done = episode.case.data, 0
        self.wall = 5 if episode.blocked else None
        return self.observe(DONE)

    def step(self, action: int) -> Observation:
        there = (self.cell + (1 if action == EAST else -1)) % CELLS
        ran_into_wall = there == self.wall
        if not ran_into_wall:
            self.cell = there
            self.done += there == self.goals[self.done]
        return self.observe(NO_EFFECT if ran_into_wall else DONE, ran_into_wall)

    def observe(self, feedback: int, conflict: bool = False) -> Observation:
        seen = self.cell + CELLS * (0 if self.wall is None else self.wall) + 1000 * self.done
        return Observation([self.cell], feedback, self.done, len(self.goals), conflict=conflict, state_hash=seen)

    def render(self, pixels: NDArray[np.uint8]) -> None:
        width = pixels.shape[1] / CELLS
        for cell in range(CELLS):
            colour = (255, 255, 255) if cell == self.cell else (90, 90, 90) if cell == self.wall else (20, 25 * cell, 120)
            pixels[:, round(cell * width) : round((cell + 1) * width), :3] = colour
        pixels[..., 3] = 255


if __name__ == "__main__":
    main(Corridor)
