"""What stands in a prompt log, and what happens when it cannot be kept."""

from __future__ import annotations

import base64
import json
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peer import Peer, text

from memtransfer import (
    Action,
    Answer,
    AttachError,
    Decision,
    Exchange,
    Failed,
    Frame,
    Heading,
    Policy,
    Pose,
    PromptLogError,
    Request,
    Usage,
    _attach,
    _wire,
    serve,
)
from memtransfer._blake3 import blake3
from memtransfer._prompt_log import PromptLog
from memtransfer._wire import NO_ACTION, ComplaintKind, DocumentKind
from memtransfer.prompt import data_url, image_name, png, render


class Answers(Policy):
    """Answers with what is left of a list."""

    def __init__(self, *answers: Answer) -> None:
        self.left = list(answers)
        self.asked: list[Request] = []

    def act(self, batch: Any) -> list[Answer]:
        self.asked += batch
        return [self.left.pop(0) for _ in batch]


def entries(prompts: Path, generation: int = 1) -> list[Any]:
    lines = (prompts / f"session-2/generation-{generation}.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in lines.splitlines()]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize(
    ("length", "name"),
    [
        (0, "af1349b9f5f9a1a6a0404dea36dcc949"),
        (1, "2d3adedff11b61f14c886e35afa03673"),
        (64, "4eed7141ea4a5cd4b788606bd23f46e2"),
        (65, "de1e5fa0be70df6d2be8fffd0e99ceaa"),
        (1024, "42214739f095a406f3fc83deb889744a"),
        (1025, "d00278ae47eb27b34faecf67b4fe263f"),
        (3072, "b98cb0ff3623be03326b373de6b90952"),
        (31744, "62b6960e1a44bcc1eb1a611a8d6235b6"),
        (102400, "bc3e3d41a1146b069abffad3c0d44860"),
    ],
)
def test_hashes_are_those_of_the_reference(length: int, name: str) -> None:
    assert blake3(bytes(i % 251 for i in range(length))).hex() == name


def test_what_was_asked_and_answered_is_kept(tmp_path: Path) -> None:
    usage = Usage(prompt_tokens=900, attempts=2, sent_ns=7)
    policy = Answers(
        Action.FORWARD,
        Decision(None, _wire.Outcome.REFUSED, images=0, usage=usage),
        Failed("gone"),
        None,
    )
    with Peer() as peer:
        peer.write(prompts=str(tmp_path / "session-2"))
        with peer.serve(policy):
            now, *past = [peer.publish_frame(value) for value in (1, 2, 3)]
            steps = struct.pack(
                "<QBB6xQBB6xQBB6x", now, 5, 0, 0, NO_ACTION, 0, past[1], NO_ACTION, 1
            )
            peer.publish_document(11, DocumentKind.SUMMARY, "Küche im Osten".encode())
            peer.publish_document(12, DocumentKind.TRAJECTORIES, steps)
            peer.brief(episode=9, seed=99, starts_as_demonstrated=1, instruction="Find a „Kegel“.")
            peer.step(now, episode=9, documents=[11, 12])
            peer.await_(_wire.Decision)
            peer.step(
                past[0],
                episode=9,
                step=1,
                pose=(3, 12, 0),
                feedback=3,
                window=[(now, 4, 2), (now, NO_ACTION, 4)],
                segment=[(past[1], 3), (now, NO_ACTION)],
                documents=[11, 12],
            )
            peer.await_(_wire.Decision)
            # Written before the answer left.
            assert len(entries(tmp_path)) == 2
            for episode in (10, 11):
                peer.brief(episode=episode)
                peer.step(now, episode=episode)
                peer.await_(_wire.Complaint if episode == 10 else _wire.Decision)
    first, second, third, fourth = entries(tmp_path)
    assert (first["episode"], first["step"], first["lane"]) == (9, 0, 0)
    line = (tmp_path / "session-2/generation-1.jsonl").read_text(encoding="utf-8")
    assert line.startswith('{"episode":9,"step":0,"lane":0,"request":{"repeat":1,"seed":99,')
    assert "Find a „Kegel“." in line
    asked = first["request"]
    document, demonstrations = asked.pop("documents"), asked.pop("trajectories")
    assert asked == {
        "repeat": 1,
        "seed": 99,
        "instruction": "Find a „Kegel“.",
        "pose": "3,12,E",
        "feedback": "The episode has just begun.",
        "frame": "01" * 16,
        "starts_as_demonstrated": True,
        "window": [],
    }
    assert first["answer"] == {
        "outcome": "acted",
        "action": "move forward",
        "images_asked": 3,
        "images": 3,
    }
    assert "usage" not in first and "exchange" not in first and "failed" not in first
    assert first["timing"]["prompted_ns"] == first["timing"]["sent_ns"] == 0
    times = [first["timing"][name] for name in ("received_ns", "started_ns", "decided_ns")]
    assert 0 < times[0] <= times[1] <= times[2]

    asked = second["request"]
    assert (asked["documents"], asked["trajectories"]) == (document, demonstrations)
    assert asked["window"] == [
        {"frame": "01" * 16, "action": "turn left", "feedback": "You turned."},
        {
            "frame": "01" * 16,
            "feedback": "Your last answer was not understood: you did not move.",
        },
    ]
    assert asked["segment"] == {
        "distance": 0.25,
        "steps": [{"frame": "03" * 16, "action": "move right"}, {"frame": "01" * 16}],
    }
    assert second["answer"] == {"outcome": "refused", "images_asked": 7, "images": 0}
    assert second["usage"] == {"prompt_tokens": 900, "attempts": 2, "replayed": False}
    assert second["timing"]["sent_ns"] == 7

    assert (third["failed"], "answer" in third) == ("gone", False)
    assert fourth["answer"] == {"outcome": "unreadable", "images_asked": 1, "images": 1}

    # Everything once, under the name of its content.
    assert names(tmp_path / "images") == [f"{value:02x}" * 16 + ".png" for value in (1, 2, 3)]
    kept = tmp_path / "images" / ("03" * 16 + ".png")
    assert kept.read_bytes() == png(Frame.of(np.full((16, 64, 4), 3, dtype=np.uint8)))
    (summary,) = document
    assert summary["kind"] == "summary"
    files = {path.name: path.read_bytes() for path in (tmp_path / "documents").iterdir()}
    assert files == {
        f"{summary['text']}.txt": "Küche im Osten".encode(),
        f"{demonstrations}.json": (
            b'[[{"frame":"01010101010101010101010101010101","action":"turn right"},{}],'
            b'[{"frame":"03030303030303030303030303030303"}]]'
        ),
    }
    assert all(blake3(content).hex() == name.split(".")[0] for name, content in files.items())


