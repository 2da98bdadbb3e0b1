"""The harness's own prompt: what its `openai` policy tells a model about a request, word for word.

    prompt = render(request)
    client.chat.completions.create(model=..., messages=prompt.messages(), **SETTINGS)

The texts are those of the harness (`policy-proc/prompt/v1.toml`), and so is the outcome, which tests compare.
Images are PNG, written with what Python brings.
"""

from __future__ import annotations

import base64
import json
import math
import re
import struct
import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import groupby
from typing import Any

import numpy as np

from memtransfer._answer import read_answer
from memtransfer._frames import Frame
from memtransfer._wire import Action, DocumentKind
from memtransfer.request import Document, Request, Segment, Trajectory

TEMPLATE: Mapping[str, Any] = json.loads(
    resources.files("memtransfer").joinpath("_prompt.json").read_text(encoding="utf-8")
)
"""The texts, by name."""

VERSION: str = TEMPLATE["version"]
"""Names the texts. It changes when any of them does, because results do."""

IMAGE_BUDGET = 50
"""Most images in a request of the benchmark."""

SETTINGS: Mapping[str, Any] = {"temperature": 0, "max_tokens": 30}
"""What the benchmark asks a model with, beside the messages."""

SECTIONS = ("rules", "memory", "task", "window", "now")
"""What a part of a prompt is about, in the order in which a prompt has them."""

_MOST_KEPT = 512


