"""The benchmark's episodes as a Gymnasium environment, alone and vectorised.

    import gymnasium

    env = gymnasium.make("memtransfer.gym:MemTransfer-v0", case="t01-01", render_mode="rgb_array")
    envs = gymnasium.make_vec("memtransfer.gym:MemTransfer-v0", num_envs=64, frame_size=128)

Both step and render in this process, without the processes of a run, and show what a policy of a run is shown: view,
pose, instruction and feedback. There is no memory of demonstrations. Needs Gymnasium: `pip install
'memtransfer[gym]'`. The guide is `docs/gymnasium.md` of the project.
"""

from __future__ import annotations

import operator
import os
import string
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from typing import Any, NamedTuple, SupportsIndex, TypeAlias

import numpy as np
from numpy.typing import NDArray

from memtransfer._extras import missing
from memtransfer._names import did_you_mean
from memtransfer._native import Lanes
from memtransfer.codes import Action, Feedback, Heading
from memtransfer.trajectories import sides

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.envs.registration import register
    from gymnasium.error import ClosedEnvironmentError, DependencyNotInstalled, ResetNeeded
    from gymnasium.utils import EzPickle, seeding
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise missing(error, "gym") from None

Observation: TypeAlias = dict[str, Any]
Pixels: TypeAlias = NDArray[np.uint8]
Actions: TypeAlias = Sequence[SupportsIndex] | NDArray[np.integer[Any]]
"""An action for each environment."""

_REFERENCES = {
    ("original", "unchanged"): "original",
    ("opposite", "unchanged"): "opposite",
    ("nearby", "unchanged"): "nearby",
    ("distant", "unchanged"): "distant",
    ("new", "unchanged"): "test",
    ("new", "blocked"): "blocked",
}
"""The reference of a case that starts as an episode with this start and route does."""


class _Choice(NamedTuple):
    """An episode that an environment may draw."""

    case: str
    start: str
    route: str


_LARGEST_COORDINATE = 63
"""Worlds have at most 64 columns and rows."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The keyword arguments of both environments. Where one takes several values, each episode draws one of them."""

    case: str | Sequence[str] | None = None
    """The ids of cases (`memtransfer ls cases`); `None` for all."""
    start: str | Sequence[str] = "original"
    """`original` (where a demonstration starts) or `new`; `opposite`, `nearby` and `distant` are where other demonstrations start."""
    route: str | Sequence[str] = "unchanged"
    """`unchanged`, or `blocked` (a passage of the demonstrations is closed; new starts only)."""
    frame_size: int | tuple[int, int] = 448
    """Width and height of the view in pixels; the width is a multiple of 64."""
    plates: bool = False
    """Whether a coloured plate hangs above every item."""
    labels: bool = True
    """Whether anything is written in the warehouse."""
    appearance_seed: int = 0
    """Varies the light and the tints of walls, floor and racks; 0 is the standard look."""
    anti_aliasing: bool = True
    """Without it rendering takes less time, and the views differ from those of a run."""
    max_steps: int = 200
    """Steps after which an episode is truncated."""
    assets: str | os.PathLike[str] | None = None
    """The folder of another world (`memtransfer generate world`)."""


def _settings(given: Mapping[str, Any]) -> Settings:
    known = [field.name for field in fields(Settings)]
    for name in given:
        if name not in known:
            raise TypeError(f"there is no setting {name!r}{did_you_mean(name, [*known, *_ARGUMENTS])}")
    settings = Settings(**given)
    for name in ("plates", "labels", "anti_aliasing"):
        _check_flag(name, getattr(settings, name))
    return settings


_ARGUMENTS = ("render_mode", "copy", "autoreset_mode", "num_envs")
"""Those of the constructors that are no settings."""


