"""The prompt is the harness's own: rendered from its texts, and compared with its golden files."""

from __future__ import annotations

import base64
import json
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from memtransfer import (
    Action,
    DemonstrationStep,
    Document,
    DocumentKind,
    Feedback,
    Frame,
    Heading,
    PastStep,
    Pose,
    RememberedStep,
    Request,
    Segment,
)
from memtransfer import prompt as prompts

POLICY = Path(__file__).parents[2] / "policy-proc"
GOLDEN = sorted((POLICY / "tests/prompt").glob("*.json"))


def frame(name: str) -> Frame:
    return Frame.of(np.zeros((1, 1, 4), dtype=np.uint8), content_hash=bytes.fromhex(name))


def action(name: str | None) -> Action | None:
    return None if name is None else Action[name.upper()]


def request(plain: dict[str, Any]) -> Request:
    """A request in the plain form of the golden files."""
    segment = plain["segment"]
    if segment is not None:
        distance = float("nan") if segment["distance"] is None else segment["distance"]
        steps = (RememberedStep(frame(it["view"]), action(it["action"])) for it in segment["steps"])
        segment = Segment(distance, tuple(steps))
    return Request(
        lane=0,
        step=len(plain["window"]),
        episode=1,
        episode_seed=0,
        repeat=1,
        instruction=plain["instruction"],
        pose=Pose(plain["pose"]["column"], plain["pose"]["row"], Heading[plain["pose"]["heading"]]),
        feedback=Feedback[plain["feedback"].upper()],
        frame=frame(plain["view"]),
        window=[
            PastStep(frame(it["view"]), action(it["action"]), Feedback[it["feedback"].upper()])
            for it in plain["window"]
        ],
        segment=segment,
        documents=[
            Document(0, DocumentKind[it["kind"].upper()], it["text"]) for it in plain["documents"]
        ],
        trajectories=[
            tuple(
                DemonstrationStep(it["view"] and frame(it["view"]), action(it["action"]))
                for it in steps
            )
            for steps in plain["trajectories"]
        ],
        starts_as_demonstrated=plain["starts_as_demonstrated"],
    )


def test_there_are_golden_files() -> None:
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


@pytest.mark.skipif(sys.version_info < (3, 11), reason="reading TOML came with Python 3.11")
def test_the_texts_are_the_harness_s() -> None:
    import tomllib

    texts = tomllib.loads((POLICY / "prompt/v1.toml").read_text(encoding="utf-8"))
    assert dict(prompts.TEMPLATE) == texts, (
        "policy-proc/prompt/v1.toml has changed: write it to python/memtransfer/_prompt.json with\n"
        "  python python/tests/copy_prompt.py"
    )


def test_names_are_replaced_once_and_other_braces_stay() -> None:
    assert prompts._fill("{a} and {b}", a="{b}", b="B") == "{b} and B"
    assert prompts._fill("{c} {a", a="A") == "{c} {a"
    assert prompts._fill("{{b}}", b="B") == "{B}"


def test_a_png_file_holds_the_pixels() -> None:
    picture = np.random.default_rng(2).integers(0, 256, (3, 5, 4), dtype=np.uint8)
    url = prompts.data_url(Frame.of(picture))
    kind, _, content = url.partition(",")
    assert kind == "data:image/png;base64"
    file = base64.b64decode(content)
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(file):
        (length,) = struct.unpack_from(">I", file, at)
        kind_and_content = file[at + 4 : at + 8 + length]
        (crc,) = struct.unpack_from(">I", file, at + 8 + length)
        assert crc == zlib.crc32(kind_and_content)
        chunks[kind_and_content[:4]] = kind_and_content[4:]
        at += 12 + length
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    assert struct.unpack(">IIBBBBB", chunks[b"IHDR"]) == (5, 3, 8, 2, 0, 0, 0)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(3, 16)
    assert not rows[:, 0].any()
    assert np.array_equal(rows[:, 1:].reshape(3, 5, 3), picture[:, :, :3])


def test_a_view_is_encoded_once() -> None:
    picture = np.full((4, 4, 4), 7, dtype=np.uint8)
    first = prompts.data_url(Frame.of(picture, id=1))
    assert prompts.data_url(Frame.of(picture, id=2)) is first


ANSWERS = json.loads((Path(__file__).parent / "answers.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("text", "expected"), ANSWERS)
def test_answers(text: str, expected: str) -> None:
    """The harness's tests put the same table to its own parser, and many more texts to both."""
    assert prompts.read_answer(text).name.lower() == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("turn left\n\nThe barrel is on the le", "turn_left"),
        ("Turn left. I see a blue barrel at the end of the", "turn_left"),
        ("I see.\nAction: turn left.\nThis is bec", "turn_left"),
        ("turn left", "unreadable"),
        ("Turn left. Then move forward. Then", "unreadable"),
        ("<think>I should turn left.\n", "unreadable"),
        ("", "empty"),
    ],
)
def test_answers_that_were_cut_off(text: str, expected: str) -> None:
    assert prompts.read_answer(text, cut_off=True).name.lower() == expected


def test_nothing_makes_reading_fail() -> None:
    for text in ("{" * 5000 + "}", "[" * 5000 + '{"action": 1}', '{"action": NaN}', "\ud800", "{}"):
        prompts.read_answer(text)
