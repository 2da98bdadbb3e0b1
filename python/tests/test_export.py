"""The command line of `memtransfer.export`. What it writes is opened in `tests/tests/end_to_end/python.rs`, with the libraries of the
formats, which are not installed here."""

from __future__ import annotations

import json
import re
import shutil
import warnings
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from memtransfer.export.__main__ import main
from memtransfer.export.common import ExportError, left_out, new, refuse_existing
from memtransfer.export.rerun import events
from memtransfer.trajectories import Recording, Trajectory, _trajectory

RUN = Path(__file__).parents[2] / "crates/scores/tests/rq2-version-1"


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The error of a call that fails."""
    try:
        status = main([*arguments])
    except SystemExit as exit:
        status = int(str(exit.code))
    assert status == 2
    return capsys.readouterr().err


def test_mistakes_are_answered_with_what_to_do(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert "say what to write" in said(capsys, "run")
    nowhere = str(tmp_path / "nowhere")
    assert nowhere in said(capsys, nowhere, "--rrd", "a.rrd")
    assert "not a number from 1" in said(capsys, "run", "--rrd", "a.rrd", "--limit", "0")
    assert "448x336" in said(capsys, "run", "--rrd", "a.rrd", "--frame-size", "large")
    assert "not allowed with" in said(capsys, "run", "--demonstrations", "--only-demonstrations")


@pytest.mark.parametrize("extra", ["lerobot", "minari", "rerun", "croissant"])
def test_a_missing_library_is_named_with_the_command_that_installs_it(
    extra: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    flag = {"rerun": "--rrd"}.get(extra, f"--{extra}")
    error = said(capsys, str(RUN), flag, str(tmp_path / "out"), "--limit", "1")
    assert f"pip install 'memtransfer[{extra}]'" in error
    project = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    assert re.search(rf"^{extra} = \[", project, re.MULTILINE)
    assert not any(tmp_path.iterdir())


def test_episodes_are_read_one_at_a_time_in_the_order_of_the_log(tmp_path: Path) -> None:
    lines = (RUN / "episodes.jsonl").read_text().splitlines(keepends=True)
    lines.reverse()
    keys = [json.loads(line)["key"] for line in lines]
    assert keys != sorted(keys)
    shutil.copytree(RUN, tmp_path, dirs_exist_ok=True)
    # A run whose log says nonsense after two episodes.
    (tmp_path / "episodes.jsonl").write_text("".join([*lines[:2], "damaged\n", *lines[2:]]))
    recording = Recording(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first = list(islice(recording.iter_episodes(), 2))
    assert [episode.id for episode in first] == keys[:2]
    with pytest.warns(UserWarning, match="damaged, left out: episodes.jsonl, line 3"):
        assert [episode.id for episode in recording.episodes()] == keys


def test_what_no_answer_could_be_read_of_is_counted() -> None:
    assert left_out(3, 0) == ""
    assert left_out(3, 1).strip().startswith("1 episode is left out: ")
    assert left_out(3, 2).strip().startswith("2 episodes are left out: ")
    with pytest.raises(ExportError, match="nothing to export"):
        left_out(0, 2)


def test_nothing_is_overwritten_and_nothing_half_written_stays(tmp_path: Path) -> None:
    place = tmp_path / "deep/place"
    with pytest.raises(RuntimeError), new(place) as partial:
        partial.mkdir()
        raise RuntimeError
    assert not any(tmp_path.iterdir())
    with new(place) as partial:
        partial.write_text("whole")
    assert place.read_text() == "whole" and [place] == list(place.parent.iterdir())
    with pytest.raises(ExportError, match="exists"):
        refuse_existing(place)


def test_a_run_is_read_and_its_views_are_rendered() -> None:
    recording = Recording(RUN, frame_size=np.int64(64))
    episode = recording.episodes()[0]
    assert len(episode.poses) == len(episode.feedback) == len(episode.actions) + 1
    views = recording.views(episode)
    assert views.shape == (len(episode.poses), 64, 64, 3) and views.std() > 10
    assert recording.policy_label == "grounded, scripted stand-in"
    floor = recording.floor(episode.variant)
    assert all(floor[row, column] for column, row, _ in episode.poses.tolist())
    blocked = next(one for one in recording.episodes() if one.closed)
    assert not any(recording.floor(blocked.variant)[row, column] for column, row in blocked.closed)
    assert all(recording.floor(0)[row, column] for column, row in blocked.closed)
    demonstration = recording.demonstrations()[0]
    assert demonstration.record is None and demonstration.success
    assert demonstration.sub_goals[-1] == len(demonstration.actions)
    assert [(column, row) for column, row, _ in demonstration.poses.tolist()] == list(demonstration.reference)


def test_steps_without_an_action_are_no_decisions() -> None:
    text = """{"id": "a/b", "case": "t01-01", "task": 1, "instruction": "Go.", "start": "new", "variant": 0,
        "poses": [[1, 2, 0], [1, 2, 0], [1, 3, 0], [1, 3, 0]], "feedback": [0, 4, 1, 3], "actions": [null, 0, 0],
        "sub_goals": [2], "required": 2, "success": false, "failure": ["out-of-steps", 3],
        "environment": ["new", "unchanged"], "closed": [], "targets": [],
        "reference": [], "record": {"retrieved": "o1 - o2", "conflict_at": 3}}"""
    trajectory = _trajectory(json.loads(text))
    assert isinstance(trajectory, Trajectory)
    assert (trajectory.decided, trajectory.unread) == ([1, 2], 1)
    # The observation of the start, and not the one that says that the answer was not understood.
    assert trajectory.observed == [0, 2, 3]
    assert [trajectory.feedback[step] for step in trajectory.observed] == [0, 1, 3]
    assert [f"{step} {words}" for step, level, words in events(trajectory, "grounded, scripted stand-in")] == [
        "0 Policy: grounded, scripted stand-in.",
        "0 Go. From column 1, row 2, facing north.",
        "0 memory supplied o1",
        "1 memory supplied -",
        "1 no action could be read",
        "2 memory supplied o2",
        "2 move forward",
        "2 sub-goal 1 of 2 completed",
        "3 move forward: blocked",
        "3 tried to enter the closed passage",
        "3 failed: out-of-steps",
    ]
