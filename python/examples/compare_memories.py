"""Evaluates a memory beside built-in ones, and prints its paired difference against episodic memory.

    python compare_memories.py --limit 5 --out runs/compared

Needs `pip install pandas`. In a notebook, the class and the call of `evaluate` are two cells.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from memtransfer import Demonstration, Memory, Query, Result, Steps, evaluate


class TopThree(Memory):
    """Supplies the three steps whose views are the most similar to the current one."""

    name = "top-3"

    def __init__(self) -> None:
        self.demonstrations: Sequence[Demonstration] = ()

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        self.demonstrations = demonstrations

    def recall(self, query: Query) -> Sequence[Steps]:
        assert query.embedding is not None, "the class has not turned embeddings off"
        hits: list[tuple[float, int, int]] = []
        for number, demonstration in enumerate(self.demonstrations):
            distances = 1 - demonstration.embeddings @ query.embedding
            nearest = np.argsort(distances)[:3].tolist()
            hits += [(float(distances[step]), number, step) for step in nearest]
        return [Steps(number, step, distance=distance) for distance, number, step in sorted(hits)[:3]]


def compare(limit: int, out: str) -> Result:
    return evaluate(memory=[TopThree(), "working", "episodic"], limit=limit, out=out)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--limit", type=int, default=5, metavar="N")
    parser.add_argument("--out", default="runs/compared", metavar="DIR")
    arguments = parser.parse_args()
    result = compare(arguments.limit, arguments.out)
    print(result)
    difference = result.compare("top-3/new/unchanged/original", "episodic/new/unchanged/original")
    print(f"top-3 minus episodic from new starts: {difference.difference:.1f} points of success in {difference.pairs} pairs")
    if difference.interval is not None:
        low, high = difference.interval
        print(f"95 % interval {low:.1f} to {high:.1f}, p = {difference.p}")


if __name__ == "__main__":
    main()
