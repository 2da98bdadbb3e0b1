"""The world of this example: a ring of eight cells, seen from above. The agent walks to one place, or to two, and a wall can stand in
its way. Here are its rules, its cases, and the verbs `book`, `act` and `views`, as docs/case-book.md has them.
"""

import json

from blake3 import blake3

CELLS, RIGHT, LEFT = 8, 0, 1
STARTS, WALL = {"original": 0, "new": 1}, 3
IDS, PLACES = ["reach-4", "reach-5", "visit-4", "visit-5"], [[4], [5], [4, 5], [5, 6]]
GREY, WHITE, STONE = bytes([128, 128, 128, 255]), bytes([255] * 4), bytes([90, 90, 90, 255])
BEGUN, MOVED, BLOCKED, NOT_UNDERSTOOD = range(4)
DECLARATION = {
    "name": "ring",
    "version": "1",
    "rules": "You walk around a ring of eight cells, which you see from above: you are the white cell. You cannot enter a grey one.",
    "actions": [{"letter": "r", "words": "step right"}, {"letter": "l", "words": "step left"}],
    "state": [{"name": "cell"}, {"name": "visited"}],
    "state_sentence": "You are in cell {cell} and have visited {visited} places.",
    "feedback": ["The episode has just begun.", "You moved.", "A wall is in the way.", "Your answer was not understood."],
    "is_deterministic": True,
}
FAILURES = {"unreadable": "answers could not be read", "looped": "it went in a loop", "out-of-steps": "none of the others"}
WORLD = {
    "declaration": DECLARATION, "hashes": {}, "views": CELLS, "elsewhere_views": 0,
    "groups": [{"name": "reach", "heading": "reach"}, {"name": "visit", "heading": "visit"}],
    "tasks": [{"number": 1, "name": "one place", "group": "reach"}, {"number": 2, "name": "two places", "group": "visit"}],
    "failures": [{"name": name, "words": words} for name, words in FAILURES.items()],
}


class Ring:
    """An agent in the ring, in an episode of a case."""

    def __init__(self, case, start, has_wall):
        self.places, self.has_wall, self.cell, self.visited = PLACES[case], has_wall, STARTS[start], 0
        self.feedback, self.conflict = BEGUN, False

    def step(self, action):
        """Takes an action; `None` is an answer that could not be read."""
        there = (self.cell + {RIGHT: 1, LEFT: -1, None: 0}[action]) % CELLS
        self.conflict = self.has_wall and there == WALL
        self.feedback = NOT_UNDERSTOOD if action is None else BLOCKED if self.conflict else MOVED
        if self.feedback == MOVED:
            self.cell = there
            self.visited += there == self.places[self.visited]

    def is_complete(self):
        return self.visited == len(self.places)

    def state(self):
        return [self.cell, self.visited]

    def state_hash(self):
        numbers = [*self.state(), self.has_wall, *self.places]
        return int.from_bytes(blake3(bytes(numbers)).digest()[:8], "little")


def plan(case, start, has_wall):
    """The expert's actions: to each place to the right, or to the left where the wall is on that way."""
    actions, cell = [], STARTS[start]
    for place in PLACES[case]:
        right = (place - cell) % CELLS
        is_blocked = has_wall and (WALL - cell) % CELLS < right
        actions += [LEFT] * (CELLS - right) if is_blocked else [RIGHT] * right
        cell = place
    return actions


def act_out(case, start, has_wall, actions):
    """What follows from actions, to the end of the task; and the number of steps that complete it, or `None`."""
    ring = Ring(case, start, has_wall)
    acted = {"states": [ring.state()], "feedback": [BEGUN], "sub_goals": []}
    conflicts = []
    for step, action in enumerate(actions, start=1):
        if ring.is_complete():
            break
        ring.step(action)
        acted["states"].append(ring.state())
        acted["feedback"].append(ring.feedback)
        acted["sub_goals"] += [step] * (ring.visited - len(acted["sub_goals"]))
        conflicts += [step] * ring.conflict
    length = len(acted["states"]) - 1 if ring.is_complete() else None
    return acted, length, min(conflicts, default=None)


def facts(states):
    return {"start_state": states[0], "final_state": states[-1]}


def about(case):
    return {"task": len(PLACES[case]), "instruction": "Walk to cell " + ", then to cell ".join(map(str, PLACES[case])) + "."}


def reference(case, start, route):
    """The expert's trajectory of a case."""
    actions = plan(case, start, route == "blocked")
    acted, length, _ = act_out(case, start, route == "blocked", actions)
    return {"start": start, "route": route, "begin": acted["states"][0], "actions": actions, "length": length}, acted


