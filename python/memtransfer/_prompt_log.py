"""Writes the prompt log, as the harness's own policies do: requests and answers as they are answered, views
and long texts once. `docs/prompt-logs.md` of the project is the format.

Nothing here decides what happens when the disk is full: the serve loop does.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from memtransfer._attach import Attach
from memtransfer._blake3 import blake3
from memtransfer._frames import Frame
from memtransfer._wire import Action
from memtransfer.errors import PromptLogError
from memtransfer.prompt import png
from memtransfer.request import (
    Decision,
    DemonstrationStep,
    Exchange,
    Failed,
    RememberedStep,
    Request,
    Trajectory,
    Usage,
)

LONG_TEXT = 1024
"""Texts of more bytes than these are stored once."""

_MOST_REMEMBERED = 256
"""Texts whose names are remembered, and demonstrations."""

_PNG = b"\x89PNG\r\n\x1a\n"
_DATA_URL = re.compile(r"data:([^;,]*);base64,")
_NAMED = re.compile(r"image:([0-9a-f]{32})")

Json = dict[str, Any]


class PromptLog:
    """An open prompt log. Every method raises `PromptLogError` when something cannot be written."""

    def __init__(self, session: Path, generation: int) -> None:
        self._images = session.parent / "images"
        self._documents = session.parent / "documents"
        self._path = session / f"generation-{generation}.jsonl"
        for folder in (session, self._images, self._documents):
            _try(folder, lambda: folder.mkdir(parents=True, exist_ok=True))
        self._file = _try(self._path, lambda: _open_lines(self._path))
        self._views: set[str] = set()
        self._by_content: dict[bytes, str] = {}
        """The views by a hash of their files: by this they are found again in messages."""
        self._texts: dict[str, str] = {}
        self._demonstrations: dict[tuple[Trajectory, ...], str] = {}
        self.broken = False
        """It could not be written to, and the run was asked to stop: nothing is asked or answered any more,
        so that no step is without its entry."""

    @classmethod
    def open(cls, attach: Attach) -> PromptLog | None:
        """The log that the run asks for, if it does."""
        return None if attach.prompts is None else cls(attach.prompts, attach.generation)

    def close(self) -> None:
        os.close(self._file)

    def asked(self, request: Request) -> Json:
        """Keeps what `request` shows, and says what to write of it."""
        asked: Json = {
            "repeat": request.repeat,
            "seed": request.episode_seed,
            "instruction": request.instruction,
            "pose": str(request.pose),
            "feedback": request.feedback.words,
            "frame": self._view(request.frame),
            "starts_as_demonstrated": request.starts_as_demonstrated,
            "window": [
                _told(
                    frame=self._view(past.frame),
                    action=_words(past.action),
                    feedback=past.feedback.words,
                )
                for past in request.window
            ],
        }
        if request.segment is not None:
            distance = request.segment.distance
            asked["segment"] = {
                # The digits of the 32 bits that it has.
                "distance": float(str(np.float32(distance))) if math.isfinite(distance) else None,
                "steps": self._seen(request.segment.steps),
            }
        if request.documents:
            asked["documents"] = [
                {"kind": document.kind.name.lower(), "text": self._text(document.text)}
                for document in request.documents
            ]
        if request.trajectories:
            asked["trajectories"] = self._trajectories(tuple(request.trajectories))
        return asked

    def write(
        self,
        request: Request,
        asked: Json,
        answer: Action | Decision | Failed,
        times: tuple[int, int, int],
    ) -> None:
        """Adds the entry of `request`, of which `asked` is to be written; `times` are those of receiving it,
        of beginning to decide and of the answer.
        """
        if isinstance(answer, Action):
            answer = Decision(answer)
        exchange = answer.exchange
        usage = answer.usage if isinstance(answer, Decision) else None
        received_ns, started_ns, decided_ns = times
        entry = _told(
            episode=request.episode,
            step=request.step,
            lane=request.lane,
            request=asked,
            exchange=None if exchange is None else self._exchange(exchange),
            answer=_answered(request, answer) if isinstance(answer, Decision) else None,
            failed=answer.why if isinstance(answer, Failed) else None,
            usage=None if usage is None else _used(usage),
            timing={
                "received_ns": received_ns,
                "started_ns": started_ns,
                "prompted_ns": int(usage.prompted_ns) if usage else 0,
                "sent_ns": int(usage.sent_ns) if usage else 0,
                "decided_ns": decided_ns,
            },
        )
        # One write, where the disk takes it: a kill leaves a line whole, absent or torn.
        _try(self._path, lambda: _write(self._file, _json(entry) + b"\n"))

    def _exchange(self, exchange: Exchange) -> Json:
        messages = [
            {"role": str(message.get("role", "")), "parts": list(self._parts(message))}
            for message in exchange.messages
        ]
        return _told(messages=messages, reply=exchange.reply, unread=exchange.unread)

    def _parts(self, message: Mapping[str, Any]) -> Iterator[Json]:
        content = message.get("content")
        if isinstance(content, str):
            content = [{"text": content}]
        for part in content if isinstance(content, (list, tuple)) else ():
            yield self._part(part)
        # Such as a call of a tool.
        rest = {
            key: value
            for key, value in message.items()
            if key not in ("role", "content") and value is not None
        }
        if rest or not isinstance(content, (list, tuple, type(None))):
            yield self._said(_json(rest or content).decode())

    def _part(self, part: Any) -> Json:
        if isinstance(part, Mapping):
            text, image = part.get("text"), part.get("image_url")
            if isinstance(text, str):
                return self._said(text)
            if isinstance(image, Mapping):
                image = image.get("url")
            if isinstance(image, str):
                return self._image(image)
        return self._said(part if isinstance(part, str) else _json(part).decode())

    def _said(self, text: str) -> Json:
        if len(_utf8(text)) > LONG_TEXT:
            return {"stored": self._text(text)}
        return {"text": text}

    def _image(self, url: str) -> Json:
        """A view by its hash; another image by that of its file. What cannot be kept is said in words."""
        if (named := _NAMED.fullmatch(url)) and named[1] in self._views:
            return {"image": named[1]}
        if not (data := _DATA_URL.match(url)):
            return self._said(f"[the image at {url}]")
        try:
            content = base64.b64decode(url[data.end() :], validate=True)
        except (binascii.Error, ValueError):
            return self._said(f"[an image ({data[1]}) that is not base64]")
        if name := self._by_content.get(_fingerprint(content)):
            return {"image": name}
        if not content.startswith(_PNG):
            return self._said(f"[an image ({data[1]}, {len(content)} bytes) that is not kept]")
        name = blake3(content).hex()
        _keep(self._images / f"{name}.png", lambda: content)
        self._by_content[_fingerprint(content)] = name
        return {"image": name}

    def _view(self, frame: Frame) -> str:
        name = frame.content_hash.hex()
        if name not in self._views:
            content = _keep(self._images / f"{name}.png", lambda: png(frame))
            self._by_content[_fingerprint(content)] = name
            self._views.add(name)
        return name

    def _text(self, text: str) -> str:
        name = self._texts.get(text)
        if name is None:
            content = _utf8(text)
            name = blake3(content).hex()
            _keep(self._documents / f"{name}.txt", lambda: content)
            _remember(self._texts, text, name)
        return name

    def _trajectories(self, trajectories: tuple[Trajectory, ...]) -> str:
        name = self._demonstrations.get(trajectories)
        if name is None:
            content = _json([self._seen(trajectory) for trajectory in trajectories])
            name = blake3(content).hex()
            _keep(self._documents / f"{name}.json", lambda: content)
            _remember(self._demonstrations, trajectories, name)
        return name

    def _seen(self, steps: Iterable[RememberedStep | DemonstrationStep]) -> list[Json]:
        return [
            _told(
                frame=None if step.frame is None else self._view(step.frame),
                action=_words(step.action),
            )
            for step in steps
        ]


def _answered(request: Request, decision: Decision) -> Json:
    asked = request.images()
    return _told(
        outcome=decision.outcome.words,
        action=_words(decision.action),
        images_asked=asked,
        images=asked if decision.images is None else int(decision.images),
    )


def _used(usage: Usage) -> Json:
    names = (
        "prompt_tokens",
        "completion_tokens",
        "cached_tokens",
        "image_tokens",
        "memory_tokens",
    )
    counts = {name: getattr(usage, name) for name in names}
    return {
        **{name: int(count) for name, count in counts.items() if count is not None},
        "attempts": int(usage.attempts),
        "replayed": bool(usage.replayed),
    }


def _told(**values: Any) -> Json:
    """What is not `None`."""
    return {name: value for name, value in values.items() if value is not None}


def _words(action: Action | None) -> str | None:
    return None if action is None else action.words


def _utf8(text: str) -> bytes:
    # A server's reply can hold half a surrogate pair, which is no character.
    return text.encode("utf-8", "replace")


def _json(value: Any) -> bytes:
    return _utf8(json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=str))


def _fingerprint(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=16).digest()


def _remember(names: dict[Any, str], what: Any, name: str) -> None:
    if len(names) >= _MOST_REMEMBERED:
        names.clear()
    names[what] = name


def _try(path: Path, do: Callable[[], Any]) -> Any:
    try:
        return do()
    except OSError as error:
        why = error.strerror or str(error)
        raise PromptLogError(f"cannot keep the prompt log: {path}: {why}") from error


def _keep(path: Path, make: Callable[[], bytes]) -> bytes:
    """What is in a file whose name says its content. It is made unless it is there: whole or not at all."""

    def keep() -> bytes:
        try:
            return path.read_bytes()
        except FileNotFoundError:
            content = make()
            draft = path.with_suffix(f".new-{os.getpid()}")
            draft.write_bytes(content)
            draft.rename(path)
            return content

    content: bytes = _try(path, keep)
    return content


def _open_lines(path: Path) -> int:
    """Opens a file of lines to add to: a line that was never finished is cut off."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        whole = path.read_bytes().rfind(b"\n") + 1
        os.ftruncate(file, whole)
        os.lseek(file, whole, os.SEEK_SET)
    except OSError:
        os.close(file)
        raise
    return file


def _write(file: int, content: bytes) -> None:
    left = memoryview(content)
    while left:
        left = left[os.write(file, left) :]
