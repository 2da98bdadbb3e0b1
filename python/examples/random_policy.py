"""The smallest policy: any of the seven actions, by chance. Start a run with it:

    memtransfer run --policy-cmd "python random_policy.py"
"""

import random

from memtransfer import Action, Policy, run


class Random(Policy):
    name = "random-python"

    def act(self, batch):
        # From the request alone: the same episode is the same walk, whatever runs beside it.
        draw = (random.Random(request.episode_seed * 1000 + request.step) for request in batch)
        return [rng.choice(list(Action)) for rng in draw]


if __name__ == "__main__":
    run(Random())
