"""A memory that supplies nothing, at once: a run with it measures the time of the harness and this package.

    memtransfer run --memory-cmd "python supply_nothing.py" --lanes 64 --runs 20
"""

from collections.abc import Sequence

from memtransfer import Memory, MemoryItem, Query, run


class SupplyNothing(Memory):
    name = "supply-nothing"
    embeddings = False

    def recall(self, query: Query) -> Sequence[MemoryItem]:
        return []


if __name__ == "__main__":
    run(SupplyNothing)
