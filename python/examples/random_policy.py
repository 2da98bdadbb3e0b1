"""Takes one of the seven actions at random. Start a run with it:

    evaluate(policy=Random(), memory=["working", "episodic"], limit=5, out="runs/random")

in Python, or in the shell:

    memtransfer run --policy-cmd "python random_policy.py"
"""

import random
from collections.abc import Sequence

from memtransfer import Action, Policy, Request, run


class Random(Policy):
    name = "random-python"

    def act(self, batch: Sequence[Request]) -> Sequence[Action]:
        # Drawn from the request alone, so that an episode is the same in every run.
        draws = (random.Random(request.episode_seed * 1000 + request.step) for request in batch)
        return [draw.choice(list(Action)) for draw in draws]


if __name__ == "__main__":
    run(Random())