def request(value: int = 150) -> Request:
    return Request(
        lane=0,
        step=3,
        episode=1,
        episode_seed=5,
        repeat=1,
        instruction="Find a blue barrel.",
        pose=Pose(3, 12, Heading.N),
        feedback=_wire.Feedback.MOVED,
        frame=Frame.of(np.full((64, 64, 4), value, dtype=np.uint8)),
    )


def written(prompts: Path, exchange: Exchange) -> Any:
    """What the log makes of an exchange about `request()`."""
    log = PromptLog(prompts / "session-2", 1)
    asked = log.asked(request())
    log.write(request(), asked, Decision(Action.LEFT, exchange=exchange), (1, 2, 3))
    log.close()
    return entries(prompts)[-1]["exchange"]


def test_an_exchange_has_its_images_and_long_texts_by_name(tmp_path: Path) -> None:
    prompt = render(request())
    view = request().frame.content_hash.hex()
    exchange = written(tmp_path, Exchange(prompt.messages(), "no \ud83d idea", unread="unreadable"))
    # Half a pair is no character.
    assert (exchange["reply"], exchange["unread"]) == ("no ? idea", "unreadable")
    system, user = exchange["messages"]
    assert (system["role"], user["role"]) == ("system", "user")
    (rules,) = system["parts"]
    stored = (tmp_path / "documents" / f"{rules['stored']}.txt").read_text(encoding="utf-8")
    assert stored == prompt.system
    expected = [
        {"text": part.text} if part.frame is None else {"image": view} for part in prompt.parts
    ]
    assert user["parts"] == expected
    assert names(tmp_path / "images") == [f"{view}.png"]
    # By their names alone, too.
    again = written(tmp_path, Exchange(prompt.messages(url=image_name)))
    assert again == {"messages": exchange["messages"]}


def test_what_a_policy_of_one_s_own_says_is_kept_as_far_as_can_be(tmp_path: Path) -> None:
    other = png(Frame.of(np.zeros((2, 2, 4), dtype=np.uint8)))
    jpeg = "data:image/jpeg;base64," + base64.b64encode(b"\xff\xd8\xff").decode()

    def image(url: str) -> dict[str, Any]:
        return {"type": "image_url", "image_url": {"url": url}}

    content = [
        image("data:image/png;base64," + base64.b64encode(other).decode()),
        image(jpeg),
        image("data:image/png;base64,?"),
        image("https://example.org/a.png"),
        image("image:" + "0" * 32),
        {"type": "input_image", "image_url": data_url(request().frame)},
        {"type": "strange", "value": 3},
    ]
    call = {"role": "assistant", "content": None, "tool_calls": [{"id": "a"}], "refusal": None}
    exchange = written(tmp_path, Exchange([{"role": "user", "content": content}, call]))
    user, assistant = exchange["messages"]
    assert user["parts"] == [
        {"image": blake3(other).hex()},
        {"text": "[an image (image/jpeg, 3 bytes) that is not kept]"},
        {"text": "[an image (image/png) that is not base64]"},
        {"text": "[the image at https://example.org/a.png]"},
        {"text": "[the image at image:" + "0" * 32 + "]"},
        {"image": request().frame.content_hash.hex()},
        {"text": '{"type":"strange","value":3}'},
    ]
    assert assistant["parts"] == [{"text": '{"tool_calls":[{"id":"a"}]}'}]
    assert (tmp_path / "images" / f"{blake3(other).hex()}.png").read_bytes() == other


