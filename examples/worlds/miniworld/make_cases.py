"""Draws the rooms and the cases of cases.json from a seed, and finds what the expert does by breadth-first search.

    python make_cases.py [SEED] > cases.json

Every building has six cases: two for each group of tasks. A case is drawn again until all its starts and its blocked way are as the
README says. What an action does is found out by taking it in Miniworld.
"""

import json
import random
import sys
from collections import deque

from world import ACTIONS, AHEAD, COLOURS, COLUMNS, DROP, OBJECTS, PICK_UP, ROWS, SIDE, Miniworld

BUILDINGS, SEED = 4, 1
TASKS = {"go-to": 1, "visit": 2, "pick-up": 1, "put-next": 2}  # and how many objects they are about
INSIDE = range(SIDE - 1)


def draw_building(random):
    """Six rooms in a ring of six doorways, with a seventh between the two in the middle; two objects a room."""
    doorways = [(i * SIDE + SIDE - 1, j * SIDE + random.choice(INSIDE)) for j in range(ROWS) for i in range(COLUMNS - 1)]
    doorways += [(i * SIDE + random.choice(INSIDE), SIDE - 1) for i in range(COLUMNS)]
    taken = {(x + dx, z + dz) for x, z in doorways for dx, dz in AHEAD}
    names = random.sample([(kind, colour) for kind in OBJECTS for colour in COLOURS], 2 * COLUMNS * ROWS)
    objects = []
    for number, (kind, colour) in enumerate(names):
        i, j = number % COLUMNS, number // COLUMNS % ROWS
        free = [(i * SIDE + x, j * SIDE + z) for x in INSIDE for z in INSIDE]
        free = [cell for cell in free if cell not in taken]
        if not free:
            return None
        x, z = random.choice(free)
        # A free ring around every object: objects close no way.
        taken |= {(x + dx, z + dz) for dx in (-1, 0, 1) for dz in (-1, 0, 1)}
        objects.append([kind, colour, x, z])
    return {"doorways": doorways, "objects": objects}


class Expert:
    """Breadth-first search over what Miniworld does, of which it remembers what it has tried."""

    def __init__(self, world, case, blocked=None):
        self.world, self.case, self.blocked = world, case, blocked
        self.begins, self.states, self.tried = {}, {}, {}

    def save(self):
        """What has to be put back to be in the state of the world again."""
        world, env = self.world, self.world.env
        held = None if env.agent.carrying is None else env.entities.index(env.agent.carrying)
        places = [(entity.pos.copy(), entity.dir) for entity in env.entities]
        self.states.setdefault(world.seen, (held, places, world.sub_goals, world.pose()[:2]))

    def restore(self, state):
        world, env = self.world, self.world.env
        held, places, world.sub_goals, _ = self.states[state]
        for entity, (position, direction) in zip(env.entities, places):
            entity.pos, entity.dir = position.copy(), direction
        env.agent.carrying = None if held is None else env.entities[held]
        world.seen = state

    def begin(self, start):
        if start not in self.begins:
            self.world.begin(self.case, start, self.blocked)
            self.save()
            self.begins[start] = self.world.seen
        return self.begins[start]

    def after(self, state):
        """Each action that is of use, the state after it, and whether the mission is complete."""
        if state not in self.tried:
            self.tried[state] = []
            world = self.world
            for action, number in enumerate(ACTIONS):
                if number == PICK_UP and self.case["task"] in ("go-to", "visit"):
                    continue
                self.restore(state)
                complete = world.step(action).sub_goals == world.required
                held = world.env.agent.carrying
                is_of_use = held is world.goals[0] if number == PICK_UP else number != DROP or complete
                if is_of_use and world.seen != state:
                    self.save()
                    self.tried[state].append((action, world.seen, complete))
        return self.tried[state]

    def solve(self, start):
        """The shortest actions that complete the mission, and the cells on the way; `None` if there are none."""
        begin = self.begin(start)
        # The world may have been in another building since.
        if self.world.case is not self.case or self.world.env.blocked != self.blocked:
            self.world.begin(self.case, start, self.blocked)
        came, waiting = {begin: None}, deque([begin])
        while waiting:
            state = waiting.popleft()
            for action, then, complete in self.after(state):
                if then in came:
                    continue
                came[then] = (state, action)
                if complete:
                    actions, cells = [], {self.states[then][3]}
                    while came[then] is not None:
                        then, action = came[then]
                        actions.append(action)
                        cells.add(self.states[then][3])
                    return "".join(Miniworld.letters[action] for action in actions[::-1]), cells
                waiting.append(then)
        return None