def is_stale(case):
    """Whether the demonstration does not complete its task where the wall is."""
    return act_out(case, "original", True, plan(case, "original", False))[1] is None


def case_facts(case):
    tested = [("original", "unchanged"), ("new", "unchanged"), ("new", "blocked")]
    references = [reference(case, *of)[0] for of in tested]
    return {"id": IDS[case], **about(case), "references": references, "invalidated_when_blocked": is_stale(case)}


def write_book(request, out):
    asked, count = json.loads(request.read_text()), range(len(IDS))
    lacks = [name for name in ("assets", "elsewhere", "streams") if asked[name] is not None]
    lacks += [f"demonstrations {name}" for name in asked["demonstrations"] if name not in ("none", "original")]
    lacks += [f"case {name}" for name in asked["cases"] if name not in IDS]
    if lacks:
        raise SystemExit(f"the world ring has no {lacks[0]}")
    demonstrations, sets = [], []
    for case in count:
        expert, acted = reference(case, "original", "unchanged")
        known = {"case": case, "kind": "original", "variant": 0, "instruction": about(case)["instruction"], "actions": expert["actions"]}
        demonstrations.append({**known, **acted, "views": [cell for cell, _ in acted["states"]]})
        sets.append({"instruction": about(case)["instruction"], "own": [case], "irrelevant": [], "confusable": []})
    stale = {str(1 + case): [case] * is_stale(case) for case in count if asked["blocked"]}
    order = {"bank_order": list(count), "variants": {"0": "ring-1"}}
    books = {
        "case-book.json": {"world": WORLD, "cases": list(map(case_facts, count)), "stale": stale},
        "demonstrations.json": {"world": DECLARATION, "demonstrations": demonstrations, "cases": sets, **order},
    }
    out.mkdir(parents=True, exist_ok=True)
    for name, book in books.items():
        (out / name).write_text(json.dumps(book) + "\n")


def answer(request):
    """The answer to a line of `act`."""
    if request == "world":
        listed = list(map(case_facts, range(len(IDS))))
        return {"world": {"world": WORLD, "cases": listed, "blocked": list(range(1, 1 + len(IDS))), "states": []}}
    [(kind, asked)] = request.items()
    if kind == "episode" and asked["reference"]:
        case, (start, route) = IDS.index(asked["case"]), asked["reference"]
        expert, shown = reference(case, "new" if route == "blocked" else start, route)
        if asked["begin"] not in (None, expert["begin"]):
            raise ValueError(f"case {asked['case']} begins in {expert['begin']}, not in {asked['begin']}")
        acted, _, conflict_at = act_out(case, expert["start"], route == "blocked", asked["actions"])
        expert = {name: expert[name] for name in ("actions", "length")} | {"states": shown["states"]}
        expert["invalidated"] = route == "blocked" and is_stale(case)
        told = {"facts": facts(acted["states"]) if asked["parts"]["facts"] else None}
        told["reference"] = expert if asked["parts"]["reference"] else None
        return {kind: {**about(case), **acted, **told, "required": len(PLACES[case]), "conflict_at": conflict_at, "scenery": None}}
    if kind == "demonstrations":
        named = [[asked["case"], "original"]] * (asked["set"] == "original") + asked["more"]
        acted = []
        for case in dict.fromkeys(IDS.index(id) for id, which in named if which == "original"):
            expert, shown = reference(case, "original", "unchanged")
            stale = is_stale(case) and (IDS[case], 1 + case) == (asked["case"], asked["variant"])
            known = {"case": IDS[case], "kind": "original", "variant": 0, **about(case), **shown, "is_stale": stale}
            acted.append({**known, "actions": expert["actions"], "length": expert["length"], "closed": [], "targets": []})
        return {kind: acted}
    raise ValueError(f"the world ring answers no {kind} of this kind")


def picture_after(named):
    """What a line of `views` names; of a view that shows no world, `None`."""
    if named.startswith("4294967294 "):
        return None
    case, name, letters = named.split(".")
    ring = Ring(IDS.index(case), "original" if name == "original" else "new", name == "blocked")
    for letter in letters:
        ring.step("rl".index(letter))
    return ring.cell, ring.has_wall


def pixel_row(picture, width):
    """Each row of pixels of a picture; of none, uniform grey."""
    if picture is None:
        return GREY * width
    cell, has_wall = picture
    colours = [WHITE if at == cell else STONE if has_wall and at == WALL else bytes([20, 25 * at, 120, 255]) for at in range(CELLS)]
    return b"".join(colour * (width // CELLS) for colour in colours)
