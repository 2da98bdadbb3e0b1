"""The prompt and the reading of answers, against the golden files of the Rust crate."""

from __future__ import annotations

import base64
import copy
import dataclasses
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
    PlannedActions,
    Pose,
    RememberedStep,
    RememberedView,
    Request,
    Segment,
    SuppliedPlan,
    WorldDeclaration,
)
from memtransfer import prompt as prompts
from memtransfer.declaration import WAREHOUSE, Field

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
        return RememberedView(frame(of["view"]), of["caption"], of["instruction"])
    if kind == "plan":
        parts = (
            PlannedActions(tuple(Action[it.upper()] for it in part["actions"]), part.get("instruction"))
            for part in of["parts"]
        )
        return SuppliedPlan(tuple(parts))
    steps = (
        RememberedStep(it["view"] and frame(it["view"]), action(it["action"])) for it in of["steps"]
    )
    return Segment(of["distance"], of["instruction"], tuple(steps), of["is_whole"])


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


LOCK = WorldDeclaration(
    name="lock",
    version="1",
    rules="You open a lock.",
    actions=("pull", "turn left"),
    letters="pl",
    state=(Field("angle", digits=1), Field("bolt", ["open", "shut"])),
    state_sentence="The angle is {angle} and the bolt is {bolt}.",
    feedback=("Begin.", "Click.", "What?"),
    deterministic=True,
)


def test_a_prompt_is_in_the_words_of_its_world() -> None:
    view = frame("00" * 16)
    steps = (RememberedStep(view, 1), RememberedStep(None, None))
    window = [PastStep(view, 0, 2), PastStep(view, None, 1)]
    items = [Segment(0.5, "Close it.", steps)]
    asked = Request(0, 2, 1, 0, 1, "Open it.", (3.25, 1.0), 1, view, window, items, world=LOCK)
    prompt = prompts.render(asked, image_budget=0)
    text = prompt.system + "".join(part.text or "" for part in prompt.parts)
    for words in ("You open a lock.", "The angle is 3.2 and the bolt is shut.", "turn left", "pull", "Click.", "What?", '"Close it."'):
        assert words in text, text
    assert "warehouse" not in text and "move forward" not in text
    for changes, problem in [
        ({"state": (3.25, 2.0)}, "no state of the world lock: bolt is 2, not one of 0 to 1"),
        ({"state": (3.25,)}, "it has 1 numbers in place of 2"),
        ({"feedback": 3}, "3 is not a feedback of this world"),
        ({"window": [PastStep(view, 2, 1)]}, r"2 is no action of the world lock: give the number \(0 to 1\)"),
        ({"window": [PastStep(view, Action.FORWARD, 1)]}, "is no action of the world lock"),
    ]:
        wrong = copy.copy(asked)
        for name, value in changes.items():
            setattr(wrong, name, value)
        with pytest.raises(ValueError, match=problem):
            prompts.render(wrong)
    asked.window = [PastStep(view, "pull", 1), PastStep(view, Action.TURN_LEFT, 1)]  # type: ignore[arg-type]
    assert prompts.render(asked).images_asked == 4
    with pytest.raises(TypeError, match="a world is a WorldDeclaration, not a str"):
        asked.world = "lock"  # type: ignore[assignment]
        prompts.render(asked)


def test_an_answer_is_read_in_the_words_of_its_world() -> None:
    assert prompts.read_answer("I will pull now.", world=LOCK) == 0
    turned = prompts.read_answer("turn left", world=LOCK)
    assert turned == 1 and type(turned) is int
    assert prompts.read_answer("move forward", world=LOCK) is Outcome.UNREADABLE
    assert prompts.read_answer("turn left", world=WAREHOUSE) is Action.TURN_LEFT
    broken = dataclasses.replace(LOCK, name="Lock")
    with pytest.raises(ValueError, match='the declaration of the world is not valid: its "name"'):
        prompts.read_answer("pull", world=broken)


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
