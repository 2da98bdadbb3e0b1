"""mem0 without a language model: notes are stored as they are (`infer=False`) and found by a local embedder."""

import os
import tempfile
import zlib
from collections.abc import Sequence
from typing import Any

# mem0 reads these when it is imported. It would report to its makers, and keep files in the home folder.
FOLDER = tempfile.TemporaryDirectory(prefix="mem0-")
os.environ.update(MEM0_TELEMETRY="false", MEM0_DIR=FOLDER.name)

import mem0  # noqa: E402
import numpy as np  # noqa: E402
from mem0.embeddings.base import EmbeddingBase  # noqa: E402
from mem0.utils.factory import EmbedderFactory  # noqa: E402

from memtransfer import Demonstration, Episode, EpisodeEnd, Memory, Query, Source, Text, run  # noqa: E402

HITS = 3
DIMENSIONS = 256


class Words(EmbeddingBase):
    """Counts words by their hash: equal tasks have equal vectors."""

    def embed(self, text: str, memory_action: Any = None) -> Any:
        vector = np.zeros(DIMENSIONS)
        for word in text.lower().strip(".").split():
            vector[zlib.crc32(word.encode()) % DIMENSIONS] += 1
        return (vector / max(1.0, float(np.linalg.norm(vector)))).tolist()


# mem0 accepts its own list of embedders only, so ours takes the name of one that is not installed.
EmbedderFactory.provider_to_class["langchain"] = f"{__name__}.Words"
SETTINGS = {
    "embedder": {"provider": "langchain", "config": {}},
    "vector_store": {
        "provider": "qdrant",
        "config": {"path": FOLDER.name, "embedding_model_dims": DIMENSIONS},
    },
    # It is made but never asked.
    "llm": {"provider": "openai", "config": {"api_key": "unused"}},
    "history_db_path": ":memory:",
}


class Mem0(Memory):
    name = "mem0"
    scope = "all"
    embeddings = False
    store: Any = None
    banks = 0

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        # One store for all banks: the user of mem0 is the bank.
        if Mem0.store is None:
            Mem0.store = mem0.Memory.from_config(SETTINGS)
        Mem0.banks += 1
        self.user = f"bank-{Mem0.banks}"
        self.routes = [demonstration.route() for demonstration in demonstrations]
        for number, demonstration in enumerate(demonstrations):
            task = demonstration.instruction
            self.store.add(task, user_id=self.user, metadata={"number": number}, infer=False)
        self.found: dict[int, list[Text]] = {}

    def begin_episode(self, episode: Episode) -> None:
        filters = {"user_id": self.user}
        found = []
        if episode.instruction.strip():  # mem0 refuses to search for nothing
            found = self.store.search(episode.instruction, filters=filters, top_k=HITS)["results"]
        numbers = [memory["metadata"]["number"] for memory in found]
        self.found[episode.id] = [Text(self.routes[n], [Source(n)]) for n in numbers]

    def recall(self, query: Query) -> Sequence[Text]:
        return self.found[query.episode]

    def end_episode(self, end: EpisodeEnd) -> None:
        self.found.pop(end.episode, None)


run(Mem0)
