"""Minigrid with BabyAI's missions: six rooms seen through the eyes of the agent, and what it is asked to do there.

    memtransfer run --world-cmd "python world.py" --suite rq1.toml --policy imitate

The rooms and the cases are those of cases.json, which make_cases.py draws. Minigrid moves the agent and draws what it sees, BabyAI
says when a mission is complete.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame, which Minigrid imports, greets on standard output

import numpy as np
from minigrid.core.world_object import Ball, Box, Door, Key, Wall
from minigrid.envs.babyai.core.roomgrid_level import RoomGridLevel
from minigrid.envs.babyai.core.verifier import GoToInstr, ObjDesc, OpenInstr, PickupInstr, PutNextInstr
from numpy.typing import NDArray

from memtransfer.world import DONE, NO_EFFECT, START, Case, Episode, Field, Observation, World, main

COLUMNS, ROWS, ROOM = 3, 2, 6  # rooms, and the side of a room with its walls
LEFT, RIGHT, FORWARD, PICK_UP, DROP, TOGGLE = range(6)
OBJECTS = {"ball": Ball, "box": Box, "key": Key}
COLOURS = ("red", "green", "blue", "purple", "yellow", "grey")
NAMES = [f"{colour} {kind}" for kind in OBJECTS for colour in COLOURS]
AHEAD = ("no door", "an open door", "a closed door", "a locked door")
INSTRUCTIONS = {"go to": GoToInstr, "pick up": PickupInstr, "put": PutNextInstr, "open": OpenInstr}


class Rooms(RoomGridLevel):
    """A level of BabyAI with the rooms and the mission that it is given."""

    def __init__(self) -> None:
        self.rooms: Any = None
        self.task: Any = None
        self.start: Any = None
        self.wall: Any = None
        super().__init__(room_size=ROOM, num_rows=ROWS, num_cols=COLUMNS, max_steps=1_000_000)

    def gen_mission(self) -> None:
        for x, y in self.rooms["openings"]:
            self.grid.set(x, y, None)
        for colour, x, y, state in self.rooms["doors"]:
            self.put_obj(Door(colour, is_open=state == "open", is_locked=state == "locked"), x, y)
        for kind, colour, x, y in self.rooms["objects"]:
            self.put_obj(OBJECTS[kind](colour), x, y)
        if self.wall:
            self.put_obj(Wall(), *self.wall)
        self.agent_pos, self.agent_dir = tuple(self.start[:2]), self.start[2]
        verb, *names = self.task
        described = [ObjDesc(kind, colour) for colour, kind in map(str.split, names)]
        self.instrs = INSTRUCTIONS[verb](*described)


class Minigrid(World):
    name, version = "minigrid", "1"
    rules = (
        "You are in a building of six rooms, three from west to east and two from north to south, on a grid of 16 columns and 11 rows. "
        "Columns are counted from 0 in the west, rows from 0 in the north. You see the seven by seven cells in front of you from above, "
        "as if you looked upwards in the picture: you are the red triangle in the middle of its lowest row, or what you carry is drawn "
        "there. You do not see through walls and closed doors; what you cannot see is dark.\n"
        "Grey squares are walls. Doors are in walls and have a colour; a locked one opens only while you carry a key of its colour. "
        "You cannot enter a cell with a wall, a closed door, a ball, a box or a key.\n"
        "`move forward` takes you to the cell in front of you. `pick up` takes the object in front of you, if you carry none. `drop` puts "
        "what you carry into the cell in front of you, if that is empty. `toggle` opens or closes the door in front of you. It also "
        "opens a box, which is gone then. You have gone to something when it is in the cell in front of you."
    )
    actions = ("turn left", "turn right", "move forward", "pick up", "drop", "toggle")
    letters = "lrfpdt"
    state = (
        Field("column"),
        Field("row"),
        Field("heading", ["east", "south", "west", "north"]),
        Field("carrying", ["nothing", *NAMES]),
        Field("ahead", AHEAD),
    )
    state_sentence = "You are in column {column}, row {row}, facing {heading}, and carry {carrying}. In front of you is {ahead}."
    feedback = (
        "The episode has just begun.",
        "The action was carried out.",
        "The action changed nothing.",
        "Your last answer was not understood: nothing happened.",
    )
    tasks = {"go-to": "go to", "pick-up": "carry", "put-next": "carry", "open": "doors", "unlock": "doors"}
    failures = {"opened-box": "opened the box that the mission was about"}

    def __init__(self) -> None:
        self.env = Rooms()

    def cases(self) -> Iterator[Case]:
        drawn = json.loads(Path(__file__).with_name("cases.json").read_text())
        for case in drawn["cases"]:
            data = {"rooms": drawn["grids"][case["grid"]], **case}
            irrelevant, confusable = ([tuple(history) for history in case[name]] for name in ("irrelevant", "confusable"))
            actions = {name: [self.letters.index(letter) for letter in letters] for name, letters in case["trajectories"].items()}
            yield Case(case["id"], instruction(case["mission"]), actions, case["task"], irrelevant, confusable, data=data)

    def reset(self, episode: Episode) -> Observation:
        case, env = episode.case.data, self.env
        env.rooms, env.task, env.start = case["rooms"], case["mission"], case["starts"][episode.start]
        env.wall = case["blocked"] if episode.blocked else None
        env.reset(seed=0)
        # What has to be carried on the way: the object to put somewhere, or the key of a locked door.
        what = {"put-next": case["mission"][1], "unlock": case["mission"][1].replace("door", "key")}
        self.carried = what.get(case["task"])
        self.required = 1 if self.carried is None else 2
        self.sub_goals, self.steps = 0, 0
        self.failed_at: int | None = None
        self.seen = self.hash()
        return self.observe(START)

    def step(self, action: int) -> Observation:
        env = self.env
        front, ahead = tuple(env.front_pos), env.grid.get(*env.front_pos)
        conflict = action in (FORWARD, TOGGLE) and front == tuple(env.wall or ())
        _, _, complete, _, _ = env.step(action)
        self.steps += 1
        if complete:
            self.sub_goals = self.required
        elif self.sub_goals == 0 and self.carried is not None and carrying(env) == self.carried:
            self.sub_goals = 1
        if action == TOGGLE and isinstance(ahead, Box) and f"{ahead.color} box" in env.task:
            self.failed_at = self.steps
        before, self.seen = self.seen, self.hash()
        return self.observe(NO_EFFECT if self.seen == before else DONE, conflict)

    def hash(self) -> int:
        """Of all that determines what is seen and what follows, but for the mission."""
        env = self.env
        column, row = env.agent_pos
        text = f"{column} {row} {env.agent_dir} {carrying(env)} {self.sub_goals}"
        return int.from_bytes(blake2b(env.grid.encode().tobytes() + text.encode(), digest_size=8).digest(), "little")

    def observe(self, feedback: int, conflict: bool = False) -> Observation:
        held = carrying(self.env)
        state = (*self.env.agent_pos, self.env.agent_dir, 0 if held is None else 1 + NAMES.index(held), ahead(self.env))
        failed = self.failed_at is not None
        return Observation(state, feedback, self.sub_goals, self.required, failed, conflict, state_hash=self.seen)

    def render(self, pixels: NDArray[np.uint8]) -> None:
        height, width = pixels.shape[:2]
        view = self.env.get_pov_render(tile_size=-(-height // self.env.agent_view_size))
        nearest = np.ix_(np.arange(height) * view.shape[0] // height, np.arange(width) * view.shape[1] // width)
        pixels[..., :3], pixels[..., 3] = view[nearest], 255

    def facts(self) -> Mapping[str, Any]:
        return {} if self.failed_at is None else {"failure": {"kind": "opened-box", "step": self.failed_at}}


def carrying(env: Rooms) -> str | None:
    """The name of what the agent carries."""
    return env.carrying and f"{env.carrying.color} {env.carrying.type}"


def ahead(env: Rooms) -> int:
    """The place in `AHEAD` of the door in front of the agent."""
    cell = env.grid.get(*env.front_pos)
    return 1 + cell.encode()[2] if isinstance(cell, Door) else 0  # 0, 1, 2: open, closed, locked


def instruction(mission: Sequence[str]) -> str:
    """A mission in words, as BabyAI has them."""
    verb, *names = mission
    return f"{verb} " + " next to ".join(f"the {name}" for name in names)


if __name__ == "__main__":
    main(Minigrid)
