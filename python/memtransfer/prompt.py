"""The benchmark's own prompt: renders a request as chat messages, and reads a model's answer.

    prompt = render(request)
    reply = client.chat.completions.create(model=..., messages=prompt.messages(), **SETTINGS)
    answer = read_answer(reply.choices[0].message.content or "")

The messages equal those of `--policy openai`: both are rendered by the same code.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from memtransfer import _native
from memtransfer._native import Frame, image_name, png
from memtransfer.codes import Action, Outcome
from memtransfer.declaration import WorldDeclaration
from memtransfer.request import Request

_settings: dict[str, Any] = json.loads(_native.settings())

TEMPLATE: Mapping[str, Any] = json.loads(_native.template())
"""The texts of the prompt, by name."""

VERSION: str = _native.version()
"""The version of the prompt. It changes whenever a text does."""

IMAGE_BUDGET: int = _settings["image_budget"]
"""The maximum number of images in a request of the benchmark."""

SETTINGS: Mapping[str, Any] = {name: _settings[name] for name in ("temperature", "max_tokens")}
"""The benchmark's sampling settings, as arguments for `client.chat.completions.create`."""

CHOICES: Sequence[str] = tuple(_settings["choices"])
"""The seven answers of the warehouse, for servers that can restrict a reply to given texts. In any world they are
`request.world.actions`."""

SECTIONS = ("rules", "memory", "task", "window", "now")
"""The sections of a prompt, in order."""

__all__ = [
    "CHOICES",
    "IMAGE_BUDGET",
    "SECTIONS",
    "SETTINGS",
    "TEMPLATE",
    "VERSION",
    "Part",
    "Prompt",
    "data_url",
    "image_name",
    "png",
    "read_answer",
    "render",
]


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the user message: a text or an image."""

    section: str
    text: str | None
    frame: Frame | None = None


@dataclass(frozen=True, slots=True)
class Prompt:
    """The messages to a model for one step."""

    system: str
    """The system message, the same in every request."""
    parts: Sequence[Part]
    """The user message, in reading order."""
    images_asked: int
    """Number of images of the request, including those that do not fit into the image budget."""

    @property
    def images_sent(self) -> int:
        """Number of images in the message."""
        return sum(part.frame is not None for part in self.parts)

    def images(self, section: str) -> int:
        """Returns the number of images in `section`."""
        return sum(part.section == section and part.frame is not None for part in self.parts)

    def characters(self, section: str) -> int:
        """Returns the number of characters of text in `section`."""
        texts = sum(len(part.text or "") for part in self.parts if part.section == section)
        return texts + (len(self.system) if section == "rules" else 0)

    def messages(self, url: Callable[[Frame], str] | None = None) -> list[Any]:
        """Returns the system message and the user message, each a dict in the format of OpenAI-compatible servers. Clients have types of
        their own for these dicts.

        `url` returns the URL of an image; the default is `data_url`. Without an image the user message is one
        plain text, which servers of text-only models accept.
        """
        url = data_url if url is None else url
        content: Any
        if self.images_sent == 0:
            content = "".join(part.text or "" for part in self.parts)
        else:
            content = [
                {"type": "text", "text": part.text}
                if part.frame is None
                else {"type": "image_url", "image_url": {"url": url(part.frame)}}
                for part in self.parts
            ]
        return [
            {"role": "system", "content": self.system},
            {"role": "user", "content": content},
        ]


def render(request: Request, image_budget: int = IMAGE_BUDGET) -> Prompt:
    """Returns the prompt for `request` with at most `image_budget` images, in the words of `request.world`.

    Images are dropped in this order: keyframes of demonstrations (evenly spread ones stay), retrieved views
    (last first), views of the window (oldest first), the current view. A short text replaces each of them.
    """
    system, parts = _native.render(request, image_budget)
    return Prompt(system, [Part(*part) for part in parts], request.images())


def read_answer(
    text: str, cut_off: bool = False, world: WorldDeclaration | None = None
) -> Action | int | Outcome:
    """Returns the action that a model's reply names, or EMPTY, UNREADABLE, REFUSED or CUT_OFF.

    `cut_off` says that the reply ran out of tokens: without an action, it is CUT_OFF. `world` is that of the request
    (`request.world`); without one, the actions are those of the warehouse. An action is an `Action` in the warehouse, otherwise its
    number. An `Outcome` is a number as well: tell them apart with `isinstance(answer, Outcome)`.
    """
    return _native.read_answer(text, cut_off, world)


def data_url(frame: Frame) -> str:
    """Returns a frame as a `data:` URL of a PNG file. The last 512 files are cached."""
    return "data:image/png;base64," + base64.b64encode(png(frame)).decode("ascii")
