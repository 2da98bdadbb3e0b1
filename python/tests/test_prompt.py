"""The prompt and the reading of answers, against the golden files of the Rust crate."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from memtransfer import (
    Action,
    Document,
    DocumentKind,
    Feedback,
    Frame,
    Heading,
    Item,
    Outcome,
    PastStep,
    Pose,
    RememberedStep,
    RememberedView,
    Request,
    Segment,
)
from memtransfer import prompt as prompts

GOLDEN = sorted((Path(__file__).parents[2] / "crates/prompt/tests/cases").glob("*.json"))


def frame(name: str) -> Frame:
    return Frame.of(np.zeros((1, 1, 4), dtype=np.uint8), content_hash=bytes.fromhex(name))


def action(name: str | None) -> Action | None:
    return None if name is None else Action[name.upper()]


def request(plain: dict[str, Any]) -> Request:
    """Returns a request from its form in the golden files."""
    return Request(
        lane=0,
        step=len(plain["window"]),
        episode=1,
        episode_seed=0,
        repeat=1,
        instruction=plain["instruction"],
        state=Pose(plain["pose"]["column"], plain["pose"]["row"], Heading[plain["pose"]["heading"]]).state,
        feedback=Feedback[plain["feedback"].upper()],
        frame=frame(plain["view"]),
        window=[
            PastStep(frame(it["view"]), action(it["action"]), Feedback[it["feedback"].upper()])
            for it in plain["window"]
        ],
        items=[item(it) for it in plain["items"]],
        starts_as_demonstrated=plain["starts_as_demonstrated"],
        demonstrated_elsewhere=plain.get("demonstrated_elsewhere", False),
    )


def item(plain: dict[str, Any]) -> Item:
    ((kind, of),) = plain.items()
    if kind == "text":
        return Document(0, DocumentKind[of["kind"].upper()], of["text"])
    if kind == "frame":
        return RememberedView(frame(of["view"]), of["caption"])
    steps = (
        RememberedStep(it["view"] and frame(it["view"]), action(it["action"])) for it in of["steps"]
    )
    return Segment(of["distance"], tuple(steps), of["is_whole"])


def test_golden_files_exist() -> None:
    assert len(GOLDEN) > 10


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_files(path: Path) -> None:
    case = json.loads(path.read_text(encoding="utf-8"))
    prompt = prompts.render(request(case["request"]), case["image_budget"])
    expected = case["outcome"]
    assert prompt.messages(prompts.image_name) == expected["messages"]
    assert [part.section for part in prompt.parts] == expected["sections"]
    assert (prompt.images_asked, prompt.images_sent) == (
        expected["images_asked"],
        expected["images_sent"],
    )
    assert {name: prompt.images(name) for name in prompts.SECTIONS} == expected["images"]
    assert {name: prompt.characters(name) for name in prompts.SECTIONS} == expected["characters"]


def test_settings_are_arguments_of_a_client() -> None:
    assert prompts.SETTINGS == {"temperature": 0, "max_tokens": 30}
    assert prompts.IMAGE_BUDGET == 50
    assert prompts.VERSION == prompts.TEMPLATE["version"]
    assert prompts.CHOICES == tuple(action.words for action in Action)


def test_png_holds_the_pixels_without_alpha() -> None:
    image = np.random.default_rng(2).integers(0, 256, (3, 5, 4), dtype=np.uint8)
    kind, _, content = prompts.data_url(Frame.of(image)).partition(",")
    assert kind == "data:image/png;base64"
    assert np.array_equal(decoded(base64.b64decode(content)), image[:, :, :3])


def decoded(file: bytes) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Decodes an RGB PNG file."""
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    chunks: dict[bytes, bytes] = {}
    at = 8
    while at < len(file):
        (length,) = struct.unpack_from(">I", file, at)
        kind = file[at + 4 : at + 8]
        chunks[kind] = chunks.get(kind, b"") + file[at + 8 : at + 8 + length]
        at += 12 + length
    width, height, depth, colour, *_ = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert (depth, colour) == (8, 2)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 1 + 3 * width)
    image = np.zeros((height, width, 3), dtype=np.uint8)
    for y in range(height):
        above = image[y - 1] if y else np.zeros((width, 3), dtype=np.uint8)
        for x in range(width):
            left = image[y, x - 1] if x else np.zeros(3, dtype=np.uint8)
            corner = above[x - 1] if x else np.zeros(3, dtype=np.uint8)
            a, b, c = left.astype(int), above[x].astype(int), corner.astype(int)
            p = a + b - c
            pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
            paeth = np.where((pa <= pb) & (pa <= pc), a, np.where(pb <= pc, b, c))
            predicted = [0 * a, a, b, (a + b) // 2, paeth][rows[y, 0]]
            image[y, x] = (rows[y, 1 + 3 * x : 4 + 3 * x] + predicted) % 256
    return image


def test_a_view_is_encoded_once() -> None:
    image = np.full((4, 4, 4), 7, dtype=np.uint8)
    assert prompts.png(Frame.of(image, id=1)) is prompts.png(Frame.of(image, id=2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("move forward", Action.FORWARD),
        ('{"action": "turn_left"}', Action.TURN_LEFT),
        ("", Outcome.EMPTY),
        ("I see a barrel.", Outcome.UNREADABLE),
        ("see \ud800", Outcome.UNREADABLE),
    ],
)
def test_answers(text: str, expected: Action | Outcome) -> None:
    assert prompts.read_answer(text) is expected
    cut_off = expected if isinstance(expected, Action) else Outcome.CUT_OFF
    assert prompts.read_answer(text, cut_off=True) is cut_off