def room(pose):
    return pose[0] // SIDE, pose[1] // SIDE


def apart(one, other):
    return abs(one[0] - other[0]) + abs(one[1] - other[1])


def draw_case(random, experts, plan):
    """Starts, a doorway for the barrel, and what the expert does. `None` if what was drawn does not fit."""
    taken = {(x, z) for _, _, x, z in plan["objects"]}
    cells = [(x, z) for x in range(SIDE * COLUMNS - 1) for z in range(SIDE * ROWS - 1)]
    cells = [(x, z) for x, z in cells if x % SIDE in INSIDE and z % SIDE in INSIDE and (x, z) not in taken]
    original = (*random.choice(cells), random.randrange(4))
    x, z, heading = original
    near = [cell for cell in cells if room(cell) == room(original) and 2 <= apart(cell, original) <= 4]
    far = [cell for cell in cells if room(cell) != room(original) and apart(cell, original) >= 6]
    others = [cell for cell in cells if apart(cell, original) >= 3]
    starts = {
        "original": original,
        "opposite": (x, z, (heading + 2) % 4),
        "nearby": (*random.choice(near), heading),
        "distant": (*random.choice(far), (heading + random.choice((1, 3))) % 4),
        "new": (*random.choice(others), random.randrange(4)),
    }
    solved = {name: experts[None].solve(start) for name, start in starts.items()}
    if None in solved.values() or any(starts["new"][:2] == starts[name][:2] for name in ("nearby", "distant")):
        return None
    length, tested = len(solved["original"][0]), len(solved["new"][0])
    shortest = min(len(found[0]) for found in solved.values())
    if not (shortest >= 6 and 10 <= length <= 40 and 0.75 <= tested / length <= 1.35):
        return None
    passed = [cell for cell in plan["doorways"] if cell in solved["original"][1] & solved["new"][1]]
    random.shuffle(passed)
    for blocked in passed:
        around = experts[blocked].solve(starts["new"])
        if around is not None:
            letters = {name: found[0] for name, found in {**solved, "blocked": around}.items()}
            return {"starts": starts, "blocked": blocked, "trajectories": letters}
    return None


def draw_mission(random, world, plan, building, task):
    """A case of a task about some of the objects. `None` if there seems to be none."""
    for _ in range(20):
        names = [f"{colour} {kind}" for kind, colour, _, _ in random.sample(plan["objects"], TASKS[task])]
        mission = {"task": task, "building": building, "objects": names}
        experts = {at: Expert(world, {"plan": plan, **mission}, at and list(at)) for at in (None, *plan["doorways"])}
        tries = (draw_case(random, experts, plan) for _ in range(30))
        case = next((case for case in tries if case), None)
        if case:
            return {**mission, **case}
    return None


def draw(seed):
    source, world = random.Random(seed), Miniworld()
    buildings, cases = [], []
    while len(buildings) < BUILDINGS:
        plan = draw_building(source)
        if plan is None:
            continue
        drawn = []
        for task in ("go-to", "go-to", "visit", "visit", "pick-up", "put-next"):
            case = draw_mission(source, world, plan, len(buildings), task)
            if case is None or any(case["objects"] == other["objects"] for other in drawn):
                break
            drawn.append({"id": f"b{len(buildings)}-{len(drawn)}-{task}", **case})
        if len(drawn) < 6:
            continue
        ids = [case["id"] for case in drawn]
        for number, case in enumerate(drawn):
            # The other mission of the group; one mission of each other group.
            case["confusable"] = [[ids[number ^ 1], name] for name in ("original", "opposite")]
            case["irrelevant"] = [[ids[(number + 2 * turn) % 6], "original"] for turn in (1, 2)]
        buildings.append(plan)
        cases += drawn
    return {"buildings": buildings, "cases": cases}


def written(drawn):
    """JSON with a building and a case on a line each."""
    lines = {name: ",\n".join(json.dumps(each) for each in listed) for name, listed in drawn.items()}
    return '{"buildings": [\n%s\n],\n"cases": [\n%s\n]}' % (lines["buildings"], lines["cases"])


if __name__ == "__main__":
    print(written(draw(int(sys.argv[1]) if len(sys.argv) > 1 else SEED)))
