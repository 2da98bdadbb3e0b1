"""Runs as tables: what a run's folder holds, for pandas.

    from memtransfer.results import read

    results = read("runs/2026-01-01")
    results.episodes.groupby("memory")["success"].mean()

Needs pandas (`pip install ./python[results]`) and nothing of the run: neither the harness nor shared memory.
Figures that were not measured are missing (`pd.NA`), never zero. The scores of the benchmark, with their
intervals, are what `memtransfer report` computes; here are the episodes that they are computed from.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

FORMAT = 2
"""Format of the run folders that are read here."""

STAGES = (
    "command",
    "dynamics",
    "render",
    "observation",
    "embed",
    "search",
    "recall",
    "queue",
    "decide",
    "decision",
)
"""The stages of a step, in their order."""

_COLUMNS: dict[str, str] = {
    "key": "string",
    "memory": "category",
    "start": "category",
    "route": "category",
    "demonstrations": "category",
    "window": "Int64",
    "segment": "category",
    "hint": "category",
    "run": "Int64",
    "case": "string",
    "task": "Int64",
    "group": "category",
    "seed": "UInt64",
    "ending": "category",
    "success": "boolean",
    "spl": "Float64",
    "steps": "Int64",
    "reference": "Int64",
    "actions": "string",
    "sub_goals_met": "Int64",
    "required": "Int64",
    "blocked_moves": "Int64",
    "tried_closed": "boolean",
    "start_pose": "string",
    "final_pose": "string",
    "requests": "Int64",
    "images": "Int64",
    "prompt_tokens": "Int64",
    "completion_tokens": "Int64",
    "unreadable": "Int64",
    "empty": "Int64",
    "refused": "Int64",
    "retrieved": "string",
    "distance": "Float64",
    "error": "string",
}

_TIMINGS: dict[str, str] = {
    "key": "string",
    "session": "Int64",
    "attempt": "Int64",
    "lane": "Int64",
    "started_ns": "Int64",
    "ended_ns": "Int64",
    "steps": "Int64",
    **{f"{stage}_ns": "Int64" for stage in STAGES},
}

_GROUPS = {1: "basic", 2: "basic", 7: "return loop", 8: "return loop", 9: "revisit", 10: "return loop"}


@dataclass(frozen=True)
class Results:
    """A run."""

    folder: Path
    """Where it was read from."""
    manifest: dict[str, Any]
    """What the run is: settings, versions, hashes, what each process said about itself."""
    episodes: pd.DataFrame
    """A row for each episode, finished or given up. An episode that was given up has the ending `given-up`,
    its `error`, no success, an SPL of 0, and no other figure."""
    timings: pd.DataFrame
    """A row for each finished episode: nanoseconds in each stage, summed over its steps."""
    sessions: list[dict[str, Any]]
    """What happened to the processes, in order."""


def read(folder: str | Path) -> Results:
    """Reads the run in `folder`. A run that is under way can be read too: it has the episodes so far.

    Raises `FileNotFoundError` when there is no run, and `ValueError` when it cannot be understood.
    """
    folder = Path(folder)
    path = folder / "manifest.json"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is not the folder of a run: it has no manifest.json")
    manifest = json.loads(path.read_text(encoding="utf-8"))
    found = manifest.get("format")
    if found != FORMAT:
        raise ValueError(f"{path}: format {found}, and this package reads {FORMAT}")
    finished = [_finished(record) for record in _journal(folder / "episodes.jsonl")]
    keys = {row["key"] for row in finished}
    # The last word on an episode counts, and one that a later session finished was not given up.
    given_up = {
        error["key"]: _given_up(error)
        for error in _journal(folder / "errors.jsonl")
        if error["key"] not in keys
    }
    timings = [_timing(entry) for entry in _journal(folder / "timings.jsonl")]
    return Results(
        folder=folder,
        manifest=manifest,
        episodes=_table([*finished, *given_up.values()], _COLUMNS),
        timings=_table(timings, _TIMINGS),
        sessions=_journal(folder / "sessions.jsonl"),
    )


def _journal(path: Path) -> list[dict[str, Any]]:
    """The lines of a journal; none if it is missing, and without one that was never finished."""
    if not path.is_file():
        return []
    whole, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
    entries = []
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            entries.append(json.loads(line))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    return entries


def _finished(record: dict[str, Any]) -> dict[str, Any]:
    row = {name: record.get(name) for name in _COLUMNS}
    success = record["ending"] == "complete"
    longest = max(record["steps"], record["reference"])
    weight = record["reference"] / longest if longest else 1.0
    unread = record.get("unread", {})
    row.update(
        # Left out of the log where they are the standard.
        window=record.get("window", 6),
        segment=record.get("segment", "actions"),
        hint=record.get("hint", "on"),
        group=_GROUPS.get(record["task"], "multi-object"),
        success=success,
        spl=weight if success else 0.0,
        sub_goals_met=len(record["sub_goals"]),
        blocked_moves=len(record.get("blocked_moves", [])),
        unreadable=unread.get("unreadable", 0),
        empty=unread.get("empty", 0),
        refused=unread.get("refused", 0),
    )
    return row


def _given_up(error: dict[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(_COLUMNS)
    # memory/start/route/demonstrations, what departs from the standard, run, case
    *condition, run, case = error["key"].split("/")
    row.update(zip(("memory", "start", "route", "demonstrations"), condition))
    row.update(window=6, segment="actions", hint="on")
    for part in condition[4:]:
        if part == "images":
            row["segment"] = "images"
        elif part == "no-hint":
            row["hint"] = "off"
        else:
            row["window"] = int(part.removeprefix("h"))
    row.update(
        key=error["key"],
        run=int(run.removeprefix("run")),
        case=case,
        ending="given-up",
        success=False,
        spl=0.0,
        error=error["error"],
    )
    return row


def _timing(entry: dict[str, Any]) -> dict[str, Any]:
    stages = {f"{stage}_ns": entry["stages"].get(stage) for stage in STAGES}
    return {name: {**entry, **stages}.get(name) for name in _TIMINGS}


def _table(rows: list[dict[str, Any]], columns: dict[str, str]) -> pd.DataFrame:
    series = {
        name: pd.Series([row[name] for row in rows], dtype=kind) for name, kind in columns.items()
    }
    table: pd.DataFrame = pd.DataFrame(series)
    return table
