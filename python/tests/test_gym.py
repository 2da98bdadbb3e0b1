"""The Gymnasium environment. That it shows what a run shows is tested with a run (`policies/environment.py`)."""

from __future__ import annotations

import pickle
import re
import sys
import warnings
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, DependencyNotInstalled, ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from memtransfer import Action, Feedback
from memtransfer.gym import MemTransferEnv, MemTransferVectorEnv

NAME = "memtransfer.gym:MemTransfer-v0"
CASES = ["t01-01", "t03-07", "t07-02"]
SMALL: dict[str, Any] = {"case": CASES, "start": ["original", "new"], "frame_size": 64}


def expert(case: str, reference: str) -> tuple[tuple[int, int, int], list[int]]:
    """The start and the actions of a reference, from the file of the cases."""
    text = (Path(__file__).parents[2] / "assets/cases.toml").read_text()
    entry = text.split(f'id = "{case}"')[1]
    found = re.search(rf'^{reference} = "(\d+),(\d+),(\w) (\w*)"', entry, re.MULTILINE)
    assert found is not None
    x, y, heading, letters = found.groups()
    return (int(x), int(y), "NESW".index(heading)), ["fblrLRU".index(letter) for letter in letters]


def test_check_env_has_nothing_to_say(monkeypatch: pytest.MonkeyPatch) -> None:
    # It tries every render mode.
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(NAME, render_mode="rgb_array", **SMALL).unwrapped)


def test_both_environments_are_registered() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(NAME, case="t01-01", frame_size=(128, 64), render_mode="rgb_array")
        assert isinstance(env.unwrapped, MemTransferEnv)
        observation, info = env.reset(seed=1)
        assert observation["pixels"].shape == (64, 128, 3)
        assert (env.render() == observation["pixels"]).all()
        assert observation["instruction"] == "Find a yellow fire extinguisher."
        assert observation["feedback"] == Feedback.START
        expected = {"case": "t01-01", "start": "original", "route": "unchanged", "reference_length": 16}
        assert info == expected
        envs = gymnasium.make_vec(NAME, num_envs=3, render_mode="rgb_array", **SMALL)
        assert isinstance(envs, MemTransferVectorEnv)
        assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        observations, _ = envs.reset(seed=1)
        assert observations in envs.observation_space
        assert len(envs.render()) == 3
        assert gymnasium.make_vec(envs.spec).num_envs == 3


@pytest.mark.parametrize(
    ("start", "route", "reference"),
    [("original", "unchanged", "original"), ("new", "unchanged", "test"), ("new", "blocked", "blocked")],
)
@pytest.mark.parametrize("case", CASES)
def test_the_actions_of_the_expert_succeed(case: str, start: str, route: str, reference: str) -> None:
    env = MemTransferEnv(case=case, start=start, route=route, frame_size=np.int64(64))
    pose, actions = expert(case, reference)
    observation, of_episode = env.reset()
    assert tuple(observation["pose"]) == pose
    length = of_episode["reference_length"]
    assert of_episode == {"case": case, "start": start, "route": route, "reference_length": length}
    for taken, action in enumerate(actions):
        assert set(observation) == {"pixels", "pose", "instruction", "feedback"}
        observation, reward, terminated, truncated, info = env.step(action)
        assert info == {"is_success": terminated, **(of_episode if terminated else {})}
        assert observation in env.observation_space and not truncated
        assert (reward, info["is_success"]) == (float(terminated), terminated)
        if terminated:
            # Only a turn towards the rack may follow.
            assert len(actions) - taken <= 3
            break
    assert terminated and taken + 1 == length
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_a_closed_passage_blocks_what_the_expert_does_without_it() -> None:
    env = MemTransferEnv(case="t01-01", start="new", route="blocked", frame_size=64)
    env.reset()
    _, actions = expert("t01-01", "test")
    feedback = []
    for action in actions:
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
        feedback.append(observation["feedback"])
    assert Feedback.BLOCKED in feedback


