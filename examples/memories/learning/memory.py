"""Follows the steps of its own successful episodes where it has any for the task, else those of demonstrations."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from memtransfer import Demonstration, Episode, EpisodeEnd, Memory, Query, Steps, run

Known: TypeAlias = "dict[str, list[tuple[int, NDArray[np.float32]]]]"
"""For each task: numbers and embeddings of demonstrations."""


class Learning(Memory):
    name = "learning"
    learns = True

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        # What was demonstrated and, before that, what was learned.
        self.demonstrated: Known = {}
        for number, of in enumerate(demonstrations):
            self.demonstrated.setdefault(of.instruction, []).append((number, of.embeddings))
        self.learned: Known = {}
        self.tasks: dict[int, str] = {}
        self.views: dict[int, list[NDArray[np.float32]]] = {}

    def begin_episode(self, episode: Episode) -> None:
        self.tasks[episode.id] = episode.instruction
        if episode.learns:
            self.views[episode.id] = []

    def observe(self, step: Query) -> None:
        if step.episode in self.views and step.embedding is not None:
            self.views[step.episode].append(np.array(step.embedding))

    def recall(self, query: Query) -> Sequence[Steps]:
        assert query.embedding is not None, "the class has not turned embeddings off"
        task = self.tasks[query.episode]
        known = self.learned.get(task) or self.demonstrated.get(task, [])
        hits: list[tuple[float, int, int]] = []
        for number, embeddings in known:
            distances = 1 - embeddings @ query.embedding
            hits.append((float(distances.min()), number, int(distances.argmin())))
        return [Steps(number, step, distance=distance) for distance, number, step in sorted(hits)[:1]]

    def end_episode(self, end: EpisodeEnd) -> None:
        task, views = self.tasks.pop(end.episode), self.views.pop(end.episode, [])
        if end.success and views and end.demonstration is not None:
            # The latest success replaces the one before.
            self.learned[task] = [(end.demonstration, np.stack(views))]

    def save(self, folder: Path) -> None:
        arrays: dict[str, Any] = {}
        for task, [(number, embeddings)] in self.learned.items():
            arrays[f"{number} {task}"] = embeddings
        with open(folder / "learned.npz", "wb") as file:
            np.savez(file, **arrays)

    def load(self, folder: Path) -> None:
        with np.load(folder / "learned.npz") as arrays:
            for name in arrays.files:
                number, task = name.split(" ", 1)
                self.learned[task] = [(int(number), arrays[name])]

    def store_bytes(self) -> int:
        known = [*self.demonstrated.values(), *self.learned.values()]
        return sum(embeddings.nbytes for each in known for _, embeddings in each)


run(Learning())
