"""Miniworld: six furnished rooms with doorways, seen through the eyes of the agent, and what it is asked to do there.

    memtransfer run --world-cmd "python world.py" --suite rq1.toml --policy imitate

The rooms and the cases are those of cases.json, which make_cases.py draws. Miniworld moves the agent, finds what it collides with, and
draws what it sees. Steps of a metre and quarter turns keep it on a grid of poses: cell (x, z) is x metres east and z metres south.
"""

import contextlib
import functools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import pyglet

pyglet.options["headless"] = True  # EGL, no display; to be said before Miniworld is imported

import miniworld
from miniworld.entity import Ball, Box, Key, MeshEnt
from miniworld.miniworld import MiniWorldEnv
from miniworld.opengl import FrameBuffer
from miniworld.params import DEFAULT_PARAMS
from miniworld.utils import get_file_path
from numpy.typing import NDArray

from memtransfer.world import DONE, NO_EFFECT, START, Case, Episode, Field, Observation, World, main

COLUMNS, ROWS, SIDE = 3, 2, 5  # rooms, and the metres from one to the next: four cells and a wall
# From the middle of a cell to a wall, and to a side of a doorway. Walls are half a metre thick; what is carried reaches into the next cell.
BESIDE_WALL, HALF_DOORWAY = 0.75, 0.6
LEFT, RIGHT, FORWARD, BACK, PICK_UP, DROP = range(6)  # as Miniworld numbers them
ACTIONS = (LEFT, RIGHT, FORWARD, PICK_UP, DROP)
STEPS = 4  # of Miniworld in a metre: what is carried is too close in front of the agent for longer ones
AHEAD = ((1, 0), (0, -1), (-1, 0), (0, 1))  # east, north, west, south: Miniworld counts turns to the left
OBJECTS = {"ball": Ball, "box": lambda colour: Box(colour, size=0.6), "key": Key}
COLOURS = ("red", "green", "blue", "purple", "yellow", "grey")
NAMES = [f"{colour} {kind}" for kind in OBJECTS for colour in COLOURS]
WALLS = ("brick_wall", "wood", "stucco", "cinder_blocks", "marble", "drywall")
FLOORS = ("floor_tiles_bw", "asphalt", "wood_planks", "grass", "concrete", "rock")
INSTRUCTIONS = {
    "go-to": "go to the {}",
    "visit": "go to the {}, then to the {}",
    "pick-up": "pick up the {}",
    "put-next": "put the {} next to the {}",
}


def load_texture(path: str, load: Callable[[str], Any] = pyglet.image.load) -> Any:
    """An image with four numbers a pixel. pyglet makes four of three with a regular expression, in seconds for a texture."""
    image = load(path).get_image_data()
    numbers = np.frombuffer(image.get_data(image.format, image.width * len(image.format)), np.uint8)
    pixels = np.full((image.height, image.width, 4), 255, np.uint8)
    pixels[..., : len(image.format)] = numbers.reshape(image.height, image.width, -1)
    return pyglet.image.ImageData(image.width, image.height, "RGBA", pixels.tobytes())


pyglet.image.load = load_texture
# All lanes draw in one window. In a second one, Mesa would compile again all that draws.
pyglet.window.Window = functools.cache(pyglet.window.Window)
frame_buffer = functools.cache(FrameBuffer)
miniworld.opengl.get_file_path = miniworld.objmesh.get_file_path = functools.cache(get_file_path)


