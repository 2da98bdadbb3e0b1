"""Notes that a language model writes about demonstrations, through an OpenAI-compatible server.

The client reads the server's address from OPENAI_BASE_URL and the key, if there is one, from OPENAI_API_KEY;
NOTES_MODEL is the model's name.
"""

import os
from collections.abc import Sequence

from openai import OpenAI

from memtransfer import Demonstration, Memory, Query, Source, Text, run

TASK = (
    "A robot was shown a route. Write one short note with the task and the places of the route, for a robot that gets a "
    "similar task."
)


class ModelNotes(Memory):
    name = "model-notes"
    embeddings = False
    deterministic = False

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        client = OpenAI(api_key=os.environ.get("OPENAI_API_KEY", "none"))
        self.notes: list[Text] = []
        for number, demonstration in enumerate(demonstrations):
            reply = client.chat.completions.create(
                model=os.environ["NOTES_MODEL"],
                messages=[
                    {"role": "system", "content": TASK},
                    {"role": "user", "content": demonstration.route()},
                ],
                temperature=0,
                max_tokens=120,
            )
            note = (reply.choices[0].message.content or "").strip()
            self.notes.append(Text(note, [Source(number)]))

    def recall(self, query: Query) -> Sequence[Text]:
        return self.notes[:8]

    def store_bytes(self) -> int:
        return sum(len(note.text.encode()) for note in self.notes)


run(ModelNotes)
