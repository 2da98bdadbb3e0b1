"""A policy or a memory for a world that is not the warehouse, which checks what it is given: `any_world.py policy` or `memory`."""

import pickle
import sys

from memtransfer import Decision, Memory, Outcome, Policy, Steps, run
from memtransfer.prompt import read_answer, render


def has_no_pose(of):
    try:
        of.pose
    except AttributeError as error:
        return "the world corridor has no poses: its states have the numbers cell" in str(error)
    return False


class Walker(Policy):
    """Walks east and names the action in all ways."""

    name = "walker"
    world = None

    def act(self, batch):
        return [self.decide(request) for request in batch]

    def decide(self, request):
        self.world = self.world or request.world
        assert request.world is self.world and self.world.actions == ("walk east", "walk west")
        assert has_no_pose(request) and request.state == (request.state[0],)
        assert type(request.feedback) is int and self.world.feedback[request.feedback]
        assert all(past.action in (0, None) and type(past.feedback) is int for past in request.window)
        (segment,) = (item for item in request.items if isinstance(item.steps, tuple))
        assert segment.steps[0].action in (0, 1, None)
        copied = pickle.loads(pickle.dumps(request))
        assert copied.world == self.world and render(copied).system == render(request).system
        assert f"You are in cell {request.state[0]:.0f}." in "".join(part.text or "" for part in render(request).parts)
        assert read_answer("move forward", world=self.world) is Outcome.UNREADABLE
        east = read_answer("Let me walk east.", world=self.world)
        return [east, "walk east", Decision(0), Decision("walk east")][request.step % 4]


class Follower(Memory):
    """Supplies the steps of the demonstration from where the agent is."""

    frames = True

    def build(self, demonstrations):
        (self.demonstration,) = demonstrations
        assert self.demonstration.states.shape == (len(self.demonstration), 1)
        assert self.demonstration[0].action == 0 and has_no_pose(self.demonstration[0])

    def recall(self, query):
        assert query.world is self.demonstration.world and has_no_pose(query)
        assert query.last_action in (0, None) and all(step.state[0] in range(10) for step in query.window)
        cells = self.demonstration.states[:, 0].tolist()
        return [Steps(0, cells.index(query.state[0]), 2)]


run({"policy": Walker(), "memory": Follower}[sys.argv[1]])
