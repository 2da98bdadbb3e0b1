"""A Gymnasium environment whose state can be set, as a world of your own.

    class Maze(GymWorld):
        name, version = "maze", "1"
        rules, actions, state = ...

        def make(self):
            return gymnasium.make("Maze-v0", render_mode="rgb_array")

        def begin(self, env, episode):
            env.unwrapped.agent_pos = episode.case.data[episode.start]

        def read(self, env):
            return env.unwrapped.agent_pos

Needs Gymnasium: `pip install 'memtransfer[gym]'`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from memtransfer._extras import missing
from memtransfer.errors import WorldError
from memtransfer.world import DONE, NO_EFFECT, START, Episode, Observation, World

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise missing(error, "gym") from None

_Env: TypeAlias = gymnasium.Env[Any, Any]


class GymWorld(World):
    """A world of a Gymnasium environment with discrete actions: action `n` of the world is action `n` of the environment. A task has
    one sub-goal, which is met when `info["success"]` is true, or when the environment terminates if it tells no `success`. An action
    that leaves the state as it was has the feedback `NO_EFFECT`."""

    _env: Any = None

    @abstractmethod
    def make(self) -> _Env:
        """Returns the environment, without a limit of steps of its own, with `render_mode="rgb_array"`."""

    @abstractmethod
    def begin(self, env: _Env, episode: Episode) -> None:
        """Puts the environment into the start of `episode`. It has been reset with the episode's seed; with 0 if `deterministic`."""

    @abstractmethod
    def read(self, env: _Env) -> Sequence[float]:
        """Returns the numbers of the state."""

    def reset(self, episode: Episode) -> Observation:
        if self._env is None:
            self._env = self.make()
        self._env.reset(seed=0 if self.deterministic else episode.seed)
        self.begin(self._env, episode)
        self._state = [float(number) for number in self.read(self._env)]
        return Observation(self._state, START)

    def step(self, action: int) -> Observation:
        _, _, terminated, truncated, info = self._env.step(action)
        before, self._state = self._state, [float(number) for number in self.read(self._env)]
        success = bool(info.get("success", terminated))
        return Observation(
            self._state,
            NO_EFFECT if self._state == before else DONE,
            sub_goals=int(success),
            failed=bool(terminated or truncated) and not success,
        )

    def render(self, pixels: NDArray[np.uint8]) -> None:
        view = self._env.render()
        if not (isinstance(view, np.ndarray) and view.dtype == np.uint8 and view.ndim == 3 and view.shape[2] >= 3):
            raise WorldError('env.render() returned no picture: make the environment with render_mode="rgb_array"')
        (height, width), (rows, columns) = pixels.shape[:2], view.shape[:2]
        nearest = np.ix_(np.arange(height) * rows // height, np.arange(width) * columns // width)
        pixels[..., :3], pixels[..., 3] = view[nearest][..., :3], 255
