"""Worlds of one's own: the corridor of the examples, what a world may not do, and an environment of Gymnasium as a world.

Runs in such worlds are tested in `tests/tests/end_to_end`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from memtransfer import WorldDeclaration, WorldError
from memtransfer.declaration import parse
from memtransfer.gym_world import GymWorld
from memtransfer.world import DONE, NO_EFFECT, Case, Episode, Field, World, declaration

EXAMPLES = Path(__file__).parents[1] / "examples"
CORRIDOR = EXAMPLES / "corridor_world.py"

sys.path.insert(0, str(EXAMPLES))

from corridor_world import Corridor  # noqa: E402


def request(**changes: Any) -> dict[str, Any]:
    """What a run asks of a case book."""
    asked = {"cases": ["reach-7"], "demonstrations": ["original"], "blocked": True}
    return {"assets": None, **asked, "elsewhere": None, "streams": None, **changes}


def program(script: Path, *arguments: str, lines: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, input=lines, capture_output=True, text=True)


def book(script: Path, folder: Path, **changes: Any) -> subprocess.CompletedProcess[str]:
    """Asks for a case book in `folder`."""
    asked = folder / "request.json"
    asked.write_text(json.dumps(request(**changes)))
    return program(script, "book", "--request", str(asked), "--out", str(folder / "out"))


def act(script: Path, *requests: Any) -> list[Any]:
    """The answers of a world that acts out episodes."""
    done = program(script, "act", lines="".join(json.dumps(asked) + "\n" for asked in requests))
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def episode(actions: list[int | None], route: str = "unchanged", **parts: bool) -> dict[str, Any]:
    reference = {"reference": ["new", route], "variant": int(route == "blocked")}
    stream = {"begin": None, "stream": None}
    return {"episode": {"case": "reach-7", **reference, **stream, "actions": actions, "parts": parts}}


def test_the_case_book_of_the_corridor(tmp_path: Path) -> None:
    done = book(CORRIDOR, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    cases = json.loads((tmp_path / "out/case-book.json").read_text())
    assert [case["id"] for case in cases["cases"]] == ["reach-7", "visit-7", "reach-8", "visit-8"]
    assert [case["invalidated_when_blocked"] for case in cases["cases"]] == [True] * 4
    lengths = [reference["length"] for reference in cases["cases"][3]["references"]]
    assert lengths == [7, 6, 6] and cases["stale"] == {"1": [0], "2": [1], "3": [2], "4": [3]}
    demonstrations = json.loads((tmp_path / "out/demonstrations.json").read_text())["demonstrations"]
    assert demonstrations[1]["sub_goals"] == [5, 6]
    # Cell 7 of the first two tasks is the same picture; once a sub-goal is met, what follows is not the same.
    assert [of["views"] for of in demonstrations][:2] == [[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5, 6]]


def test_the_corridor_acts_out_episodes() -> None:
    done = [0, None, 1, 0]
    free, blocked, unknown, wrong = act(
        CORRIDOR, episode(done, reference=True), episode([0, 0], "blocked"), {"scene": 0}, episode([2])
    )
    assert free["episode"]["states"] == [[3], [4], [4], [3], [4]]
    assert free["episode"]["feedback"] == [0, 1, 3, 1, 1] and free["episode"]["reference"]["length"] == 4
    assert (blocked["episode"]["states"][2], blocked["episode"]["conflict_at"]) == ([4], 2)
    assert unknown == {"error": "this world has no map"}
    assert wrong == {"error": "2 is not an action of this world"}


@pytest.mark.parametrize("blocked", [True, False])
def test_a_book_without_a_request_is_for_any_run(blocked: bool, tmp_path: Path) -> None:
    script = CORRIDOR
    if not blocked:
        script = tmp_path / "open.py"
        script.write_text(CORRIDOR.read_text().replace(', "blocked": [WEST] * (13 - goal)', ""))
    done = program(script, "book", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    stale = json.loads((tmp_path / "out" / "case-book.json").read_text())["stale"]
    assert list(stale) == (["1", "2", "3", "4"] if blocked else [])


def test_a_world_does_not_serve_the_case_book_of_another_version(tmp_path: Path) -> None:
    assert program(CORRIDOR, "book", "--out", str(tmp_path)).returncode == 0
    changed = tmp_path / "changed.py"
    changed.write_text(CORRIDOR.read_text().replace('"corridor", "1"', '"corridor", "2"'))
    environment = {**os.environ, "MEMTRANSFER_ATTACH": str(tmp_path)}
    serve = [sys.executable, str(changed), "serve", "--demonstrations", str(tmp_path / "demonstrations.json")]
    done = subprocess.run(serve, capture_output=True, text=True, env=environment)
    assert done.returncode == 1 and "corridor 1 with another declaration than this program's corridor 2" in done.stderr


DIM_CORRIDOR = f"""
import sys
sys.path.insert(0, {str(EXAMPLES)!r})
from dataclasses import replace
from corridor_world import Corridor
from memtransfer.world import main

