"""A policy with one trait, named on the command line: `scripted.py TRAIT`."""

import atexit
import base64
import random
import sys
import time

import numpy as np

from memtransfer import (
    EMPTY,
    Action,
    Decision,
    Exchange,
    Failed,
    Frame,
    Outcome,
    Policy,
    Usage,
    run,
)
from memtransfer.prompt import data_url, image_name, png, render


def every_answer(request):
    """All forms of answers in turn."""
    usage = Usage(100, 3, image_tokens=0, attempts=2, replayed=True, prompted_ns=5, sent_ns=6)
    return [
        Action.TURN_AROUND,
        None,
        EMPTY,
        Outcome.REFUSED,
        Decision(Action.BACKWARD, images=0, usage=usage),
        Decision(None, Outcome.REFUSED),
        Outcome.UNREADABLE,
    ][request.step % 7]


def fails(request):
    """Cannot decide."""
    return Failed("the server is down")


def raises_in_lane_1(request):
    if request.lane == 1:
        raise RuntimeError("cannot do lane 1")
    return Action.TURN_LEFT


def raises(request):
    raise KeyError("weights")


def acted(request):
    return Outcome.ACTED


def number(request):
    return 7


def negative(request):
    return Decision(Action.LEFT, usage=Usage(prompt_tokens=-1))


def asks(request):
    """A conversation with views, other images, and parts that cannot be kept."""

    def image(url):
        return {"type": "image_url", "image_url": {"url": url}}

    other = png(Frame.of(np.full((2, 2, 4), request.step, dtype=np.uint8)))
    content = [
        {"type": "text", "text": "look"},
        image(data_url(request.frame)),
        image(image_name(request.frame)),
        {"type": "input_image", "image_url": data_url(request.frame)},
        image("data:image/png;base64," + base64.b64encode(other).decode()),
        image("data:image/jpeg;base64," + base64.b64encode(b"\xff\xd8\xff").decode()),
        image("data:image/png;base64,?"),
        image("https://example.org/a.png"),
        image("image:" + "0" * 32),
        {"type": "strange", "value": 3},
    ]
    system, _ = render(request).messages()
    call = {"role": "assistant", "content": None, "tool_calls": [{"id": "a"}], "refusal": None}
    messages = [system, {"role": "user", "content": content}, call]
    exchange = Exchange(messages, "no \ud83d idea", unread="no action in it")
    return Decision(None, Outcome.UNREADABLE, exchange=exchange)


def wander(request):
    """A random action, so that the agent sees many views."""
    return random.Random(request.episode_seed * 1000 + request.step).choice(list(Action))


class Scripted(Policy):
    def __init__(self, trait):
        self.name = trait
        self.answer = globals().get(trait)

    def act(self, batch):
        return [self.answer(request) for request in batch]


class NoAnswers(Scripted):
    def act(self, batch):
        return []


class ReturnsNone(Scripted):
    def act(self, batch):
        return None


class LeavesSlowly(Scripted):
    """Its interpreter takes a second to end, as one with large libraries does."""

    def act(self, batch):
        atexit.register(time.sleep, 1)


class RaisesOnReset(Scripted):
    def reset(self, lane):
        raise RuntimeError("cannot reset")


class Interrupted(Scripted):
    def act(self, batch):
        raise KeyboardInterrupt


class Hoards(Scripted):
    kept = []

    def act(self, batch):
        self.kept += [request.frame.pixels for request in batch]
        return [wander(request) for request in batch]


class Numbers(Scripted):
    def facts(self):
        return {"parameters": 7}


CLASSES = {
    "no_answers": NoAnswers,
    "returns_none": ReturnsNone,
    "leaves_slowly": LeavesSlowly,
    "raises_on_reset": RaisesOnReset,
    "interrupted": Interrupted,
    "hoards": Hoards,
    "numbers": Numbers,
}

trait = sys.argv[1]
run(CLASSES.get(trait, Scripted)(trait))
