"""Checks every request it is given and writes what it sees to a file, one JSON object per line.

    observer.py FILE

The objects have the form of the `request` of a prompt log, with texts in place of their hashes.
"""

import json
import mmap
import sys

import numpy as np

from memtransfer import Action, Document, Frame, Policy, RememberedView, run


class Observer(Policy):
    name = "observer"

    def __init__(self, file):
        self.file = open(file, "a", encoding="utf-8")

    def facts(self):
        return {"model": "none"}

    def act(self, batch):
        lanes = [request.lane for request in batch]
        assert lanes == sorted(set(lanes)), f"one request per lane, in order: {lanes}"
        for request in batch:
            check_pixels(request.frame)
            line = {"episode": request.episode, "step": request.step, "lane": request.lane}
            self.file.write(json.dumps({**line, "request": seen(request)}) + "\n")
        self.file.flush()
        return [Action(request.step % 7) for request in batch]


def seen(request):
    told = {
        "repeat": request.repeat,
        "seed": request.episode_seed,
        "instruction": request.instruction,
        "state": list(request.state),
        "feedback": request.feedback.words,
        "frame": request.frame.content_hash.hex(),
        "starts_as_demonstrated": request.starts_as_demonstrated,
        **({"demonstrated_elsewhere": True} if request.demonstrated_elsewhere else {}),
        "window": [{**step(past), "feedback": past.feedback.words} for past in request.window],
    }
    views = [past.frame for past in request.window]
    told["items"] = [item(it, views) for it in request.items]
    assert request.images() == 1 + len(views)
    for view in views:
        check_pixels(view)
    return told


def item(of, views):
    """Returns an item in the form of the prompt log, and adds its views to `views`."""
    if isinstance(of, Document):
        return {"text": {"kind": of.kind.words, "text": of.text}}
    if isinstance(of, RememberedView):
        views.append(of.frame)
        return {"frame": {"instruction": of.instruction, "frame": of.frame.content_hash.hex(), "caption": of.caption}}
    views += [remembered.frame for remembered in of.steps if remembered.frame is not None]
    steps = [*map(step, of.steps)]
    if of.is_trajectory:
        return {"trajectory": {"instruction": of.instruction, "steps": steps}}
    distance = {} if of.distance is None else {"distance": of.distance}
    return {"segment": {**distance, "instruction": of.instruction, "steps": steps}}


def step(of):
    told = {} if of.frame is None else {"frame": of.frame.content_hash.hex()}
    return told if of.action is None else {**told, "action": of.action.words}


def check_pixels(frame):
    """The pixels are the simulator's own memory, which this process cannot write to."""
    pixels = frame.pixels
    assert (pixels.shape, pixels.dtype) == ((frame.height, frame.width, 4), np.uint8)
    assert Frame.of(pixels).content_hash == frame.content_hash
    address = pixels.ctypes.data
    assert not pixels.flags.owndata and not pixels[3:, :, :3].flags.owndata
    assert address % mmap.PAGESIZE == 0 and frame.pixels.ctypes.data == address
    permissions, path = mapping_of(address)
    assert permissions == "r--s" and path.startswith("/dev/shm/"), (permissions, path)
    assert memoryview(pixels).readonly
    for write in (
        lambda: pixels.__setitem__((0, 0, 0), 1),
        lambda: pixels[2].fill(0),
        lambda: np.add(pixels, 1, out=pixels),
        lambda: pixels.setflags(write=True),
        lambda: pixels.view().setflags(write=True),
    ):
        try:
            write()
        except ValueError:
            continue
        raise AssertionError("the pixels could be written to")


def mapping_of(address):
    """Permissions and file of the memory mapping that contains an address of this process."""
    with open("/proc/self/maps", encoding="utf-8") as maps:
        for line in maps:
            span, permissions, *_, path = line.split()
            start, end = (int(part, 16) for part in span.split("-"))
            if start <= address < end:
                return permissions, path
    raise AssertionError(f"nothing is mapped at {address:x}")


run(Observer(sys.argv[1]))
