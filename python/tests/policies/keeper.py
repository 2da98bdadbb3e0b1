"""Keeps every frame and every request, the pixels of one view, and a copy of one request. What it keeps never changes, and
reading a frame that the run has evicted raises `FrameGone`. Writes what it observed to a file.

    keeper.py FILE
"""

import copy
import pickle
import random
import sys

from memtransfer import Action, FrameGone, Policy, run


class Keeper(Policy):
    name = "keeper"

    def __init__(self, file):
        self.file = file
        self.frames = []
        self.requests = []
        self.kept = self.copy = None
        self.copies = ()
        self.shown = None
        self.gone = 0

    def act(self, batch):
        for request in batch:
            if self.kept is None:
                # Part of a part: an array keeps the memory that it shows.
                self.kept = request.frame.pixels[4:20, :, :3][1:]
                self.copy = self.kept.copy()
            elif not self.copies:
                self.copies = (copy.deepcopy(request), pickle.loads(pickle.dumps(request)))
                self.shown = request.frame.pixels.copy()
            self.frames.append(request.frame)
            self.requests.append(request)
        assert (self.kept == self.copy).all()
        for copied in self.copies:
            assert (copied.frame.pixels == self.shown).all()
            assert copied.images() == 1 + len(copied.window)
        gone = [frame for frame in self.frames if frame.is_gone]
        for frame in gone:
            assert "copy the pixels that you want to keep" in raised(lambda: frame.pixels)
        self.gone += len(gone)
        self.frames = [frame for frame in self.frames if not frame.is_gone]
        if self.gone and len(self.requests) > len(batch):
            # The request is answered, and its window was never read.
            earlier = self.requests[0]
            assert earlier.frame.id >= 0
            assert "the request's window is gone" in raised(lambda: earlier.window)
            with open(self.file, "w", encoding="utf-8") as file:
                file.write(f"{self.gone} frames are gone")
        return [wander(request) for request in batch]


def wander(request):
    """A random action, so that the agent sees many views."""
    return random.Random(request.episode_seed * 1000 + request.step).choice(list(Action))


def raised(look):
    try:
        look()
    except FrameGone as error:
        return str(error)
    raise AssertionError("nothing was raised")


run(Keeper(sys.argv[1]))
