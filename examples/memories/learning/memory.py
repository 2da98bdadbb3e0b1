"""Follows the steps of its own successful episodes where it has any for the task, else those of demonstrations."""

import numpy as np

from memtransfer import Memory, Steps, run


class Learning(Memory):
    name = "learning"
    learns = True

    def build(self, demonstrations):
        # For each task: number and embeddings of what was demonstrated and, before that, of what was learned.
        self.demonstrated = {}
        for number, of in enumerate(demonstrations):
            self.demonstrated.setdefault(of.instruction, []).append((number, of.embeddings))
        self.learned = {}
        self.tasks, self.views = {}, {}

    def begin_episode(self, episode):
        self.tasks[episode.id] = episode.instruction
        if episode.learns:
            self.views[episode.id] = []

    def observe(self, step):
        if step.episode in self.views and step.embedding is not None:
            self.views[step.episode].append(np.array(step.embedding))

    def recall(self, query):
        task = self.tasks[query.episode]
        known = self.learned.get(task) or self.demonstrated.get(task, [])
        hits = []
        for number, embeddings in known:
            distances = 1 - embeddings @ query.embedding
            hits.append((float(distances.min()), number, int(distances.argmin())))
        return [Steps(number, step, distance=distance) for distance, number, step in sorted(hits)[:1]]

    def end_episode(self, end):
        task, views = self.tasks.pop(end.episode), self.views.pop(end.episode, [])
        if end.success and views:
            # The latest success replaces the one before.
            self.learned[task] = [(end.demonstration, np.stack(views))]

    def save(self, folder):
        arrays = {}
        for task, [(number, embeddings)] in self.learned.items():
            arrays[f"{number} {task}"] = embeddings
        with open(folder / "learned.npz", "wb") as file:
            np.savez(file, **arrays)

    def load(self, folder):
        with np.load(folder / "learned.npz") as arrays:
            for name in arrays.files:
                number, task = name.split(" ", 1)
                self.learned[task] = [(int(number), arrays[name])]

    def store_bytes(self):
        known = [*self.demonstrated.values(), *self.learned.values()]
        return sum(embeddings.nbytes for each in known for _, embeddings in each)


run(Learning())
