"""Steps the Gymnasium environment beside a run of one episode, and writes what differs: `environment.py OUT CASE
START ROUTE`. The last line is the number of requests that were compared."""

import sys

import numpy as np

from memtransfer import Action, Frame, Policy, run
from memtransfer.gym import MemTransferEnv

OUT, CASE, START, ROUTE = sys.argv[1:]


class Beside(Policy):
    name = "beside"

    def __init__(self):
        self.env = MemTransferEnv(case=CASE, start=START, route=ROUTE, frame_size=128)
        self.random = np.random.default_rng(1)
        self.differences = []

    def act(self, batch):
        (request,) = batch
        if request.step == 0:
            observation, _ = self.env.reset()
        else:
            observation, *_ = self.env.step(request.window[-1].action)
        pixels = observation["pixels"]
        rgba = np.concatenate([pixels, np.full((*pixels.shape[:2], 1), 255, np.uint8)], axis=2)
        pose = request.pose
        compared = {
            "hash": (Frame.of(rgba).content_hash, request.frame.content_hash),
            "pose": (observation["pose"].tolist(), [pose.x, pose.y, pose.heading]),
            "instruction": (observation["instruction"], request.instruction),
            "feedback": (observation["feedback"], request.feedback),
        }
        self.differences += [f"{name} {mine} {its}" for name, (mine, its) in compared.items() if mine != its]
        with open(OUT, "w") as out:
            out.write("\n".join([*self.differences, str(request.step + 1)]))
        # Mostly ahead, to see much of the world.
        return [Action.FORWARD if self.random.random() < 0.6 else Action(self.random.integers(7))]


run(Beside())
