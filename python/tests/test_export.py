"""The command line of `memtransfer.export`. What it writes is opened in `tests/tests/end_to_end/python.rs`, with the libraries of the
formats, which are not installed here."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from memtransfer.export.__main__ import main
from memtransfer.export.common import ExportError, new, refuse_existing
from memtransfer.export.rerun import events
from memtransfer.trajectories import Recording, Trajectory, _trajectories

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


def test_nothing_is_overwritten_and_nothing_half_written_stays(tmp_path: Path) -> None:
    place = tmp_path / "deep/place"
    with pytest.raises(RuntimeError), new(place) as partial:
        partial.mkdir()
        raise RuntimeError
    assert not any(place.parent.iterdir())
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
    (trajectory,) = _trajectories(
        """[{"id": "a/b", "case": "t01-01", "task": 1, "instruction": "Go.", "start": "new", "variant": 0,
        "poses": [[1, 2, 0], [1, 2, 0], [1, 3, 0], [1, 3, 0]], "feedback": [0, 4, 1, 3], "actions": [null, 0, 0],
        "sub_goals": [2], "required": 2, "success": false, "failure": ["out-of-steps", 3], "closed": [], "targets": [],
        "reference": [], "record": {"retrieved": "o1 - o2", "conflict_at": 3}}]"""
    )
    assert isinstance(trajectory, Trajectory)
    assert (trajectory.decided, trajectory.unread) == ([1, 2], 1)
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