class Rooms(MiniWorldEnv):
    """Miniworld with the rooms, the objects and the start that it is given. It draws only when it is asked to."""

    drawn: "Rooms | None" = None  # whose walls are in the list of drawing commands, which all instances of a process share

    def __init__(self) -> None:
        # All shapes are loaded before the first episode, which has to begin within a step's time limit.
        objects = [(kind, colour, 0, 0) for kind in OBJECTS for colour in COLOURS]
        self.plan: Any = {"doorways": [], "objects": objects}
        self.start: Sequence[int] = (0, 0, 0)
        self.blocked: Sequence[int] | None = (0, 0)
        params = DEFAULT_PARAMS.no_random()
        params.set("forward_step", 1 / STEPS)
        params.set("turn_step", 90)
        params.set("cam_fov_y", 75)
        params.set("light_pos", [SIDE * COLUMNS / 2, 2.5, SIDE * ROWS / 2])
        with contextlib.redirect_stdout(None):  # how many samples a pixel has
            super().__init__(1_000_000, 8, 8, 8, 8, params)

    def _gen_world(self) -> None:
        rooms = {}
        for number, (j, i) in enumerate(np.ndindex(ROWS, COLUMNS)):
            x, z = i * SIDE - BESIDE_WALL, j * SIDE - BESIDE_WALL
            side = SIDE - 2 + 2 * BESIDE_WALL
            textures = {"wall_tex": WALLS[number], "floor_tex": FLOORS[number]}
            rooms[i, j] = self.add_rect_room(x, x + side, z, z + side, **textures)
        for x, z in self.plan["doorways"]:
            i, j = x // SIDE, z // SIDE
            if x % SIDE == SIDE - 1:
                self.connect_rooms(rooms[i, j], rooms[i + 1, j], min_z=z - HALF_DOORWAY, max_z=z + HALF_DOORWAY, max_y=2.2)
            else:
                self.connect_rooms(rooms[i, j], rooms[i, j + 1], min_x=x - HALF_DOORWAY, max_x=x + HALF_DOORWAY, max_y=2.2)
        self.named = {}
        for kind, colour, x, z in self.plan["objects"]:
            self.named[f"{colour} {kind}"] = self.put(OBJECTS[kind](colour), x, z, math.pi / 5)
        if self.blocked:
            x, z = self.blocked
            self.put(MeshEnt("barrel", height=1.0), x, z, 0.0)
        x, z, heading = self.start
        self.put(self.agent, x, z, heading * math.pi / 2)

    def put(self, entity: Any, x: float, z: float, direction: float) -> Any:
        return self.place_entity(entity, pos=np.array([x, 0.0, z]), dir=direction)

    def reset(self, **kwargs: Any) -> Any:
        super().reset(**kwargs)
        Rooms.drawn = self
        return None, {}

    def step(self, action: int) -> None:
        """A quarter turn, a metre or nothing, or what Miniworld does."""
        for taken in range(STEPS if action == FORWARD else 1):
            before = self.agent.pos
            super().step(action)
            if action == FORWARD and self.agent.pos is before:
                for _ in range(taken):
                    super().step(BACK)
                break
        # Rounding errors of turns and steps do not add up.
        self.agent.dir = round(self.agent.dir / (math.pi / 2)) % 4 * math.pi / 2
        if self.agent.carrying:
            self.agent.carrying.dir = self.agent.dir
        for entity in self.entities:
            entity.pos = np.round(entity.pos, 6) + 0.0

    def render_obs(self, frame_buffer: Any = None) -> Any:
        if frame_buffer is None:
            return None
        if Rooms.drawn is not self:
            self._render_static()
            Rooms.drawn = self
        return super().render_obs(frame_buffer)


