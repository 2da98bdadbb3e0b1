"""Reading a run's folder. `run/` is one of three episodes, of which one is complete, and one given up."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from memtransfer.results import read

RUN = Path(__file__).parent / "run"


def test_episodes_are_rows_with_typed_columns() -> None:
    results = read(RUN)
    episodes = results.episodes.set_index("key")
    assert len(episodes) == 4 and episodes.index.is_unique
    done = episodes.loc["working/original/unchanged/none/run1/t01-01"]
    assert (done["success"], done["spl"], done["task"], done["group"]) == (True, 0.8, 1, "basic")
    assert (done["window"], done["segment"], done["hint"]) == (6, "actions", "on")
    assert (done["prompt_tokens"], done["unreadable"], done["refused"]) == (8123, 2, 1)
    assert (done["blocked_moves"], done["sub_goals_met"], done["required"]) == (2, 1, 1)
    other = episodes.loc["working/new/blocked/none/h20/no-hint/run1/t04-04"]
    assert (other["success"], other["spl"], other["window"]) == (False, 0.0, 20)
    assert (other["hint"], other["tried_closed"], other["group"]) == ("off", True, "multi-object")
    # Not measured is missing, and not zero.
    assert pd.isna(other["prompt_tokens"]) and pd.isna(done["tried_closed"])
    assert int(done["seed"]) == 9715375329605859533
    kinds = results.episodes.dtypes
    assert (str(kinds["steps"]), str(kinds["success"]), str(kinds["memory"])) == (
        "Int64",
        "boolean",
        "category",
    )


def test_what_was_given_up_is_an_attempt_without_success() -> None:
    episodes = read(RUN).episodes
    (row,) = episodes[episodes["ending"] == "given-up"].to_dict("records")
    assert (row["memory"], row["start"], row["route"]) == ("summary", "new", "blocked")
    assert (row["demonstrations"], row["window"], row["hint"]) == ("4", 20, "off")
    assert (row["run"], row["case"], row["success"], row["spl"]) == (2, "t03-07", False, 0.0)
    assert row["error"] == "policy: the server is down"
    assert episodes["success"].mean() == 0.25


def test_manifest_timings_and_sessions() -> None:
    results = read(str(RUN))
    assert results.manifest["settings"]["limit"] == 3
    assert len(results.timings) == 3
    first = results.timings.iloc[0]
    assert first["steps"] == 20 and first["decide_ns"] > 0
    assert [event["event"] for event in results.sessions] == ["ready", "ended"]


def test_a_run_that_has_only_begun(tmp_path: Path) -> None:
    shutil.copy(RUN / "manifest.json", tmp_path)
    results = read(tmp_path)
    assert results.episodes.empty and str(results.episodes["steps"].dtype) == "Int64"


def test_what_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is not the folder of a run"):
        read(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 99}))
    with pytest.raises(ValueError, match="format 99, and this package reads 2"):
        read(tmp_path)
    shutil.copy(RUN / "manifest.json", tmp_path)
    (tmp_path / "episodes.jsonl").write_text("{}}\n")
    with pytest.raises(ValueError, match=r"episodes.jsonl, line 1: "):
        read(tmp_path)


def test_reading_needs_no_transport() -> None:
    script = "import sys, memtransfer.results; sys.exit('iceoryx2' in sys.modules)"
    package = str(RUN.parent.parent)
    subprocess.run([sys.executable, "-c", script], check=True, env={"PYTHONPATH": package})
