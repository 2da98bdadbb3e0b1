"""Decides nothing: always forward. What is left is the time that the harness and this package take.

    memtransfer run --policy-cmd "python return_at_once.py" --lanes 64 --runs 20
"""

from memtransfer import Action, Policy, run


class ReturnAtOnce(Policy):
    name = "return-at-once"

    def act(self, batch):
        return [Action.FORWARD] * len(batch)


if __name__ == "__main__":
    run(ReturnAtOnce())
