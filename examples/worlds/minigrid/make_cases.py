"""Draws the rooms and the cases of cases.json from a seed, and finds what the expert does by breadth-first search.

    python make_cases.py [SEED] > cases.json

Every grid has six cases: two for each group of tasks. A case is drawn again until all its starts and its blocked way are as the
README says.
"""

import json
import random
import sys
from collections import deque

from world import COLOURS, COLUMNS, DROP, FORWARD, LEFT, OBJECTS, PICK_UP, RIGHT, ROOM, ROWS, TOGGLE, Minigrid

GRIDS, SEED = 4, 1
SIDE = ROOM - 1
AHEAD = ((1, 0), (0, 1), (-1, 0), (0, -1))


def draw_grid(random):
    """Six rooms in a ring of six doors, one of them locked, with an opening between the two in the middle; two objects a room."""
    inside = range(1, SIDE)
    between = [((i + 1) * SIDE, j * SIDE + random.choice(inside)) for j in range(ROWS) for i in range(COLUMNS - 1)]
    between += [(i * SIDE + random.choice(inside), SIDE) for i in (0, 2)]
    opening = [SIDE + random.choice(inside), SIDE]
    random.shuffle(between)
    doors = [[colour, x, y, "closed"] for colour, (x, y) in zip(COLOURS, between)]
    locked = random.choice(doors)
    locked[3] = "locked"
    beside = {(x + dx, y + dy) for x, y in [*between, opening] for dx, dy in AHEAD}
    names = [(kind, colour) for kind in OBJECTS for colour in COLOURS if (kind, colour) != ("key", locked[0])]
    names = [("key", locked[0]), *random.sample(names, 2 * COLUMNS * ROWS - 1)]
    objects, taken = [], set(beside)
    for number, (kind, colour) in enumerate(names):
        i, j = number % COLUMNS, number // COLUMNS % ROWS
        free = [(i * SIDE + x, j * SIDE + y) for x in inside for y in inside]
        free = [cell for cell in free if cell not in taken]
        x, y = random.choice(free)
        # A free ring around every object: objects close no way.
        taken |= {(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
        objects.append([kind, colour, x, y])
    return {"doors": doors, "openings": [opening], "objects": objects}


class Expert:
    """Breadth-first search over cell, heading, what is carried, and which doors have been opened."""

    def __init__(self, grid, mission, task, wall=None):
        self.doors = {(x, y): (colour, state) for colour, x, y, state in grid["doors"] if (x, y) != wall}
        self.openings = {tuple(cell) for cell in grid["openings"]}
        self.objects = {(x, y): f"{colour} {kind}" for kind, colour, x, y in grid["objects"]}
        self.verb, self.names = mission[0], mission[1:]
        places = {name: cell for cell, name in self.objects.items()}
        places |= {f"{colour} door": cell for cell, (colour, _) in self.doors.items()}
        self.places = [places[name] for name in self.names]
        # The only object that is worth carrying.
        taken = {"put-next": self.names[0], "pick-up": self.names[0], "unlock": self.names[0].replace("door", "key")}
        self.useful = places.get(taken.get(task))

    def is_free(self, cell, carries, opened):
        if cell in self.doors:
            return cell in opened
        if cell in self.objects:
            return carries and cell == self.useful
        x, y = cell
        return cell in self.openings or (x % SIDE != 0 and y % SIDE != 0)

    def after(self, state, action):
        """The state after an action, and whether the mission is complete. `None` if it does nothing that is of use."""
        x, y, heading, carries, opened = state
        front = (x + AHEAD[heading][0], y + AHEAD[heading][1])
        if action in (LEFT, RIGHT):
            state = (x, y, (heading + (1 if action == RIGHT else 3)) % 4, carries, opened)
        elif action == FORWARD and self.is_free(front, carries, opened):
            state = (*front, heading, carries, opened)
        elif action == PICK_UP and front == self.useful and not carries:
            return (x, y, heading, True, opened), self.verb == "pick up"
        elif action == DROP and self.verb == "put" and carries and self.is_free(front, carries, opened):
            there = self.places[1]
            is_next = abs(front[0] - there[0]) + abs(front[1] - there[1]) == 1
            return (state, True) if is_next and front not in self.doors | dict.fromkeys(self.openings) else None
        elif action == TOGGLE and front in self.doors and front not in opened:
            colour, kind = self.doors[front]
            if kind == "locked" and not (carries and self.objects[self.useful] == f"{colour} key"):
                return None
            return (x, y, heading, carries, opened | {front}), self.verb == "open" and front == self.places[0]
        else:
            return None
        x, y, heading = state[:3]
        return state, self.verb == "go to" and (x + AHEAD[heading][0], y + AHEAD[heading][1]) == self.places[0]

    def solve(self, start):
        """The shortest actions that complete the mission, and the cells on the way; `None` if there are none."""
        begin = (*start, False, frozenset())
        came, waiting = {begin: None}, deque([begin])
        while waiting:
            state = waiting.popleft()
            for action in (FORWARD, LEFT, RIGHT, TOGGLE, PICK_UP, DROP):
                then = self.after(state, action)
                if then is None or (then[0] in came and not then[1]):
                    continue
                if then[1]:
                    actions, cells = [action], {state[:2]}
                    while came[state] is not None:
                        state, action = came[state]
                        actions.append(action)
                        cells.add(state[:2])
                    return actions[::-1], cells
                came[then[0]] = (state, action)
                waiting.append(then[0])
        return None


def room(pose):
    return pose[0] // SIDE, pose[1] // SIDE


def apart(one, other):
    return abs(one[0] - other[0]) + abs(one[1] - other[1])


def draw_case(random, grid, mission, task):
    """Starts, a passage to be walled up, and what the expert does. `None` if what was drawn does not fit."""
    expert = Expert(grid, mission, task)
    taken = {(x, y) for _, _, x, y in grid["objects"]}
    cells = [(x, y) for x in range(SIDE * COLUMNS) for y in range(SIDE * ROWS) if x % SIDE and y % SIDE and (x, y) not in taken]
    original = (*random.choice(cells), random.randrange(4))
    x, y, heading = original
    near = [cell for cell in cells if room(cell) == room(original) and 2 <= apart(cell, original) <= 4]
    far = [cell for cell in cells if room(cell) != room(original) and apart(cell, original) >= 6]
    others = [cell for cell in cells if apart(cell, original) >= 3]
    starts = {
        "original": original,
        "opposite": (x, y, (heading + 2) % 4),
        "nearby": (*random.choice(near), heading),
        "distant": (*random.choice(far), (heading + random.choice((1, 3))) % 4),
        "new": (*random.choice(others), random.randrange(4)),
    }
    solved = {name: expert.solve(start) for name, start in starts.items()}
    if None in solved.values() or any(starts["new"][:2] == starts[name][:2] for name in ("nearby", "distant")):
        return None
    length, tested = len(solved["original"][0]), len(solved["new"][0])
    shortest = min(len(found[0]) for found in solved.values())
    if not (shortest >= 6 and 10 <= length <= 40 and 0.75 <= tested / length <= 1.35):
        return None
    goals = expert.places + ([expert.useful] if expert.useful else [])
    passages = [*expert.openings, *(cell for cell in expert.doors if cell not in goals)]
    passages = [cell for cell in passages if cell in solved["original"][1] and cell in solved["new"][1]]
    random.shuffle(passages)
    for wall in passages:
        around = Expert(grid, mission, task, wall)
        around.openings.discard(wall)
        solved["blocked"] = around.solve(starts["new"])
        if solved["blocked"] is not None:
            letters = {name: "".join(Minigrid.letters[action] for action in found[0]) for name, found in solved.items()}
            return {"starts": starts, "blocked": wall, "trajectories": letters}
    return None


def draw_missions(random, grid):
    """Two missions of each group: the task, then what BabyAI needs."""
    locked = next(colour for colour, _, _, state in grid["doors"] if state == "locked")
    one, two, three, four, five = random.sample([f"{colour} {kind}" for kind, colour, _, _ in grid["objects"]], 5)
    closed = random.choice([colour for colour, _, _, state in grid["doors"] if state == "closed"])
    return [
        ("go-to", ["go to", one]),
        ("go-to", ["go to", two]),
        ("pick-up", ["pick up", three]),
        ("put-next", ["put", four, five]),
        ("open", ["open", f"{closed} door"]),
        ("unlock", ["open", f"{locked} door"]),
    ]


def draw(seed):
    source = random.Random(seed)
    grids, cases = [], []
    while len(grids) < GRIDS:
        grid = draw_grid(source)
        drawn = []
        for task, mission in draw_missions(source, grid):
            tries = (draw_case(source, grid, mission, task) for _ in range(200))
            case = next((case for case in tries if case), None)
            if case is None:
                break
            drawn.append({"id": f"g{len(grids)}-{len(drawn)}-{task}", "task": task, "grid": len(grids), "mission": mission, **case})
        if len(drawn) < 6:
            continue
        ids = [case["id"] for case in drawn]
        for number, case in enumerate(drawn):
            # The other mission of the group; one mission of each other group.
            case["confusable"] = [[ids[number ^ 1], name] for name in ("original", "opposite")]
            case["irrelevant"] = [[ids[(number + 2 * turn) % 6], "original"] for turn in (1, 2)]
        grids.append(grid)
        cases += drawn
    return {"grids": grids, "cases": cases}


def written(drawn):
    """JSON with a grid and a case on a line each."""
    lines = {name: ",\n".join(json.dumps(each) for each in listed) for name, listed in drawn.items()}
    return '{"grids": [\n%s\n],\n"cases": [\n%s\n]}' % (lines["grids"], lines["cases"])


if __name__ == "__main__":
    print(written(draw(int(sys.argv[1]) if len(sys.argv) > 1 else SEED)))
