"""LangGraph's `InMemoryStore` with the run's embeddings of views in the place of a text model's."""

from collections.abc import Sequence

import numpy as np
from langgraph.store.memory import InMemoryStore
from numpy.typing import NDArray

from memtransfer import Demonstration, Memory, Query, Steps, run

HITS = 3
NOW = "now"


class LangGraph(Memory):
    name = "langgraph"

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        # The store embeds texts. A step's text is its name, and a name's embedding is that of the view.
        self.vectors: dict[str, NDArray[np.float32]] = {}
        index = {"dims": demonstrations[0].embeddings.shape[1], "embed": self.embed, "fields": ["name"]}
        self.store = InMemoryStore(index=index)
        for number, demonstration in enumerate(demonstrations):
            for first in range(len(demonstration) - 1):
                name = f"{number}:{first}"
                self.vectors[name] = demonstration.embeddings[first]
                value = {"name": name, "demonstration": number, "first": first}
                self.store.put(("demonstrations", str(number)), name, value)

    def embed(self, names: Sequence[str]) -> list[list[float]]:
        return [self.vectors[name].tolist() for name in names]

    def recall(self, query: Query) -> Sequence[Steps]:
        assert query.embedding is not None, "the class has not turned embeddings off"
        self.vectors[NOW] = query.embedding
        found = self.store.search(("demonstrations",), query=NOW, limit=HITS)
        return [Steps(item.value["demonstration"], item.value["first"], distance=1 - item.score) for item in found]


run(LangGraph)