def test_seeds_reproduce_episodes_and_draw_all_of_them() -> None:
    one, other = MemTransferEnv(**SMALL), MemTransferEnv(**SMALL)
    seen = set()
    for seed in range(40):
        assert data_equivalence(one.reset(seed=seed), other.reset(seed=seed), exact=True)
        observation, _ = one.reset()
        assert data_equivalence(observation, other.reset()[0], exact=True)
        seen.add((observation["instruction"], *observation["pose"]))
    assert len(seen) == 6
    for case in CASES:
        (observation, _), (again, _) = (one.reset(options={"case": case}) for _ in range(2))
        assert observation["instruction"] == again["instruction"]
    with pytest.raises(ValueError, match="t09-09"):
        one.reset(options={"case": "t09-09"})


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_vector_environment_equals_single_ones(mode: AutoresetMode) -> None:
    settings = {**SMALL, "max_steps": 20}
    singles = SyncVectorEnv([lambda: MemTransferEnv(**settings)] * 5, autoreset_mode=mode)
    vector = MemTransferVectorEnv(5, autoreset_mode=mode, **settings)
    assert vector.observation_space == singles.observation_space
    assert vector.action_space == singles.action_space
    assert data_equivalence(vector.reset(seed=3), singles.reset(seed=3))
    vector.action_space.seed(1)
    ended = 0
    for step in range(50):
        actions = vector.action_space.sample()
        expected = singles.step(actions)
        assert data_equivalence(vector.step(actions), expected), step
        over = expected[2] | expected[3]
        ended += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            masked = [env.reset(options={"reset_mask": over.copy()}) for env in (vector, singles)]
            assert data_equivalence(*masked)
    assert ended >= 10


def test_a_success_ends_the_episode_of_its_lane_alone() -> None:
    vector = MemTransferVectorEnv(2, case="t01-01", frame_size=64)
    _, of_episodes = vector.reset(seed=1)
    for action in expert("t01-01", "original")[1]:
        _, rewards, terminations, truncations, infos = vector.step(np.array([action, Action.TURN_LEFT]))
        if terminations.any():
            break
    assert terminations.tolist() == infos["is_success"].tolist() == [True, False]
    assert rewards.tolist() == [1.0, 0.0] and not truncations.any()
    assert infos["_case"].tolist() == [True, False] and infos["case"][0] == of_episodes["case"][0] == "t01-01"


def test_observations_are_copies_unless_asked_otherwise() -> None:
    env = MemTransferEnv(**SMALL)
    first, _ = env.reset(seed=1)
    kept = first["pixels"].copy()
    second = env.step(Action.TURN_AROUND)[0]
    assert (first["pixels"] == kept).all() and (second["pixels"] != kept).any()
    env = MemTransferEnv(copy=False, **SMALL)
    first, _ = env.reset(seed=1)
    second = env.step(Action.TURN_AROUND)[0]
    assert np.shares_memory(first["pixels"], second["pixels"])
    assert not second["pixels"].flags.writeable
    vector = MemTransferVectorEnv(2, copy=False, **SMALL)
    first, _ = vector.reset(seed=1)
    del vector
    assert first["pixels"].any()


def test_an_episode_is_truncated_after_its_steps() -> None:
    env = MemTransferEnv(case="t03-07", frame_size=64, max_steps=3)
    for _ in range(2):
        env.reset()
        ends = [env.step(Action.TURN_LEFT)[2:4] for _ in range(3)]
        assert ends == [(False, False), (False, False), (False, True)]