class Miniworld(World):
    name, version = "miniworld", "1"
    rules = (
        "You are in a building of six rooms, three from west to east and two from north to south, with doorways between them and balls, "
        "boxes and keys on the floor. You see what is in front of you, but not the floor one metre ahead. Each room has a floor and walls of "
        "its own.\n"
        "Your position is in metres: x grows to the east, z to the south. `turn left` and `turn right` turn you by 90 degrees, `move "
        "forward` takes you one metre ahead. You cannot walk through walls, objects and barrels.\n"
        "`pick up` takes the object one metre in front of you, if you carry none. You carry it in front of you, where it can touch "
        "walls and objects as well: then you can neither move nor turn that way. `drop` puts it down there. "
        "You have gone to an object when you are one metre from it and not diagonally; two objects are next to each other likewise."
    )
    actions = ("turn left", "turn right", "move forward", "pick up", "drop")
    letters = "lrfpd"
    state = (Field("x"), Field("z"), Field("heading", ["east", "north", "west", "south"]), Field("carrying", ["nothing", *NAMES]))
    state_sentence = "You are at x {x}, z {z}, facing {heading}, and carry {carrying}."
    tasks = {"go-to": "go to", "visit": "visit", "pick-up": "carry", "put-next": "carry"}

    def __init__(self) -> None:
        self.env = Rooms()

    def cases(self) -> Iterator[Case]:
        drawn = json.loads(Path(__file__).with_name("cases.json").read_text())
        for case in drawn["cases"]:
            data = {"plan": drawn["buildings"][case["building"]], **case}
            irrelevant, confusable = ([tuple(history) for history in case[name]] for name in ("irrelevant", "confusable"))
            actions = {name: [self.letters.index(letter) for letter in letters] for name, letters in case["trajectories"].items()}
            instruction = INSTRUCTIONS[case["task"]].format(*case["objects"])
            yield Case(case["id"], instruction, actions, case["task"], irrelevant, confusable, data=data)

    def reset(self, episode: Episode) -> Observation:
        case = episode.case.data
        self.begin(case, case["starts"][episode.start], case["blocked"] if episode.blocked else None)
        return self.observe(START)

    def begin(self, case: Any, start: Sequence[int], blocked: Sequence[int] | None) -> None:
        env = self.env
        env.plan, env.start, env.blocked = case["plan"], start, blocked
        env.reset(seed=0)
        self.case, self.goals = case, [env.named[name] for name in case["objects"]]
        self.sub_goals, self.required = 0, 1 if case["task"] in ("go-to", "pick-up") else 2
        self.seen = self.hash()

    def step(self, action: int) -> Observation:
        env = self.env
        env.step(ACTIONS[action])
        held = env.agent.carrying
        if self.case["task"] in ("go-to", "visit"):
            reached = env.near(self.goals[self.sub_goals])
        elif self.sub_goals == 0:
            reached = held is self.goals[0]
        else:
            reached = held is None and env.near(*self.goals)
        self.sub_goals += bool(reached)
        before, self.seen = self.seen, self.hash()
        unchanged = self.seen == before
        conflict = unchanged and ACTIONS[action] == FORWARD and self.is_barrel_ahead()
        return self.observe(NO_EFFECT if unchanged else DONE, conflict)

    def is_barrel_ahead(self) -> bool:
        """Whether a barrel is in front of the agent, or of what it carries."""
        x, z, heading = self.pose()
        cells = [[x + AHEAD[heading][0] * far, z + AHEAD[heading][1] * far] for far in (1, 2)]
        return self.env.blocked in (cells if self.env.agent.carrying else cells[:1])

    def pose(self) -> tuple[int, int, int]:
        agent = self.env.agent
        return round(agent.pos[0]), round(agent.pos[2]), round(agent.dir / (math.pi / 2))

    def hash(self) -> int:
        """Of all that determines what is seen and what follows, but for the mission."""
        env = self.env
        said = [self.case["building"], env.blocked, self.carried(), self.sub_goals]
        said += [(entity.pos.tolist(), entity.dir) for entity in env.entities]
        return int.from_bytes(blake2b(json.dumps(said).encode(), digest_size=8).digest(), "little")

    def carried(self) -> int:
        """The number of what the agent carries in the words of the state."""
        held = self.env.agent.carrying
        return 0 if held is None else 1 + NAMES.index(next(name for name, each in self.env.named.items() if each is held))

    def observe(self, feedback: int, conflict: bool = False) -> Observation:
        state = (*self.pose(), self.carried())
        return Observation(state, feedback, self.sub_goals, self.required, conflict=conflict, state_hash=self.seen)

    def render(self, pixels: NDArray[np.uint8]) -> None:
        height, width = pixels.shape[:2]
        pixels[..., :3], pixels[..., 3] = self.env.render_obs(frame_buffer(width, height, 4)), 255


if __name__ == "__main__":
    main(Miniworld)
