"""Walks while the floor ahead is free, and turns where it is not.

    evaluate(policy=Pixels(), memory=["working", "episodic"], limit=5, out="runs/pixels")

in Python, or in the shell:

    memtransfer run --policy-cmd "python pixels_policy.py"

It knows only what bare floor looks like. The pixels are in shared memory; numpy copies only the small patch of each frame
that is examined.
"""

import random
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from memtransfer import Action, Policy, Request, run

# Where a frame shows the floor of the next cell: the lowest tenth, in the middle.
ROWS, COLUMNS = (0.90, 0.98), (0.43, 0.57)


class Pixels(Policy):
    name = "pixels-python"

    def act(self, batch: Sequence[Request]) -> Sequence[Action]:
        free = is_bare_floor(np.stack([patch(request.frame.pixels) for request in batch]))
        return [decide(request, ahead) for request, ahead in zip(batch, free)]


def patch(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width, _ = pixels.shape
    rows = slice(int(ROWS[0] * height), int(ROWS[1] * height))
    columns = slice(int(COLUMNS[0] * width), int(COLUMNS[1] * width))
    return pixels[rows, columns, :3]


def is_bare_floor(patches: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Returns for each patch whether it is an even, light grey."""
    pixels = patches.astype(np.float32)
    mean, spread = pixels.mean(axis=(1, 2)), pixels.std(axis=(1, 2)).max(axis=1)
    grey = np.ptp(mean, axis=1) < 8
    light = (mean > 130).all(axis=1) & (mean < 170).all(axis=1)
    bare: NDArray[np.bool_] = grey & light & (spread < 6)
    return bare


def decide(request: Request, free: bool) -> Action:
    # Drawn from the request alone, so that an episode is the same in every run.
    rng = random.Random(request.episode_seed * 1000 + request.step)
    if free and rng.random() < 0.8:
        return Action.FORWARD
    return rng.choice([Action.TURN_LEFT, Action.TURN_RIGHT])


if __name__ == "__main__":
    run(Pixels())
