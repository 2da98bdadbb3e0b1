"""The folder of a run as pandas data frames.

    from memtransfer.results import read

    results = read("runs/quick-random")
    results.episodes.groupby("memory", observed=True)["success"].mean()

Needs pandas: `pip install 'memtransfer[results]'`. The run's scores with their intervals are in the report that
`memtransfer report` writes; this module gives the episodes that they are computed from.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from memtransfer import _native
from memtransfer._extras import missing
from memtransfer._program import output_of

try:
    import pandas as pd
except ModuleNotFoundError as error:
    raise missing(error, "results") from None

DTYPES: dict[str, str] = {
    "text": "string",
    "word": "category",
    "whole": "Int64",
    "natural": "UInt64",
    "real": "Float64",
    "flag": "boolean",
}
"""The type that a column has in pandas, by the type that `docs/exports.md` names."""


@dataclass(frozen=True)
class Results:
    """A run."""

    folder: Path
    """The run's folder."""
    manifest: dict[str, Any]
    """The run's settings, versions and hashes, and what each process reported about itself."""
    episodes: pd.DataFrame
    """One row per episode, with the columns and types of the table `episodes` that `memtransfer export` writes. An episode without a result has the ending `given-up`, an `error`, and no figures.
    A figure that was not measured is missing (`pd.NA`). What the world told of an episode is in the columns `world_...`, as text or
    JSON; of the warehouse, the number of `blocked_moves` and whether the agent `tried_closed` passages are figures."""
    timings: pd.DataFrame
    """One row per finished episode: nanoseconds spent in each stage, summed over its steps."""
    sessions: list[dict[str, Any]]
    """Starts, restarts and ends of the run's processes, in order."""


def read(folder: str | Path) -> Results:
    """Reads the run in `folder`, finished or not. Warns of each damaged line of its log, which is left out.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: The run cannot be read, for example because another version wrote it.
    """
    manifest, sessions, episodes, timings, damaged = _native.read_run(folder)
    for line in damaged:
        warnings.warn(f"damaged, left out: {line}", stacklevel=2)
    frame = _frame(episodes)
    if "world_blocked_moves" in frame:
        # Facts of the warehouse that have a column of their own.
        moves = frame["world_blocked_moves"].map(lambda steps: len(json.loads(steps)), na_action="ignore")
        frame["blocked_moves"] = moves.astype("Int64")
        frame["tried_closed"] = frame["conflict"]
    return Results(
        folder=Path(folder),
        manifest=json.loads(manifest),
        episodes=frame,
        timings=_frame(timings),
        sessions=json.loads(sessions),
    )


_MAIN_SCORES = ("episodes", "sr", "sr_low", "sr_high", "spl", "spl_low", "spl_high")

_NOT_SCORES = re.compile("log|policy|policy_role|published_.*")


def read_scores(folder: str | Path) -> pd.DataFrame:
    """Computes the scores of the run in `folder`, with the program `memtransfer`. Returns one row for each condition, which is the index:
    the number of `episodes`; `sr`, the success rate in percent, and `spl`, the success weighted by path length from 0 to 1, each with the
    `_low` and `_high` of its 95 % interval over cases; then the other columns of the report's `conditions.csv` that have a value.

    Raises:
        RunError: The folder holds no run that can be read, or there is no program.
    """
    with tempfile.TemporaryDirectory(prefix="memtransfer-report-") as scratch:
        output_of(["report", os.fspath(folder), "--out", os.path.join(scratch, "report")], accepted=(0, 1))
        table = pd.read_csv(os.path.join(scratch, "report", "conditions.csv")).set_index("condition")
    table = table.astype({name: float for name in _MAIN_SCORES[1:]})
    others = [name for name in table if name not in _MAIN_SCORES and not _NOT_SCORES.fullmatch(str(name))]
    scores: pd.DataFrame = table[[*_MAIN_SCORES, *(name for name in others if table[name].notna().any())]]
    return scores


def _frame(columns: list[tuple[str, str, list[Any]]]) -> pd.DataFrame:
    series = {name: pd.Series(values, dtype=DTYPES[kind]) for name, kind, values in columns}
    table: pd.DataFrame = pd.DataFrame(series)
    return table
