"""Meta-World's robot arm, moved 5 cm at a time: places to reach, a puck, buttons, drawers and windows on a table.

    memtransfer run --world-cmd "python world.py" --suite rq1.toml --policy imitate

Meta-World has the tables, moves the arm and says when a task is complete. The cases are those of cases.json, which make_cases.py draws.
"""

import atexit
import json
import os
from collections.abc import Iterator, Sequence
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")  # pictures need no window

import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from numpy.typing import NDArray

from memtransfer.world import DONE, NO_EFFECT, START, Case, Episode, Field, Observation, World, main

STRIDE, CONTROL_STEPS = 5, 15  # of an action: centimetres, and control steps of Meta-World
LOW, HIGH = np.array([-30, 40, 5]), np.array([30, 95, 45])  # where the hand may be, in centimetres
MOVES = STRIDE * np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
OPEN, CLOSE = 6, 7
AWAY = (0.0, 0.0, -3.0)  # under the floor, where a wall blocks nothing
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
TASKS = {  # a task: its group, Meta-World's name, and what is asked
    "reach": ("reach", "reach-wall-v3", "Move the hand to {}."),
    "push": ("move", "push-wall-v3", "Push the puck to {}."),
    "pick-place": ("move", "pick-place-wall-v3", "Lift the puck to {}."),
    "press": ("operate", "button-press-wall-v3", "Press the red button."),
    "open-drawer": ("operate", "drawer-open-v3", "Open the drawer."),
    "open-window": ("operate", "window-open-v3", "Push the window open."),
}


class Table:
    """The table of a task: its model and its renderers, which take long to make. All lanes share it: what is on it, and where, is
    put there before each action, and taken away after it."""

    def __init__(self, name: str) -> None:
        self.env = ALL_V3_ENVIRONMENTS[name]()
        self.env._set_task_called, self.env.max_path_length = True, 10**9  # the run limits the steps
        self.model, self.data = self.env.model, self.env.data
        self.wall = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "wall")
        self.root = self.model.body_rootid[self.model.geom_bodyid]  # of each geom
        # Bricks look like the table: paint them blue.
        self.model.geom_matid[self.root == self.wall], self.model.geom_rgba[self.root == self.wall] = -1, (0.1, 0.2, 0.9, 1)
        self.renderers: dict[tuple[int, int], Any] = {}
        self.view, self.camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self.view.sitegroup[:] = 0  # goals are not shown
        self.camera.lookat[:], self.camera.distance, self.camera.azimuth, self.camera.elevation = (0, 0.68, 0.12), 1.05, 135, -30

    def reset(self, vector: Sequence[float], hand: Sequence[float], wall: Sequence[float] | None) -> None:
        self.env._last_rand_vec, self.env.hand_init_pos = np.array(vector), np.array(hand) / 100
        if self.wall >= 0:
            self.model.body_pos[self.wall] = wall or AWAY
        # Meta-World brings the hand to its place while the last table is still set: no start is where a table has anything.
        mujoco.mj_resetData(self.model, self.data)
        self.env.reset_model()
        mujoco.mj_forward(self.model, self.data)

    def save(self) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, Any]]:
        state = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, state, STATE)
        return state, self.model.body_pos.copy(), dict(vars(self.env))

    def load(self, saved: tuple[NDArray[np.float64], NDArray[np.float64], dict[str, Any]]) -> None:
        state, self.model.body_pos[:], attributes = saved
        vars(self.env).update(attributes)
        mujoco.mj_setState(self.model, self.data, state, STATE)
        mujoco.mj_forward(self.model, self.data)

    def touches_wall(self) -> bool:
        return self.wall >= 0 and bool((self.root[self.data.contact.geom] == self.wall).any())

    def render(self, height: int, width: int) -> NDArray[np.uint8]:
        if (height, width) not in self.renderers:
            self.model.vis.global_.offheight, self.model.vis.global_.offwidth = height, width
            self.model.vis.quality.offsamples = 0  # as without shadows and reflections below, quicker where no GPU is
            self.renderers[height, width] = mujoco.Renderer(self.model, height, width)
            atexit.register(self.renderers[height, width].close)
        renderer = self.renderers[height, width]
        renderer.update_scene(self.data, self.camera, self.view)
        for slow in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            renderer.scene.flags[slow] = 0
        pixels: NDArray[np.uint8] = renderer.render()
        return pixels


@cache
def table(name: str) -> Table:
    return Table(name)