class DimCorridor(Corridor):
    mismatches = ["light", "wording"]

    def cases(self):
        for case in super().cases():
            yield replace(case, paraphrase=case.instruction.replace("Walk", "Go"))

    def reset(self, episode):
        self.dim = episode.mismatch == "light"
        return super().reset(episode)

    def render(self, pixels):
        super().render(pixels)
        if self.dim:
            pixels[..., :3] //= 2

main(DimCorridor)
"""


def test_a_world_that_offers_mismatches(tmp_path: Path) -> None:
    script = tmp_path / "dim.py"
    script.write_text(DIM_CORRIDOR)
    assert book(script, tmp_path).returncode == 0
    cases = json.loads((tmp_path / "out/case-book.json").read_text())
    assert cases["world"]["mismatches"] == ["light", "wording"]
    assert cases["cases"][0]["paraphrase"] == "Go to cell 7."
    demonstrations = json.loads((tmp_path / "out/demonstrations.json").read_text())
    assert demonstrations["cases"][0]["paraphrase"] == "Go to cell 7."
    # Light is mismatch 1, of case 0 where the way is free.
    dim = episode([0])
    dim["episode"]["variant"] = 1 << 24
    usual, other = act(script, episode([0]), dim)
    assert usual == other
    lines = b"reach-7.new.\nreach-7.new-light.\nreach-7.new.\n"
    command = [sys.executable, str(script), "views", "--size", "64x64"]
    pixels = subprocess.run(command, input=lines, capture_output=True, check=True).stdout
    first, second, third = np.frombuffer(pixels, dtype=np.uint8).reshape(3, 64, 64, 4)
    assert (first == third).all() and (second[..., :3] == first[..., :3] // 2).all() and (first != second).any()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ('"light", "dark"', "the mismatch 'dark' of the world corridor is none of light, "),
        ('"wording"', "case reach-7 of the world corridor has no paraphrase, and `mismatches` has `wording`"),
    ],
)
def test_a_mismatch_that_a_world_cannot_offer(changed: str, message: str, tmp_path: Path) -> None:
    script = tmp_path / "dim.py"
    text = DIM_CORRIDOR.replace('"light", "wording"', changed).replace('case.instruction.replace("Walk", "Go")', "None")
    script.write_text(text)
    done = book(script, tmp_path)
    assert done.returncode != 0 and message in done.stderr


def test_a_program_that_is_called_otherwise_says_how_it_is_used() -> None:
    done = program(CORRIDOR)
    assert done.returncode == 1 and done.stderr.startswith("memtransfer: usage: WORLD VERB")


WRONG = {
    "reset returned None, which is no Observation": "def reset(self, episode): pass",
    "case reach-7: reset: the state [nan] has a number that is not finite": """
        def observe(self, feedback, conflict=False):
            return Observation([float("nan")], feedback)""",
    "this is no state of the world corridor: it has 2 numbers in place of 1": """
        def observe(self, feedback, conflict=False):
            return Observation([1, 2], feedback)""",
    "case reach-7: step: the hash of the state is 18446744073709551616, not one of 0 to 18446744073709551615": """
        def step(self, action):
            return Observation([3], state_hash=2**64)""",
    "case reach-7: step: the feedback is 4, not one of 0 to 3": "def step(self, action): return Observation([3], 4)",
    "case reach-7: 2 of 1 sub-goals cannot be complete": """
        def step(self, action):
            return Observation([3], sub_goals=2)""",
    "case reach-7: KeyError: 'lost'": 'def step(self, action): raise KeyError("lost")',
    "its trajectory `original` does not complete the task in 5 steps": """
        def step(self, action):
            return Observation([3])""",
    "case reach-7 of the world corridor: another case has the same id": """
        def cases(self):
            return [case for case in super().cases() for _ in range(2)]""",
    "case a of the world corridor: an action of `new` is 2, not one of 0 to 1": """
        def cases(self):
            return [Case("a", "Walk.", {"original": [0], "new": [0, 2]})]""",
    "step returned None, which is no Observation": "def step(self, action): pass",
    "case a of the world corridor: its trajectory `blocked` is None: leave it out, or list its actions": """
        def cases(self):
            return [Case("a", "Walk.", {"original": [0], "new": [0], "blocked": None})]""",
    "its history 'reach-8' is no pair of the id of a case and the name of a demonstration": """
        def cases(self):
            return [Case("a", "Walk.", {}, confusable=["reach-8", "visit-8"])]""",
    "its history reach-8 'new' is none of original, opposite, nearby, distant, after": """
        def cases(self):
            return [Case("a", "Walk.", {}, confusable=[("reach-8", "new")])]""",
    "case a of the world corridor: its number of `confusable` histories is 1, not two or none": """
        def cases(self):
            yield Case("a", "Walk.", {"original": [0], "new": [0]}, confusable=[("reach-7", "original")])
            yield from super().cases()""",
    "the tasks of the world corridor are ['reach'], not a dict of tasks and their groups": 'tasks = ["reach"]',
    "the `version` of the world Wrong is 1, not a string": "version = 1",
    "case reach-7 of the world corridor: it has no trajectory `new`": """
        def cases(self):
            return [Case("reach-7", "Walk.", {"original": [0], "blocked": [1]})]""",
    "case a of the world corridor: the trajectory 'other' is none of original, opposite,": """
        def cases(self):
            return [Case("a", "Walk.", {"other": [0]})]""",
    "case a of the world corridor: its task 'run' is none of reach, visit": """
        def cases(self):
            return [Case("a", "Walk.", {}, task="run")]""",
    "unknown case `reach-7`": "def cases(self): return []",
    'the declaration of the world is not valid: its "name" is not one to 64 small letters': 'name = "Corridor 1"',
    "the world corridor has 2 actions, and letters for 1": 'letters = "x"',
    'its "state_sentence" names "room", which is no field of its states': 'state_sentence = "You are in {room}."',
    "RuntimeError: no display": "def __init__(self): raise RuntimeError('no display')",
}


@pytest.mark.parametrize("message", WRONG)
def test_what_a_world_may_not_do_is_said_in_a_sentence(message: str, tmp_path: Path) -> None:
    script = tmp_path / "wrong.py"
    body = textwrap.indent(textwrap.dedent(WRONG[message]).strip(), "    ")
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(EXAMPLES)!r})\nfrom corridor_world import *\n\n"
        f"class Wrong(Corridor):\n{body}\n\nmain(Wrong)\n"
    )
    done = book(script, tmp_path)
    assert done.returncode == 1 and not (tmp_path / "out").exists()
    last = done.stderr.splitlines()[-1]
    assert message in last, done.stderr
    # What the author's code raises comes with its traceback, what this package says without.
    assert ("Traceback" in done.stderr) == ("Error: " in last), done.stderr


def test_cases_are_listed_once_in_a_process(tmp_path: Path) -> None:
    script = tmp_path / "counted.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(EXAMPLES)!r})\nfrom corridor_world import *\n\n"
        "class Counted(Corridor):\n    def cases(self):\n        print('listed')\n        return super().cases()\n\n"
        "main(Counted)\n"
    )
    done = book(script, tmp_path)
    assert (done.returncode, done.stderr) == (0, "listed\n")


class Unpainted(Corridor):
    """Keeps what it may not keep."""

    def __init__(self, keeps: str) -> None:
        self.keeps = keeps

    def render(self, pixels: Any) -> None:
        super().render(pixels)  # type: ignore[no-untyped-call]
        self.kept = {"array": pixels, "view": pixels[2:, ..., 0], "copy": pixels.copy(), "nothing": None}[self.keeps]


def begun(world: World, start: str = "original", blocked: bool = False) -> tuple[Any, ...]:
    return world._reset(next(iter(world.cases())).id, start, blocked, "none", 5)


@pytest.mark.parametrize("keeps", ["array", "view", "copy", "nothing"])
def test_a_world_may_not_keep_the_array_that_it_draws_into(keeps: str) -> None:
    world = Unpainted(keeps)
    begun(world)
    memory = np.zeros((4, 64, 4), np.uint8)
    if keeps in ("array", "view"):
        with pytest.raises(WorldError, match="render keeps the array"):
            world._render(memoryview(memory))
    else:
        world._render(memoryview(memory))
    assert memory[0, 15].tolist() == [255, 255, 255, 255]


def test_facts_are_what_json_can_hold() -> None:
    world = Corridor()
    assert world._facts() == "{}"
    world.facts = lambda: {"bumps": np.int64(3), "place": np.array([1, 2])}
    assert json.loads(world._facts()) == {"bumps": 3, "place": [1, 2]}
    for facts in [{"distance": float("nan")}, {"where": object()}]:
        world.facts = lambda facts=facts: facts
        with pytest.raises(WorldError, match="facts: .* cannot be written as JSON"):
            world._facts()


def test_a_declaration_is_the_same_as_the_one_of_a_run() -> None:
    declared = declaration(Corridor())
    assert isinstance(declared, WorldDeclaration) and parse(declared.json()) == declared
    assert (declared.letters, declared.action_words(1)) == ("ab", "walk west")
    assert declared.action(1) == 1 and not hasattr(declared.action(1), "words")
    with pytest.raises(ValueError, match="2 is no action of the world corridor, which has 2"):
        declared.action_words(2)
    with pytest.raises(AttributeError, match="the world corridor has no poses: its states have the numbers cell"):
        declared.pose((3.0,))


class Line(gymnasium.Env[np.ndarray[Any, Any], int]):
    """Ten places in a line. Reaching the last one succeeds, the first one fails."""

    metadata = {"render_modes": ["rgb_array"]}
    render_mode = "rgb_array"
    action_space = gymnasium.spaces.Discrete(3)
    observation_space = gymnasium.spaces.Box(0, 9, (1,), np.int64)

    def __init__(self, tells_success: bool) -> None:
        self.tells_success = tells_success

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = int(self.np_random.integers(10))
        return np.array([self.place]), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place += action - 1
        info = {"success": float(self.place == 9)} if self.tells_success else {}
        return np.array([self.place]), 0.0, self.place in (0, 9), False, info

    def render(self) -> Any:
        picture = np.zeros((2, 10, 3), np.uint8)
        picture[0, self.place] = (200, 100, 50)
        return picture


class LineWorld(GymWorld):
    name, version = "line", "1"
    rules = "You go along a line."
    actions = ["go back", "stay", "go on"]
    state = [Field("place")]
    tells_success = True

    def make(self) -> Line:
        return Line(self.tells_success)

    def begin(self, env: Any, episode: Episode) -> None:
        env.place = episode.case.data[episode.start]

    def read(self, env: Any) -> list[int]:
        return [env.place]

    def cases(self) -> list[Case]:
        return [Case("end", "Go to the end.", {"original": [2, 2], "new": [2]}, data={"original": 7, "new": 8})]


def test_an_environment_of_gymnasium_is_a_world() -> None:
    world = LineWorld()
    assert declaration(world).actions == ("go back", "stay", "go on")
    # State, feedback, sub-goals and all of them, whether it failed, conflict, hash.
    assert begun(world) == ([7.0], 0, 0, 1, False, False, None)
    assert world._step(1) == ([7.0], NO_EFFECT, 0, 1, False, False, None)
    assert world._step(2) == ([8.0], DONE, 0, 1, False, False, None)
    pixels = np.zeros((4, 20, 4), np.uint8)
    world._render(memoryview(pixels))
    assert pixels[:2, 16:18].tolist() == [[[200, 100, 50, 255]] * 2] * 2
    assert (pixels[..., 3] == 255).all() and pixels[..., 0].sum() == 4 * 200
    assert world._step(2) == ([9.0], DONE, 1, 1, False, False, None)


def test_an_environment_that_ends_without_success_has_failed() -> None:
    world = LineWorld()
    begun(world)
    told = [world._step(0) for _ in range(7)]
    assert [(sub_goals, failed) for _, _, sub_goals, _, failed, *_ in told] == [(0, False)] * 6 + [(0, True)]
    world.tells_success = False
    world._env = None
    begun(world)
    # Where the environment does not tell whether it succeeded, its end is success.
    assert [world._step(0)[2] for _ in range(7)] == [0] * 6 + [1]


def test_an_environment_that_draws_nothing_is_named() -> None:
    world = LineWorld()
    begun(world)
    world._env.render = lambda: None
    with pytest.raises(WorldError, match="make the environment with render_mode"):
        world._render(memoryview(np.zeros((4, 20, 4), np.uint8)))