__all__ = [
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
    """A piece of the user message: a text or an image."""

    section: str
    text: str | None
    frame: Frame | None = None


@dataclass(frozen=True, slots=True)
class Prompt:
    """What a model is told for one step."""

    system: str
    """The system message, the same in every request."""
    parts: Sequence[Part]
    """The user message, in reading order. Texts that follow each other in one section are one part."""
    images_asked: int
    """Images that the request has. Those beyond the budget are not among the parts."""

    @property
    def images_sent(self) -> int:
        """Images that are sent."""
        return sum(part.frame is not None for part in self.parts)

    def images(self, section: str) -> int:
        """Images of `section` that are sent."""
        return sum(part.section == section and part.frame is not None for part in self.parts)

    def characters(self, section: str) -> int:
        """Characters of text in `section`."""
        texts = sum(len(part.text or "") for part in self.parts if part.section == section)
        return texts + (len(self.system) if section == "rules" else 0)

    def messages(self, url: Callable[[Frame], str] | None = None) -> list[dict[str, Any]]:
        """The two messages as an OpenAI-compatible server takes them, with `url` for each image (by default
        the image itself). Without an image the user message is one plain text, which servers of models that
        cannot see take too.
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
    """The prompt for `request`, with at most `image_budget` images.

    What does not fit is left out in this order: keyframes of demonstrations, of which evenly spread ones
    stay; retrieved views, from the last; views of the window, from the oldest; the current view. A short
    text stands where an image was left out.
    """
    writer = _Writer(_Plan(request, image_budget))
    writer.memory(request)
    writer.section = "task"
    writer.fill(TEMPLATE["task"]["text"], instruction=request.instruction)
    writer.section = "window"
    writer.window(request)
    writer.section = "now"
    writer.now(request)
    return Prompt(TEMPLATE["system"], writer.parts, request.images())


class _Plan:
    """Which images are sent."""

    def __init__(self, request: Request, budget: int) -> None:
        self.of_window = len(request.window)
        retrieved = len(request.segment.steps) if request.segment else 0
        self.of_keyframes = request.images() - 1 - self.of_window - retrieved
        room = budget

        def take(wanted: int) -> int:
            nonlocal room
            taken = min(wanted, room)
            room -= taken
            return taken

        # Room is given in the opposite order to that of leaving out.
        self.now = take(1) == 1
        self.sent_window = take(self.of_window)
        self.sent_retrieved = take(retrieved)
        self.sent_keyframes = take(self.of_keyframes)

    def keyframe(self, index: int) -> bool:
        """Whether keyframe `index` is sent: the middle ones of as many equal stretches as there is room for."""
        of, sent = self.of_keyframes, self.sent_keyframes
        stretch = index * sent // max(of, 1)
        return any(
            s < sent and (2 * s + 1) * of // (2 * sent) == index for s in (stretch, stretch + 1)
        )

    def retrieved(self, index: int) -> bool:
        """Whether retrieved view `index` is sent: the first ones."""
        return index < self.sent_retrieved

    def window(self, index: int) -> bool:
        """Whether the window's view `index` is sent: the latest ones."""
        return index >= self.of_window - self.sent_window


class _Writer:
    def __init__(self, plan: _Plan) -> None:
        self.plan = plan
        self.section = "memory"
        self.parts: list[Part] = []

    def text(self, text: str) -> None:
        last = self.parts[-1] if self.parts else None
        if last is not None and last.text is not None and last.section == self.section:
            self.parts[-1] = Part(self.section, last.text + text)
        elif text:
            self.parts.append(Part(self.section, text))

    def fill(self, text: str, /, **values: object) -> None:
        self.text(_fill(text, **values))

    def view(self, frame: Frame, sent: bool) -> None:
        if sent:
            self.parts.append(Part(self.section, None, frame))
        else:
            self.text(TEMPLATE["view_not_shown"])
        self.text(TEMPLATE["view"]["after"])

    def memory(self, request: Request) -> None:
        texts = TEMPLATE["memory"]
        self.text(texts["begin"])
        if not request.documents and not request.trajectories and request.segment is None:
            self.text(texts["nothing"])
        else:
            for document in request.documents:
                self.document(document)
            keyframe = 0
            for index, trajectory in enumerate(request.trajectories):
                count = len(request.trajectories)
                self.fill(texts["demonstration_begin"], number=index + 1, count=count)
                keyframe = self.demonstration(trajectory, keyframe)
                self.text(texts["demonstration_end"])
            if request.starts_as_demonstrated:
                self.text(texts["hint"])
            if request.segment is not None:
                self.retrieved(request.segment)
        self.text(texts["end"])

    def document(self, document: Document) -> None:
        texts = TEMPLATE["memory"]
        summary = document.kind is DocumentKind.SUMMARY
        name = texts["summary" if summary else "semantic"]
        self.fill(texts["document"], name=name, text=document.text)

    def demonstration(self, trajectory: Trajectory, keyframe: int) -> int:
        """The views of a demonstration, and between two of them the actions that led from one to the other.
        Returns the number of the next keyframe.
        """
        actions: list[Action] = []
        taken = 0
        for step in trajectory:
            if step.frame is not None:
                self.actions(actions)
                self.fill(TEMPLATE["memory"]["demonstration_view"], step=taken)
                self.view(step.frame, self.plan.keyframe(keyframe))
                keyframe += 1
            if step.action is not None:
                actions.append(step.action)
                taken += 1
        self.actions(actions)
        return keyframe

    def actions(self, actions: list[Action]) -> None:
        """Writes `actions` down, if there are any, and forgets them."""
        if not actions:
            return
        texts = TEMPLATE["memory"]
        runs = []
        for action, run in groupby(actions):
            times = len(list(run))
            words = _action(action)
            runs.append(words if times == 1 else _fill(texts["several"], action=words, times=times))
        self.fill(texts["demonstration_actions"], actions=texts["then"].join(runs))
        actions.clear()

    def retrieved(self, segment: Segment) -> None:
        texts = TEMPLATE["memory"]
        distance = texts["unknown_distance"]
        if math.isfinite(segment.distance):
            # Rounding can put the same view a hair below 0.
            distance = f"{segment.distance if segment.distance > 0 else 0.0:.3f}"
        self.fill(texts["retrieved_begin"], distance=distance)
        led_here: Action | None = None
        for index, step in enumerate(segment.steps):
            if index > 0:
                alone = led_here is None
                self.text(texts["retrieved_view_alone" if alone else "retrieved_view"])
            self.view(step.frame, self.plan.retrieved(index))
            if step.action is not None:
                self.fill(texts["retrieved_action"], action=_action(step.action))
            led_here = step.action
        self.text(texts["retrieved_end"])

    def window(self, request: Request) -> None:
        texts = TEMPLATE["window"]
        self.text(texts["begin"])
        if not request.window:
            self.text(texts["nothing"])
        for index, past in enumerate(request.window):
            self.fill(texts["view"], number=index + 1, count=len(request.window))
            self.view(past.frame, self.plan.window(index))
            action = texts["no_action"] if past.action is None else _action(past.action)
            feedback = TEMPLATE["feedback"][past.feedback.name.lower()]
            self.fill(texts["step"], action=action, feedback=feedback)
        self.text(texts["end"])

    def now(self, request: Request) -> None:
        texts, pose = TEMPLATE["now"], request.pose
        self.fill(
            texts["begin"],
            column=pose.x,
            row=pose.y,
            heading=TEMPLATE["headings"][pose.heading.name],
            feedback=TEMPLATE["feedback"][request.feedback.name.lower()],
        )
        self.view(request.frame, self.plan.now)
        self.text(texts["end"])


def _action(action: Action) -> str:
    words: str = TEMPLATE["actions"][action.name.lower()]
    return words


def _fill(text: str, /, **values: object) -> str:
    """`text` with each `{name}` of `values` replaced. What a value holds is never looked at for names, and
    braces around anything else stay.
    """
    names = "|".join(map(re.escape, values))
    return re.sub(r"\{(" + names + r")\}", lambda found: str(values[found[1]]), text)


def png(frame: Frame) -> bytes:
    """A frame as a PNG file, without its alpha."""
    pixels = frame.pixels[:, :, :3]
    height, width, _ = pixels.shape
    # Each row begins with its filter: none.
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)
    rows[:, 1:] = pixels.reshape(height, 3 * width)

    def chunk(kind: bytes, content: bytes) -> bytes:
        checked = kind + content
        return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))

    # 8 bits for each of red, green and blue.
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    content = zlib.compress(rows.tobytes(), 6)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", content) + chunk(b"IEND", b"")
    )


_kept: OrderedDict[bytes, str] = OrderedDict()
_keeping = threading.Lock()


def data_url(frame: Frame) -> str:
    """A frame as a `data:` URL of a PNG file. Those of the last frames are kept: most views of a request
    were in the request before.
    """
    key = frame.content_hash
    with _keeping:
        url = _kept.get(key)
        if url is not None:
            _kept.move_to_end(key)
            return url
    url = "data:image/png;base64," + base64.b64encode(png(frame)).decode("ascii")
    with _keeping:
        _kept[key] = url
        while len(_kept) > _MOST_KEPT:
            _kept.popitem(last=False)
    return url


def image_name(frame: Frame) -> str:
    """How an image is named where it does not stand itself, in logs: `image:` and its pixels' hash."""
    return "image:" + frame.content_hash.hex()