def test_an_exchange_that_is_none_is_an_error_with_or_without_a_log() -> None:
    with pytest.raises(TypeError, match="a message of an exchange is a str"):
        Exchange("hello")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="reply of an exchange is a int"):
        Exchange([], reply=3)  # type: ignore[arg-type]


def test_decisions_that_differ_in_what_was_said_are_equal() -> None:
    said = Decision(Action.LEFT, exchange=Exchange([{"role": "user", "content": "x"}]))
    assert said == Decision(Action.LEFT) and hash(said) == hash(Decision(Action.LEFT))


@pytest.mark.parametrize(
    ("found", "kept"), [("", ""), ('{}\n{"ep', "{}\n"), ("{}\n", "{}\n"), ("{", "")]
)
def test_a_line_that_was_being_written_is_cut_off(tmp_path: Path, found: str, kept: str) -> None:
    path = tmp_path / "session-2/generation-1.jsonl"
    path.parent.mkdir()
    path.write_text(found)
    written(tmp_path, Exchange([]))
    line = path.read_text()
    assert line.startswith(kept + '{"episode":1,') and line.endswith("}\n")


def test_a_generation_adds_a_file(tmp_path: Path) -> None:
    with Peer() as peer:
        peer.write(prompts=str(tmp_path / "session-2"))
        with peer.serve(Answers(Action.LEFT, Action.RIGHT)):
            for generation in (1, 2):
                if generation == 2:
                    peer.write(generation=2)
                    peer.join()
                    peer.await_(_wire.Hello)
                peer.brief(episode=generation)
                peer.step(peer.publish_frame(1), episode=generation)
                peer.await_(_wire.Decision)
    assert [entry["episode"] for n in (1, 2) for entry in entries(tmp_path, n)] == [1, 2]
    assert len(names(tmp_path / "images")) == 1


def test_a_log_that_cannot_be_kept_stops_the_run(tmp_path: Path) -> None:
    policy = Answers(Action.LEFT, Action.LEFT)
    with Peer() as peer:
        peer.write(prompts=str(tmp_path / "session-2"))
        with peer.serve(policy):
            peer.brief()
            peer.step(peer.publish_frame(1))
            peer.await_(_wire.Decision)
            shutil.rmtree(tmp_path / "images")
            unseen = peer.publish_frame(2)
            peer.step(unseen, step=1)
            (complaint,) = peer.await_(_wire.Complaint)
            assert complaint.kind == ComplaintKind.RUN
            said = text(complaint.text, complaint.text_len)
            assert said.startswith(f"cannot keep the prompt log: {tmp_path}/images/"), said
            peer.step(unseen, step=2)
    # Nothing is asked any more.
    assert [request.step for request in policy.asked] == [0]


def test_an_answer_that_cannot_be_kept_does_not_leave(tmp_path: Path) -> None:
    class Removes(Policy):
        """Leaves no place for what it says."""

        def act(self, batch: Any) -> list[Answer]:
            shutil.rmtree(tmp_path / "documents")
            messages = [{"role": "user", "content": "x" * 5000}]
            return [Decision(Action.LEFT, exchange=Exchange(messages))]

    with Peer() as peer:
        peer.write(prompts=str(tmp_path / "session-2"))
        with peer.serve(Removes()):
            peer.brief()
            peer.step(peer.publish_frame(1))
            (complaint,) = peer.await_(_wire.Complaint)
            assert complaint.kind == ComplaintKind.RUN
        assert peer.await_(_wire.Decision, 0) == []
    assert entries(tmp_path) == []


def test_a_log_that_cannot_be_begun_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "session-2").write_text("")
    with Peer() as peer:
        peer.write(prompts=str(tmp_path / "session-2"))
        with pytest.raises(PromptLogError, match="cannot keep the prompt log: .*session-2"):
            serve(Answers(), peer.root)
        peer.write(prompts="session-2")
        with pytest.raises(
            AttachError, match="prompts is 'session-2', but must be an absolute path"
        ):
            _attach.read(peer.root)
