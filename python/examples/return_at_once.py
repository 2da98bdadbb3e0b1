"""Always moves forward, at once: a run with it measures the time of the harness and this package.

    memtransfer run --policy-cmd "python return_at_once.py" --lanes 64 --runs 20
"""

from collections.abc import Sequence

from memtransfer import Action, Policy, Request, run


class ReturnAtOnce(Policy):
    name = "return-at-once"

    def act(self, batch: Sequence[Request]) -> Sequence[Action]:
        return [Action.FORWARD] * len(batch)


if __name__ == "__main__":
    run(ReturnAtOnce())