class _Episodes:
    """Episodes in lanes, one for each environment."""

    def __init__(self, lanes: int, copy: bool, settings: Settings) -> None:
        _check_flag("copy", copy)
        width, height = sides(settings.frame_size)
        seed = _integer("appearance_seed", settings.appearance_seed, (0, 2**64 - 1))
        look = (settings.plates, settings.labels, seed)
        self.lanes = Lanes(lanes, (width, height), look, settings.anti_aliasing, settings.assets)
        cases = _several("case", settings.case) if settings.case is not None else self.lanes.cases
        if not cases:
            raise ValueError("case is empty: leave it out for all cases")
        unknown = sorted(set(cases) - set(self.lanes.cases))
        if unknown:
            raise ValueError(f"there is no case {unknown[0]!r}; `memtransfer ls cases` lists the cases")
        starts, routes = _several("start", settings.start), _several("route", settings.route)
        pairs = [pair for pair in product(starts, routes) if pair in _REFERENCES]
        known_starts, known_routes = ({*names} for names in zip(*_REFERENCES))
        if not pairs or {*starts} - known_starts or {*routes} - known_routes:
            raise ValueError(
                f"no episode has start {settings.start!r} and route {settings.route!r}: starts are original and "
                "new, or opposite, nearby and distant; routes are unchanged and, from new starts only, blocked"
            )
        self.choices = [_Choice(case, start, route) for case, (start, route) in product(cases, pairs)]
        self.copy = copy
        self.max_steps = _integer("max_steps", settings.max_steps, (1, 2**32 - 1))
        self.pixels: Pixels = np.asarray(self.lanes)
        self.poses = np.zeros((lanes, 3), np.int32)
        self.feedback = np.zeros(lanes, np.int64)
        self.instructions = [""] * lanes
        self.infos: list[dict[str, Any]] = [{} for _ in range(lanes)]
        # The steps taken; `None` if no episode is running.
        self.steps: list[int | None] = [None] * lanes
        pose = np.array([_LARGEST_COORDINATE, _LARGEST_COORDINATE, len(Heading) - 1], np.int32)
        self.observation_space = spaces.Dict(
            {
                "pixels": spaces.Box(0, 255, (height, width, 3), np.uint8),
                "pose": spaces.Box(np.zeros(3, np.int32), pose, dtype=np.int32),
                "instruction": spaces.Text(
                    self.lanes.longest_instruction, charset=string.ascii_letters + " -,."
                ),
                "feedback": spaces.Discrete(len(Feedback)),
            }
        )
        self.action_space = spaces.Discrete(len(Action))

    def begin(self, lane: int, random: np.random.Generator, options: dict[str, Any] | None) -> None:
        """Begins an episode."""
        wanted = {**(options or {})}
        wanted.pop("reset_mask", None)
        unknown = sorted({*wanted} - {*_Choice._fields})
        if unknown:
            raise ValueError(
                f"there is no option {unknown[0]!r}; options are case, start, route and, for many environments, reset_mask"
            )
        choices = self.choices
        for name, value in wanted.items():
            if value is None:
                continue
            choices = [choice for choice in choices if getattr(choice, name) == value]
            if not choices:
                raise ValueError(f"the {name} {value!r} of the options is not one of the environment's")
        case, start, route = choices[random.integers(len(choices))]
        begun = self.lanes.begin(lane, case, _REFERENCES[start, route])
        self.instructions[lane], self.poses[lane], length = begun
        self.infos[lane] = {"case": case, "start": start, "route": route, "reference_length": length}
        self.feedback[lane] = Feedback.START
        self.steps[lane] = 0

    def check(self, lane: int, action: Any) -> int:
        """Returns the number of an action that can be executed in a lane. Nothing has happened where it raises."""
        if self.steps[lane] is None:
            raise ResetNeeded("the episode has ended or has not begun: call reset()")
        return _integer("action", action, (0, len(Action) - 1))

    def act(self, lane: int, taken: int) -> tuple[bool, bool, dict[str, Any]]:
        """Executes an action, which must be checked. Returns whether the task is complete, whether the episode is truncated, and the
        info."""
        steps = self.steps[lane] or 0
        self.poses[lane], self.feedback[lane], success = self.lanes.act(lane, taken)
        truncated = not success and steps + 1 >= self.max_steps
        self.steps[lane] = None if success or truncated else steps + 1
        return success, truncated, {"is_success": success, **(self.infos[lane] if success or truncated else {})}

    def observation(self, lane: int) -> Observation:
        """What the agent of a lane observes; its view must have been drawn."""
        pixels = self.pixels[lane]
        return {
            "pixels": pixels.copy() if self.copy else pixels,
            "pose": self.poses[lane].copy(),
            "instruction": self.instructions[lane],
            "feedback": self.feedback[lane],
        }


class _Open:
    """What both environments have until they are closed."""

    _open: _Episodes | None

    @property
    def _episodes(self) -> _Episodes:
        if self._open is None:
            raise ClosedEnvironmentError("the environment has been closed: make another")
        return self._open