def test_appearance_changes_pixels_only() -> None:
    reset = [
        MemTransferEnv(**SMALL, **look).reset(seed=5)[0]
        for look in ({}, {"plates": True}, {"labels": False}, {"appearance_seed": 7}, {"anti_aliasing": False})
    ]
    for other in reset[1:]:
        assert data_equivalence(reset[0]["pose"], other["pose"])
        assert (reset[0]["pixels"] != other["pixels"]).any()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"case": "t99-01"}, "there is no case 't99-01'; `memtransfer ls cases` lists the cases"),
        ({"start": "original", "route": "blocked"}, "from new starts only, blocked"),
        ({"start": "old"}, "starts are original and new"),
        ({"frame_size": 64.0}, "frame_size must be an integer, or width and height, not 64.0"),
        ({"frame_size": (64,)}, "frame_size must be an integer, or width and height, not (64,)"),
        ({"frame_size": 100}, "the width must be a multiple of 64"),
        ({"frame_size": -64}, "frame_size must be positive, not -64"),
        ({"max_steps": 0}, "max_steps must be at least 1"),
        ({"max_steps": "5"}, "max_steps must be an integer, not '5'"),
        ({"max_steps": 2.5}, "max_steps must be an integer, not 2.5"),
        ({"plates": "off"}, "plates must be a bool, not 'off'"),
        ({"labels": 2}, "labels must be a bool, not 2"),
        ({"copy": "no"}, "copy must be a bool, not 'no'"),
        ({"case": 3}, "case must be a str or several, not 3"),
        ({"start": None}, "start must be a str or several, not None"),
        ({"case": []}, "case is empty: leave it out for all cases"),
        ({"appearance_seed": -1}, "appearance_seed must be at least 0"),
        ({"assets": "nowhere"}, "nowhere"),
        ({"render_mode": "ansi"}, "human, rgb_array"),
        ({"strat": "new"}, "there is no setting 'strat': did you mean 'start'?"),
        ({"cases": "t01-01"}, "there is no setting 'cases': did you mean 'case'?"),
        ({"render-mod": "human"}, "there is no setting 'render-mod': did you mean 'render_mode'?"),
        ({"velocity": 3}, "there is no setting 'velocity'"),
    ],
)
def test_settings_that_make_no_environment(settings: dict[str, Any], said: str) -> None:
    with pytest.raises((TypeError, ValueError), match=re.escape(said)):
        MemTransferEnv(**settings)


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_misspelt_settings_are_refused_by_gymnasium(make: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match="there is no setting 'strat': did you mean 'start'"):
        make(NAME, strat="new")


def test_spl_and_success_by_case_follow_from_infos() -> None:
    env = MemTransferEnv(case=CASES, start=["original", "new"], route=["unchanged", "blocked"], frame_size=64)
    references = {("original", "unchanged"): "original", ("new", "unchanged"): "test", ("new", "blocked"): "blocked"}
    scores: dict[str, list[float]] = {}
    for seed in range(12):
        _, info = env.reset(seed=seed)
        _, actions = expert(info["case"], references[info["start"], info["route"]])
        # A detour of `seed` steps, which the pose does not show.
        actions = [Action.TURN_LEFT, Action.TURN_RIGHT] * seed + actions
        for step, action in enumerate(actions, 1):
            _, _, terminated, _, info = env.step(action)
            if terminated:
                break
        length = info["reference_length"]
        assert (info["is_success"], step) == (True, length + 2 * seed)
        scores.setdefault(info["case"], []).append(info["is_success"] * length / max(step, length))
        assert scores[info["case"]][-1] == length / (length + 2 * seed)
    assert set(scores) == set(CASES)


def test_a_closed_environment_says_so() -> None:
    env, envs = gymnasium.make(NAME, render_mode="rgb_array", **SMALL), gymnasium.make_vec(NAME, num_envs=2, **SMALL)
    view = MemTransferVectorEnv(2, copy=False, **SMALL)
    kept = view.reset(seed=1)[0]["pixels"]
    env.reset()
    envs.reset()
    for one in (env, envs, view):
        one.close()
        one.close()
    calls: list[Callable[[], Any]] = [env.reset, lambda: env.step(0), env.render, envs.reset, lambda: envs.step([0, 0])]
    for call in calls:
        with pytest.raises(ClosedEnvironmentError, match="has been closed"):
            call()
    assert kept.any()


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), deepcopy])
def test_pickles_and_deep_copies_are_new_environments_with_the_same_settings(copied: Callable[[Any], Any]) -> None:
    settings = {**SMALL, "max_steps": 3, "render_mode": "rgb_array"}
    for env in (MemTransferEnv(**settings), gymnasium.make(NAME, **settings)):
        env.reset(seed=5)
        env.step(Action.TURN_LEFT)
        another = copied(env)
        env.close()
        with pytest.raises(ResetNeeded):
            another.step(Action.TURN_LEFT)
        assert data_equivalence(another.reset(seed=4), MemTransferEnv(**settings).reset(seed=4), exact=True)
        assert [another.step(Action.TURN_LEFT)[3] for _ in range(3)] == [False, False, True]
        assert another.render() is not None
    envs = MemTransferVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **settings)
    another = copied(envs)
    envs.close()
    assert (another.num_envs, another.autoreset_mode) == (2, AutoresetMode.DISABLED)
    assert data_equivalence(another.reset(seed=4), MemTransferVectorEnv(2, **settings).reset(seed=4))


