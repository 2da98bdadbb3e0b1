"""Draws the cases of cases.json from a seed, and finds what the expert does.

    python make_cases.py [SEED] > cases.json

The expert is a list of places to move to, for each task. Every trajectory is acted out: a case is drawn again until all complete the
task, and until the wall is in the way as the README says.
"""

import json
import random
import sys
from types import SimpleNamespace

import numpy as np
from world import CLOSE, MOVES, STRIDE, MetaWorld

SEED = 1
PAIRS = {"reach": 3, "push": 2, "pick-place": 2, "press": 2, "open-drawer": 1, "open-window": 1}
OVER = 25  # as high as this, the hand passes every wall
BEHIND = 72  # where the walls of the tables with a puck are
SIDES = [-20, -15, -10, -5, 0, 5, 10, 15, 20]


def draw_pair(random, task):
    """What two cases have in common, and what each has of its own: `vector` is Meta-World's, in metres; the rest is in centimetres."""
    if task == "press":
        xs = random.choice([(-10, 0), (-10, 5), (-5, 5), (-5, 10), (0, 10)])
        return [{"vector": [x / 100, 0.9, 0.115], "x": x, "wall": [x / 100, 0.55, 0.0]} for x in xs]
    if task == "open-drawer":
        return [{"vector": [x / 100, 0.9, 0.0], "x": x} for x in random.sample([-10, 0, 10], 2)]
    if task == "open-window":
        return [{"vector": [x / 100, 0.8, 0.16], "x": x} for x in random.sample([-10, -5, 0, 5], 2)]
    x, y, side = random.choice([-5, 0, 5]), random.choice([60, 65]), random.choice([-1, 1])
    pair = []
    for step in random.sample([-10, 10], 2):
        hand = [x + step, 85, 5 if task == "push" else random.choice([10, 15])]
        goal = [hand[0] / 100, 0.85, (hand[2] - 4) / 100]
        # The wall is 24 cm wide. A hand that reaches meets its middle; a hand with the puck finds its end to the left or to the right.
        wall = [goal[0] if task == "reach" else (x + 5 * side) / 100, BEHIND / 100, 0.06]
        pair.append({"vector": [x / 100, y / 100, 0.02, *goal], "x": x, "y": y, "goal": hand, "wall": wall, "around": x - 15 * side})
    return pair


def draw_starts(random, task):
    """Where the hand is at the begin, as the README says; `None` for places that cannot be so."""
    ys = [40, 45] if task == "press" else [45, 50, 55]
    drawn = [[random.choice(SIDES), random.choice(ys), random.choice([15, 20, 25, 30])] for _ in range(3)]
    original, distant, new = map(np.array, drawn)
    nearby = original + random.choice(MOVES.tolist()[:6])
    opposite = original * [-1, 1, 1]
    starts = {"original": original, "opposite": opposite, "nearby": nearby, "distant": distant, "new": new}
    apart = np.linalg.norm(distant - original) >= 20 and np.linalg.norm(new - original) >= 10 and abs(original[0]) >= 10
    inside = nearby[1] in ys and 15 <= nearby[2] <= 30
    if not (apart and inside and len({tuple(place) for place in starts.values()}) == 5):
        return None
    return {name: place.tolist() for name, place in starts.items()}


def plan(case, blocked):
    """The expert's way: an axis, and where to move along it, in centimetres; `c` closes the gripper."""
    x, y, (gx, gy, gz), around = case["x"], case.get("y"), case.get("goal", (0, 0, 0)), case.get("around")
    to_puck = f"z15 x{x} y{y} z5 c"
    free, walled = {
        "reach": (f"z{gz} x{gx} y{gy}", f"z{OVER} x{gx} y{gy} z{gz}"),
        "push": (f"{to_puck} y{gy} x{gx}", f"{to_puck} x{around} y{gy} x{gx}"),
        "pick-place": (f"{to_puck} z{gz} y{gy} x{gx}", f"{to_puck} z{OVER} y{gy} x{gx} z{gz}"),
        "press": (f"z15 x{x} y90", f"z{OVER} x{x} y65 z15 y90"),
        "open-drawer": (f"z{OVER} x{x} y75 z10 y45", None),
        "open-window": (f"z{OVER} x{x - 10} y65 z15 y70 z10 x{x + 25}", None),
    }[case["task"]]
    return (walled if blocked else free).split()


def begin(case, start, blocked):
    world = MetaWorld()
    world.reset(SimpleNamespace(case=SimpleNamespace(data=case), start=start, blocked=blocked))
    return world


def drive(case, start, blocked):
    """The actions of the expert; `None` if they do not complete the task."""
    world, taken = begin(case, start, blocked), ""
    for leg in plan(case, blocked):
        axis = None if leg == "c" else "xyz".index(leg[0])
        for _ in range(1 if axis is None else 20):
            action = CLOSE
            if axis is not None:
                left = round((int(leg[1:]) - world.hand()[axis]) / STRIDE)
                if left == 0:
                    break
                action = next(i for i, move in enumerate(MOVES) if move[axis] * left > 0)
            taken += MetaWorld.letters[action]
            if world.step(action).sub_goals:
                return taken
    return None


def is_stopped(case, start, actions):
    """Whether these actions run into the wall and do not complete the task."""
    world = begin(case, start, True)
    seen = [world.step(MetaWorld.letters.index(letter)) for letter in actions]
    return any(step.conflict for step in seen) and not any(step.sub_goals for step in seen)


def draw_case(random, task, own):
    """Its starts and the trajectories from there; `None` if they are not as the README says."""
    starts = draw_starts(random, task)
    if starts is None:
        return None
    case = {"task": task, **own, "starts": starts}
    ways = [(start, start, False) for start in starts]
    if "wall" in case:
        ways.append(("blocked", "new", True))
    case["trajectories"] = found = {}
    for name, start, blocked in ways:
        found[name] = drive(case, start, blocked)
        if found[name] is None:
            return None
    if not 0.75 <= len(found["new"]) / len(found["original"]) <= 1.35:
        return None
    if "wall" in case and not all(is_stopped(case, name, found[name]) for name in ("original", "new")):
        return None
    return case


def draw(seed):
    source = random.Random(seed)
    cases = []
    for task, pairs in PAIRS.items():
        for _ in range(pairs):
            drawn = [None]
            while None in drawn:
                drawn = []
                for own in draw_pair(source, task):
                    tries = (draw_case(source, task, own) for _ in range(100))
                    drawn.append(next(filter(None, tries), None))
            for case in drawn:
                kept = {name: case.get(name) for name in ("task", "vector", "wall", "starts", "trajectories")}
                cases.append({"id": f"{task}-{len(cases)}", "place": f"place {chr(ord('A') + len(cases))}", **kept})
    originals = {group: [case["id"] for case in cases if MetaWorld.tasks[case["task"]] == group] for group in MetaWorld.tasks.values()}
    for number, case in enumerate(cases):
        case["confusable"] = [[cases[number ^ 1]["id"], name] for name in ("original", "opposite")]
        others = [ids for group, ids in originals.items() if group != MetaWorld.tasks[case["task"]]]
        case["irrelevant"] = [[ids[number % len(ids)], "original"] for ids in others]
    return cases


if __name__ == "__main__":
    cases = draw(int(sys.argv[1]) if len(sys.argv) > 1 else SEED)
    print("[\n%s\n]" % ",\n".join(json.dumps(case) for case in cases))