class MetaWorld(World):
    name, version = "meta-world", "1"
    rules = (
        "You move the hand of a robot arm over a table. You see the table from behind the robot, from its right. A place is given in "
        "centimetres: x from left to right, y forward, away from the robot, z up. In the picture, forward leads to the upper right, "
        "right to the lower right. Your hand stays within x -30 to 30, y 40 to 95 and z 5 to 45, and far in front it stops a little "
        "before the place that you want. It has two fingers, one behind the other, which point down.\n"
        "Each move is of 5 cm along an axis. `close gripper` holds what is between the fingers, `open gripper` lets it go. There may "
        "be a red puck on the table, which your gripper can hold when the hand is right above it at z 5; a drawer or a window with a "
        "white handle; or a red button, which is pressed forward. Things can be pushed. A blue wall is solid: the way around it is "
        "above it or beside it. Some tasks name a place, such as place A: it is not marked on the table, and always the same for the "
        "same task."
    )
    actions = ("move left", "move right", "move forward", "move back", "move up", "move down", "open gripper", "close gripper")
    letters = "lrfbudoc"
    state = (Field("x"), Field("y"), Field("z"), Field("gripper", ["open", "closed"]))
    state_sentence = "Your hand is at x {x}, y {y}, z {z}, in centimetres, and your gripper is {gripper}."
    feedback = (
        "The episode has just begun.",
        "The action was carried out.",
        "The action changed nothing, or the hand was stopped on its way.",
        "Your last answer was not understood: nothing happened.",
    )
    tasks = {name: group for name, (group, _, _) in TASKS.items()}

    def cases(self) -> Iterator[Case]:
        for case in json.loads(Path(__file__).with_name("cases.json").read_text()):
            irrelevant, confusable = ([tuple(history) for history in case[name]] for name in ("irrelevant", "confusable"))
            actions = {name: [self.letters.index(letter) for letter in letters] for name, letters in case["trajectories"].items()}
            instruction = TASKS[case["task"]][2].format(case["place"])
            yield Case(case["id"], instruction, actions, case["task"], irrelevant, confusable, data=case)

    def reset(self, episode: Episode) -> Observation:
        case = episode.case.data
        self.table = table(TASKS[case["task"]][1])
        self.table.reset(case["vector"], case["starts"][episode.start], case["wall"] if episode.blocked else None)
        self.closed, self.complete = False, False
        return self.observe(START)

    def step(self, action: int) -> Observation:
        self.table.load(self.saved)
        env = self.table.env
        before = self.hand()
        target = STRIDE * np.round(before / STRIDE) + (MOVES[action] if action < OPEN else 0)
        if action >= OPEN and self.closed == (action == CLOSE) or (target < LOW).any() or (target > HIGH).any():
            return self.observe(NO_EFFECT)
        if action >= OPEN:
            self.closed = action == CLOSE
        conflict = False
        for left in reversed(range(CONTROL_STEPS)):
            move = np.array([*(target / 100 - self.table.data.mocap_pos[0]) / env.action_scale, 1.0 if self.closed else -1.0])
            if left:  # as in `env.step`, but for reward and success, which take most of the time
                env.set_xyz_action(move[:3])
                env.do_simulation([move[3], -move[3]], n_frames=env.frame_skip)
            else:
                self.complete = env.step(move)[4]["success"] > 0
            conflict |= self.table.touches_wall()
        stopped = action < OPEN and np.abs(self.hand() - target).max() > STRIDE / 2
        return self.observe(NO_EFFECT if stopped else DONE, conflict)

    def hand(self) -> NDArray[np.float64]:
        """Where the hand is, in centimetres."""
        metres: NDArray[np.float64] = self.table.env.get_endeff_pos()
        return 100 * metres

    def observe(self, feedback: int, conflict: bool = False) -> Observation:
        self.saved = self.table.save()
        state, bodies, _ = self.saved
        # Without the time, which is the first number.
        seen = blake2b(state[1:].tobytes() + bodies.tobytes() + self.table.env.task_name.encode(), digest_size=8)
        position = np.round(self.hand())
        return Observation(
            (*position, self.closed), feedback, self.complete, conflict=conflict, state_hash=int.from_bytes(seen.digest(), "little")
        )

    def render(self, pixels: NDArray[np.uint8]) -> None:
        self.table.load(self.saved)
        pixels[..., :3], pixels[..., 3] = self.table.render(*pixels.shape[:2]), 255


if __name__ == "__main__":
    main(MetaWorld)
