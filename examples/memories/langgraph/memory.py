"""LangGraph's `InMemoryStore` with the run's embeddings of views in the place of a text model's."""

from langgraph.store.memory import InMemoryStore

from memtransfer import Memory, Steps, run

HITS = 3
NOW = "now"


class LangGraph(Memory):
    name = "langgraph"

    def build(self, demonstrations):
        # The store embeds texts. A step's text is its name, and a name's embedding is that of the view.
        self.vectors = {}
        index = {"dims": demonstrations[0].embeddings.shape[1], "embed": self.embed, "fields": ["name"]}
        self.store = InMemoryStore(index=index)
        for number, demonstration in enumerate(demonstrations):
            for first in range(len(demonstration) - 1):
                name = f"{number}:{first}"
                self.vectors[name] = demonstration.embeddings[first]
                value = {"name": name, "step": [number, first]}
                self.store.put(("demonstrations", str(number)), name, value)

    def embed(self, names):
        return [self.vectors[name].tolist() for name in names]

    def recall(self, query):
        self.vectors[NOW] = query.embedding
        found = self.store.search(("demonstrations",), query=NOW, limit=HITS)
        return [Steps(*item.value["step"], distance=1 - item.score) for item in found]


run(LangGraph)