class MemTransferEnv(_Open, gymnasium.Env[Observation, SupportsIndex], EzPickle):
    """One episode at a time. The reward is 1 for the step that completes the task, and otherwise 0. A pickle and a deep copy are a new
    environment with the same settings."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}

    def __init__(self, *, render_mode: str | None = None, copy: bool = True, **settings: Any) -> None:
        """Opens the environment.

        Args:
            render_mode: `human` shows the view in a window, which needs pygame; `rgb_array` is for `render()`.
            copy: With `False`, `pixels` is the read-only buffer itself, and every step overwrites it.
            **settings: The fields of `Settings`.
        """
        EzPickle.__init__(self, render_mode=render_mode, copy=copy, **settings)
        _check_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        self._window = _Window(self.metadata["render_fps"]) if render_mode == "human" else None
        self._open = _Episodes(1, copy, _settings(settings))
        self.observation_space = self._episodes.observation_space
        self.action_space = self._episodes.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode. The seed determines which one; `options={"case": "t03-07"}` names its case, `start` and `route` likewise.
        The info has its case, start, route and reference length."""
        super().reset(seed=seed)
        self._episodes.begin(0, self.np_random, options)
        return self._observe(), dict(self._episodes.infos[0])

    def step(self, action: SupportsIndex) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Executes an action: a `memtransfer.Action` or its number."""
        success, truncated, info = self._episodes.act(0, self._episodes.check(0, action))
        return self._observe(), float(success), success, truncated, info

    def render(self) -> Pixels | None:
        """Returns the view with `render_mode="rgb_array"`."""
        view = self._episodes.pixels[0]
        return view.copy() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Closes the window, if there is one. The environment cannot be used any more."""
        self._open = None
        if self._window is not None:
            self._window.close()

    def _observe(self) -> Observation:
        self._episodes.lanes.draw()
        if self._window is not None:
            self._window.show(self._episodes.pixels[0])
        return self._episodes.observation(0)