def test_an_action_is_one_of_the_codes_or_any_integer() -> None:
    env, envs = MemTransferEnv(**SMALL), MemTransferVectorEnv(2, **SMALL)
    for action in (Action.TURN_LEFT, 4, np.int64(4), np.uint8(4)):
        first, _ = env.reset(seed=1)
        observation = env.step(action)[0]
        assert observation["pose"].tolist() == [*first["pose"][:2], (first["pose"][2] + 3) % 4]
        envs.reset(seed=1)
        assert (envs.step([action, action])[0]["pose"][0] == observation["pose"]).all()


def test_an_invalid_action_is_refused() -> None:
    env = MemTransferEnv(**SMALL)
    with pytest.raises(ResetNeeded):
        env.step(Action.FORWARD)
    env.reset()
    for action in (7, -1):
        with pytest.raises(ValueError, match=f"action must be at least 0 and at most 6, not {action}"):
            env.step(action)
    with pytest.raises(TypeError, match="action must be an integer, not 4.9"):
        env.step(4.9)
    envs = MemTransferVectorEnv(3, **SMALL)
    envs.reset()
    with pytest.raises(ValueError, match="there are 2 actions for 3 environments"):
        envs.step(np.array([Action.FORWARD, Action.FORWARD]))


def test_a_refused_call_has_changed_no_environment() -> None:
    envs, other = (MemTransferVectorEnv(3, **SMALL) for _ in range(2))
    envs.reset(seed=1)
    other.reset(seed=1)
    for actions in ([0, 2, 9], [0, 2, 1.5]):
        with pytest.raises((TypeError, ValueError), match="action must be"):
            envs.step(actions)
    with pytest.raises(gymnasium.error.Error, match="greater or equal to zero"):
        envs.reset(seed=[7, -1, 3])
    assert data_equivalence(envs.step([2, 2, 2])[0], other.step([2, 2, 2])[0])
    assert data_equivalence(envs.reset()[0], other.reset()[0])


def test_an_unknown_option_of_reset_is_refused() -> None:
    with pytest.raises(ValueError, match="there is no option 'cases'; options are case"):
        MemTransferEnv(**SMALL).reset(options={"cases": "t01-01"})


def test_a_person_sees_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = MemTransferEnv(render_mode="human", **SMALL)
    observation, _ = env.reset(seed=1)
    import pygame

    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert (shown.transpose(1, 0, 2) == observation["pixels"]).all()
    env.step(Action.TURN_LEFT)
    env.close()
    assert pygame.display.get_surface() is None


def test_without_pygame_there_is_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'memtransfer\[gym\]'"):
        MemTransferEnv(render_mode="human", **SMALL)


def test_options_name_the_case_the_start_and_the_route() -> None:
    pairs = [("nearby", "unchanged"), ("new", "unchanged"), ("new", "blocked"), ("original", "unchanged")]
    starts, routes = ({*names} for names in zip(*pairs))
    several = MemTransferEnv(**{**SMALL, "start": sorted(starts), "route": sorted(routes)})
    poses = set()
    for start, route in pairs:
        options = {"case": "t03-07", "start": start, "route": route}
        observation, _ = several.reset(options=options)
        same, _ = MemTransferEnv(**{**SMALL, **options}).reset()
        assert data_equivalence(observation, same, exact=True)
        poses.add(tuple(observation["pose"].tolist()))
    assert len(poses) == 3
    with pytest.raises(ValueError, match="the start 'distant' of the options is not one of the environment's"):
        several.reset(options={"start": "distant"})
