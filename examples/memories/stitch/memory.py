"""A route stitched from demonstrations: along one to where it meets another, and so on to one of the agent's task.

A bank holds the demonstrations of all cases. They meet where they pass the same state; in the warehouse an expert that stands in the
same cell with another heading is a turn away. The memory plans the shortest way along demonstrations to a step of one of the agent's
task, and from there what the expert did, to its end.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from memtransfer import Action, Demonstration, EpisodeEnd, Memory, Plan, Query, Source, run

State: TypeAlias = "tuple[float, ...]"
Part: TypeAlias = "Source | Action"
Way: TypeAlias = "list[tuple[State, Part | None]]"
"""States, each with the part of a plan that is next; the last has none."""

TURNS = (Action.TURN_LEFT, Action.TURN_RIGHT, Action.TURN_AROUND)


class Stitch(Memory):
    name = "stitch"
    scope = "all"
    embeddings = False

    def build(self, demonstrations: Sequence[Demonstration]) -> None:
        self.demonstrations = demonstrations
        # By state what experts did there and where it led, and for each task the first steps in a state.
        self.ways: dict[State, list[tuple[State, Part]]] = {}
        self.of_task: dict[str, dict[State, tuple[int, int]]] = {}
        for number, demonstration in enumerate(demonstrations):
            states = [tuple(state) for state in demonstration.states.tolist()]
            for step, state in enumerate(states):
                way = self.ways.setdefault(state, [])
                if step + 1 < len(states):
                    way.append((states[step + 1], Source(number, step, 1)))
                self.of_task.setdefault(demonstration.instruction, {}).setdefault(state, (number, step))
        for state in list(self.ways):
            self.ways[state] += [(turned, turn) for turn in TURNS if (turned := after(state, turn)) in self.ways]
        self.plans: dict[int, Way] = {}  # by episode

    def recall(self, query: Query) -> Sequence[Plan]:
        here = tuple(query.state)
        ahead = self.plans.get(query.episode, [])
        if len(ahead) > 1 and ahead[1][0] == here:
            ahead = ahead[1:]  # the agent has followed the plan
        elif not ahead or ahead[0][0] != here:
            ahead = self.route(here, query.instruction)
        self.plans[query.episode] = ahead
        parts = joined(part for _, part in ahead if part is not None)
        return [Plan(parts)] if parts else []

    def end_episode(self, end: EpisodeEnd) -> None:
        self.plans.pop(end.episode, None)

    def route(self, start: State, instruction: str) -> Way:
        """The states and parts of the shortest way to a demonstration of the task, and of that to its end."""
        goals = self.of_task.get(instruction, {})
        reached: dict[State, tuple[State, Part] | None] = {start: None}
        waiting = deque([start])
        while waiting:
            state = waiting.popleft()
            if state in goals:
                break
            for following, part in self.ways.get(state, []):
                if following not in reached:
                    reached[following] = (state, part)
                    waiting.append(following)
        else:
            return []  # no demonstration leads from here to one of the task
        number, step = goals[state]
        demonstration = self.demonstrations[number]
        last = len(demonstration) - 1
        rest: Way = [(tuple(demonstration.states[at].tolist()), Source(number, at, 1)) for at in range(step, last)]
        rest.append((tuple(demonstration.states[last].tolist()), None))
        while (came := reached[state]) is not None:
            rest.insert(0, came)
            state, _ = came
        return rest


def after(state: State, turn: Action) -> State:
    """The state after a turn on the spot."""
    column, row, heading = state
    quarters = {Action.TURN_LEFT: 3, Action.TURN_RIGHT: 1, Action.TURN_AROUND: 2}[turn]
    return (column, row, (heading + quarters) % 4)


def joined(parts: Iterable[Part]) -> list[Part]:
    """Consecutive steps of one demonstration as one source."""
    plan: list[Part] = []
    for part in parts:
        last = plan[-1] if plan else None
        if isinstance(part, Source) and isinstance(last, Source):
            assert last.count is not None, "every part is one step, or several joined"
            if (last.demonstration, last.first + last.count) == (part.demonstration, part.first):
                plan[-1] = Source(last.demonstration, last.first, last.count + 1)
                continue
        plan.append(part)
    return plan


run(Stitch)