class MemTransferVectorEnv(_Open, VectorEnv[Observation, Actions, NDArray[Any]], EzPickle):
    """Many episodes at the same time, whose views are rendered by all cores. A pickle and a deep copy are a new environment with the same
    settings."""

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        copy: bool = True,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        """Opens the environment.

        Args:
            num_envs: The number of episodes at the same time.
            render_mode: `rgb_array` is for `render()`.
            copy: With `False`, `pixels` is the read-only buffer itself, and every step overwrites it.
            autoreset_mode: When the next episode begins, as for Gymnasium's own vector environments.
            **settings: The fields of `Settings`.
        """
        arguments = {"render_mode": render_mode, "copy": copy, "autoreset_mode": autoreset_mode}
        EzPickle.__init__(self, num_envs, **arguments, **settings)
        self._open = None
        num_envs = _integer("num_envs", num_envs, (1, 2**16))
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": MemTransferEnv.metadata["render_fps"],
            "autoreset_mode": self.autoreset_mode,
        }
        _check_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        self.num_envs = num_envs
        self._open = _Episodes(num_envs, copy, _settings(settings))
        self.single_observation_space = self._episodes.observation_space
        self.single_action_space = self._episodes.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._randoms = [np.random.default_rng() for _ in range(num_envs)]
        self._ended = np.zeros(num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode in every environment, or in those of `options["reset_mask"]`.

        Environment `i` is seeded with `seed + i`, or with `seed[i]`. The options `case`, `start` and `route` name what it begins with.
        """
        if isinstance(seed, (int, np.integer)):
            seeds: Sequence[int | None] | None = [int(seed) + lane for lane in range(self.num_envs)]
        else:
            seeds = seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"there are {len(seeds)} seeds for {self.num_envs} environments")
        chosen = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_)))
        if chosen.shape != (self.num_envs,) or chosen.dtype != np.bool_:
            raise ValueError(f"reset_mask must be an array of {self.num_envs} booleans")
        lanes = np.flatnonzero(chosen).tolist()
        seeded = {} if seeds is None else {lane: seeds[lane] for lane in lanes if seeds[lane] is not None}
        # All before any is used: a seed may be refused.
        for lane, random in [(lane, seeding.np_random(seed)[0]) for lane, seed in seeded.items()]:
            self._randoms[lane] = random
        infos: dict[str, Any] = {}
        for lane in lanes:
            infos = self._begin(lane, infos, options)
        return self._observe(), infos

    def step(
        self, actions: Actions
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Executes an action in every environment."""
        if len(actions) != self.num_envs:
            raise ValueError(f"there are {len(actions)} actions for {self.num_envs} environments")
        begins = self._ended & (self.autoreset_mode is AutoresetMode.NEXT_STEP)
        # All before any is executed.
        taken = [
            None if begins[lane] else self._episodes.check(lane, action) for lane, action in enumerate(actions)
        ]
        terminations, truncations = (np.zeros(self.num_envs, np.bool_) for _ in range(2))
        infos: dict[str, Any] = {}
        final_infos: dict[int, dict[str, Any]] = {}
        for lane, action in enumerate(taken):
            if action is None:
                infos = self._begin(lane, infos)
                continue
            terminations[lane], truncations[lane], info = self._episodes.act(lane, action)
            self._ended[lane] = terminations[lane] or truncations[lane]
            if self._ended[lane] and self.autoreset_mode is AutoresetMode.SAME_STEP:
                final_infos[lane] = info
            else:
                infos = self._add_info(infos, info, lane)
        if final_infos:
            self._episodes.lanes.draw()
            for lane, info in final_infos.items():
                # The buffer gets the view of the next episode.
                last = {**self._episodes.observation(lane), "pixels": self._episodes.pixels[lane].copy()}
                infos = self._add_info(infos, {"final_obs": last, "final_info": info}, lane)
                infos = self._begin(lane, infos)
        return self._observe(), terminations.astype(np.float64), terminations, truncations, infos

    def render(self) -> tuple[Pixels, ...] | None:
        """Returns the views with `render_mode="rgb_array"`."""
        views = self._episodes.pixels
        return tuple(views.copy()) if self.render_mode == "rgb_array" else None

    def close_extras(self, **_: Any) -> None:
        """Closes the environment, which cannot be used any more."""
        self._open = None

    def _begin(self, lane: int, infos: dict[str, Any], options: dict[str, Any] | None = None) -> dict[str, Any]:
        """Begins an episode in a lane. Returns `infos` with its info."""
        self._episodes.begin(lane, self._randoms[lane], options)
        self._ended[lane] = False
        return self._add_info(infos, self._episodes.infos[lane], lane)

    def _observe(self) -> Observation:
        episodes = self._episodes
        episodes.lanes.draw()
        return {
            "pixels": episodes.pixels.copy() if episodes.copy else episodes.pixels,
            "pose": episodes.poses.copy(),
            "instruction": tuple(episodes.instructions),
            "feedback": episodes.feedback.copy(),
        }


class _Window:
    """A window that shows a view."""

    def __init__(self, fps: int) -> None:
        try:
            import pygame
        except ModuleNotFoundError as error:
            raise DependencyNotInstalled(
                'render_mode="human" needs pygame: run pip install \'memtransfer[gym]\''
            ) from error
        self._pygame = pygame
        self._fps = fps
        self._clock = pygame.time.Clock()
        self._screen: Any = None

    def show(self, view: Pixels) -> None:
        pygame = self._pygame
        across_first = view.transpose(1, 0, 2)
        if self._screen is None:
            pygame.display.init()
            pygame.display.set_caption("MemTransfer")
            self._screen = pygame.display.set_mode(across_first.shape[:2])
        pygame.event.pump()
        self._screen.blit(pygame.surfarray.make_surface(across_first), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None


register(
    id="MemTransfer-v0",
    entry_point="memtransfer.gym:MemTransferEnv",
    vector_entry_point="memtransfer.gym:MemTransferVectorEnv",
)


def _several(name: str, values: Any) -> Sequence[str]:
    """The values of a setting that takes one text or several."""
    several = list(values) if isinstance(values, Iterable) and not isinstance(values, str) else [values]
    if not all(isinstance(value, str) for value in several):
        raise TypeError(f"{name} must be a str or several, not {values!r}")
    return several


def _integer(name: str, value: Any, bounds: tuple[int, int]) -> int:
    """`value` as an integer within `bounds`, which are allowed, too."""
    try:
        integer = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name} must be an integer, not {value!r}") from error
    least, most = bounds
    if not least <= integer <= most:
        raise ValueError(f"{name} must be at least {least} and at most {most}, not {integer}")
    return integer


def _check_flag(name: str, value: Any) -> None:
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be a bool, not {value!r}")


def _check_render_mode(mode: str | None, metadata: dict[str, Any]) -> None:
    modes = metadata["render_modes"]
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode {mode!r} is not one of {', '.join(modes)}")
