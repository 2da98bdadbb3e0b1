"""A note for each demonstration of every case, found by BM25 on the words of the task."""

from collections.abc import Sequence
from typing import Any

import bm25s

from memtransfer import Demonstration, Episode, EpisodeEnd, Memory, Query, Source, Text, run

HITS = 3


def words(texts: list[str]) -> Any:
    return bm25s.tokenize(texts, stopwords=None, show_progress=False)


class Bm25(Memory):
    name = "bm25"
    scope = "all"
    embeddings = False

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        self.notes = [demonstration.route() for demonstration in demonstrations]
        self.index = bm25s.BM25()
        self.index.index(words([d.instruction for d in demonstrations]), show_progress=False)
        self.found: dict[int, list[Text]] = {}

    def begin_episode(self, episode: Episode) -> None:
        # The task stays the same, and so does what is found.
        hits = min(HITS, len(self.notes))
        numbers, _ = self.index.retrieve(words([episode.instruction]), k=hits, show_progress=False)
        notes = [Text(self.notes[number], [Source(number)]) for number in numbers[0].tolist()]
        self.found[episode.id] = notes

    def recall(self, query: Query) -> Sequence[Text]:
        return self.found[query.episode]

    def end_episode(self, end: EpisodeEnd) -> None:
        self.found.pop(end.episode, None)

    def store_bytes(self) -> int:
        return sum(len(note.encode()) for note in self.notes)


run(Bm25)
