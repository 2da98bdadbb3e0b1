"""Folders that `memtransfer.results` cannot read. Reading real runs is tested in `tests/tests/end_to_end/python.rs`."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from memtransfer.results import read

RUN = Path(__file__).parents[2] / "crates/scores/tests/rq2-version-1"


def test_a_folder_without_a_run(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=re.escape(str(tmp_path))):
        read(tmp_path)


def test_a_run_of_another_version(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 99}))
    with pytest.raises(ValueError, match="manifest.json"):
        read(tmp_path)


def test_damaged_lines_are_warned_of(tmp_path: Path) -> None:
    shutil.copytree(RUN, tmp_path, dirs_exist_ok=True)
    with (tmp_path / "episodes.jsonl").open("a") as file:
        file.write("damaged\n")
    with pytest.warns(UserWarning, match="damaged, left out: episodes.jsonl, line "):
        results = read(tmp_path)
    assert len(results.episodes) > 0


def test_facts_of_the_warehouse_have_columns_of_their_own() -> None:
    episodes = read(RUN).episodes
    counts = [len(json.loads(steps)) for steps in episodes["world_blocked_moves"]]
    assert episodes["blocked_moves"].tolist() == counts and max(counts) > 0
    assert (episodes["tried_closed"].notna() == (episodes["route"] == "blocked")).all()


def test_the_extra_results_brings_what_reports_are_read_with() -> None:
    project = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    (extra,) = re.findall(r"^results = \[(.*)\]$", project, re.MULTILINE)
    # `pandas.read_parquet` needs pyarrow, for the Parquet files of `memtransfer report`.
    assert "pandas" in extra and "pyarrow" in extra
