"""The steps whose views are most like the current view, by the run's embeddings."""

from collections.abc import Sequence

import numpy as np

from memtransfer import Demonstration, Memory, Query, Steps, run

HITS = 3
STEPS = 7


class TopK(Memory):
    name = "top-k"

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        self.demonstrations = demonstrations

    def recall(self, query: Query) -> Sequence[Steps]:
        assert query.embedding is not None, "the class has not turned embeddings off"
        # The best step of each demonstration, and the best demonstrations.
        hits: list[tuple[float, int, int]] = []
        for number, demonstration in enumerate(self.demonstrations):
            similarity = demonstration.embeddings @ query.embedding
            step = int(np.argmax(similarity))
            hits.append((1 - float(similarity[step]), number, step))
        hits = sorted(hits)[:HITS]
        # An item that does not fit into the image budget would be dropped whole.
        views = min(STEPS, max(1, query.image_budget // len(hits)))
        return [Steps(number, step, views, distance=distance) for distance, number, step in hits]

    def store_bytes(self) -> int:
        return sum(demonstration.embeddings.nbytes for demonstration in self.demonstrations)


run(TopK())
