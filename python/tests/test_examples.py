"""Functions of the examples. The tests of the harness run the examples in episodes."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from memtransfer import Action, Decision, Failed, Feedback, Frame, Heading, Outcome, Pose, Request

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))

import endpoint_policy  # noqa: E402
import gym_random  # noqa: E402
import pixels_policy  # noqa: E402
import random_policy  # noqa: E402


def request(step: int = 0, value: int = 150) -> Request:
    return Request(
        lane=0,
        step=step,
        episode=1,
        episode_seed=5,
        repeat=1,
        instruction="Find a blue barrel.",
        state=Pose(3, 12, Heading.N).state,
        feedback=Feedback.START,
        frame=Frame.of(np.full((64, 64, 4), value, dtype=np.uint8)),
    )


def test_random_actions_depend_on_the_request_alone() -> None:
    policy = random_policy.Random()
    walk = policy.act([request(step) for step in range(200)])
    assert walk == [policy.act([request(step)])[0] for step in range(200)]
    assert set(walk) == set(Action)


def test_bare_floor_is_distinguished_from_objects() -> None:
    policy = pixels_policy.Pixels()
    free = policy.act([request(step) for step in range(50)])
    assert free.count(Action.FORWARD) > 30
    blocked = policy.act([request(step, value=60) for step in range(50)])
    assert Action.FORWARD not in blocked


def test_a_random_agent_acts_in_the_environment(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gym_random.py", "--episodes", "1", "--frame-size", "64"])
    gym_random.main()
    assert " of 1 episodes succeeded, " in capsys.readouterr().out


class Server:
    """A model's server: sends `replies` one after the other, and records the requests."""

    def __init__(self) -> None:
        self.replies: list[tuple[int, str]] = []
        self.asked: list[dict[str, Any]] = []
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                length = int(self.headers["Content-Length"])
                server.asked.append(json.loads(self.rfile.read(length)))
                status, text = server.replies.pop(0)
                message = {"role": "assistant", "content": text}
                choice = {"index": 0, "message": message, "finish_reason": "stop"}
                usage = {"prompt_tokens": 900, "completion_tokens": 3, "total_tokens": 903}
                body = {
                    "id": "1",
                    "object": "chat.completion",
                    "created": 0,
                    "model": "m",
                    "choices": [choice],
                    "usage": usage,
                }
                content = json.dumps(body).encode()
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, format: str, *_: object) -> None:
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.http.serve_forever, daemon=True).start()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    server = Server()
    monkeypatch.setenv("OPENAI_BASE_URL", f"http://127.0.0.1:{server.http.server_port}/v1")
    monkeypatch.setenv("OPENAI_API_KEY", "none")
    yield server
    server.http.shutdown()
    server.http.server_close()


def test_the_endpoint_receives_the_prompt_of_the_benchmark(server: Server) -> None:
    policy = endpoint_policy.Endpoint("m", image_budget=50)
    assert policy.facts() == {"model": "m", "prompt": "prompt/2"}
    server.replies = [(200, "Turn left."), (200, "no idea"), (200, ""), (400, "")]
    answers = [policy.act([request()])[0] for _ in range(4)]
    decided, unreadable, empty, failed = answers
    assert isinstance(decided, Decision) and isinstance(unreadable, Decision)
    assert isinstance(empty, Decision) and isinstance(failed, Failed)
    assert decided.action is Action.TURN_LEFT and decided.images == 1
    assert decided.usage is not None and decided.usage.prompt_tokens == 900
    assert (unreadable.action, unreadable.outcome) == (None, Outcome.UNREADABLE)
    assert empty.outcome is Outcome.EMPTY
    assert "400" in failed.why
    asked = server.asked[0]
    assert (asked["model"], asked["temperature"], asked["max_tokens"]) == ("m", 0, 30)
    system, user = asked["messages"]
    assert "You control a robot in a warehouse." in system["content"]
    images = [part for part in user["content"] if part["type"] == "image_url"]
    assert len(images) == 1
    assert images[0]["image_url"]["url"].startswith("data:image/png;base64,iVBOR")


def test_requests_of_a_batch_are_in_flight_together(server: Server) -> None:
    policy = endpoint_policy.Endpoint("m", image_budget=0)
    server.replies = [(200, "move forward")] * 8
    answers = policy.act([request(step) for step in range(8)])
    assert [answer.action for answer in answers] == [Action.FORWARD] * 8
    assert all(isinstance(asked["messages"][1]["content"], str) for asked in server.asked)
