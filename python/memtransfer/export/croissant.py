"""Tables of poses and actions (CSV) with a Croissant description, which mlcroissant builds."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

from memtransfer.export.common import Selected, library, new, progress, refuse_existing
from memtransfer.trajectories import Trajectory

_TRAJECTORIES = {
    "id": ("text", "The episode's key in the run's log, or demonstration/START/CASE."),
    "kind": ("text", "episode or demonstration."),
    "case": ("text", "The id of the case: type of task and number."),
    "task": ("integer", "The type of task, 1 to 10."),
    "instruction": ("text", "What the agent was told to do."),
    "memory": ("text", "The memory that helped the agent; empty for a demonstration."),
    "start": ("text", "Where it starts: original or new, or which demonstration of the case it is."),
    "route": ("text", "unchanged, or blocked: a passage of the demonstrations is closed. Empty for a demonstration."),
    "closed": ("text", "The closed cells, as column,row separated by spaces."),
    "seed": ("text", "The episode's seed, an unsigned integer of 64 bits; empty for a demonstration."),
    "steps": ("integer", "Number of actions, those that could not be read included."),
    "sub_goals": ("integer", "Number of completed sub-goals."),
    "required": ("integer", "Number of sub-goals of the task."),
    "success": ("bool", "Whether the last action completed the task."),
    "failure": ("text", "The kind of failure; empty for a success."),
}

_STEPS = {
    "trajectory": ("text", "The trajectory."),
    "step": ("integer", "Actions taken before; 0 is the start."),
    "column": ("integer", "Column of the cell, in cells from the west."),
    "row": ("integer", "Row of the cell, in cells from the south."),
    "heading": ("text", "north, east, south or west."),
    "feedback": ("text", "start, moved, turned, blocked or not_understood: the result of the last action."),
    "action": ("text", "The action chosen here, in words; unread if none could be read, and empty at the end."),
}


def write(selected: Selected, folder: Path) -> str:
    """Writes the tables and their description into a new folder. Returns what was written, in words."""
    refuse_existing(folder)
    mlc = library("mlcroissant", "croissant")
    trajectories = steps = 0
    with new(folder) as partial:
        partial.mkdir()
        with (
            (partial / "trajectories.csv").open("w", newline="") as summaries,
            (partial / "steps.csv").open("w", newline="") as moments,
        ):
            summary_table, steps_table = csv.writer(summaries), csv.writer(moments)
            summary_table.writerow(_TRAJECTORIES)
            steps_table.writerow(_STEPS)
            for trajectory in progress("Croissant", selected.trajectories()):
                rows = _rows(trajectory)
                summary_table.writerow(_summary(trajectory))
                steps_table.writerows(rows)
                trajectories += 1
                steps += len(rows)
        description = _describe(mlc, selected, partial).to_json()
        text = json.dumps(description, indent=2, ensure_ascii=False, default=str)
        (partial / "croissant.json").write_text(text + "\n", encoding="utf-8")
    return f"{folder}/croissant.json: {trajectories} trajectories, {steps} rows of steps"


def _summary(trajectory: Trajectory) -> list[Any]:
    record = trajectory.record or {}
    return [
        trajectory.id,
        "episode" if trajectory.record else "demonstration",
        trajectory.case,
        trajectory.task,
        trajectory.instruction,
        record.get("memory"),
        trajectory.start,
        record.get("route"),
        " ".join(f"{column},{row}" for column, row in trajectory.closed),
        record.get("seed"),
        len(trajectory.actions),
        len(trajectory.sub_goals),
        trajectory.required,
        trajectory.success,
        trajectory.failure and trajectory.failure[0],
    ]


def _rows(trajectory: Trajectory) -> list[list[Any]]:
    actions = ["unread" if action is None else action.words for action in trajectory.actions]
    return [
        [trajectory.id, step, column, row, heading.words, feedback.name.lower(), action]
        for step, ((column, row, _), heading, feedback, action) in enumerate(
            zip(trajectory.poses.tolist(), trajectory.headings, trajectory.feedback, [*actions, None])
        )
    ]


def _describe(mlc: Any, selected: Selected, folder: Path) -> Any:
    def table(name: str, columns: dict[str, tuple[str, str]], key: list[str], what: str) -> Any:
        def field(column: str, kind: str, description: str) -> Any:
            more = {}
            if (name, column) == ("steps", "trajectory"):
                more["references"] = mlc.Source(field="trajectories/id")
            return mlc.Field(
                id=f"{name}/{column}",
                name=column,
                description=description,
                data_types=getattr(mlc.DataType, kind.upper()),
                source=mlc.Source(file_object=f"{name}.csv", extract=mlc.Extract(column=column)),
                **more,
            )

        return mlc.RecordSet(
            id=name,
            name=name,
            description=what,
            key=[f"{name}/{column}" for column in key],
            fields=[field(column, *of) for column, of in columns.items()],
        )

    def file(name: str, what: str) -> Any:
        digest = hashlib.sha256()
        with (folder / name).open("rb") as content:
            while part := content.read(1 << 20):
                digest.update(part)
        return mlc.FileObject(
            id=name,
            name=name,
            description=what,
            content_url=name,
            content_size=f"{(folder / name).stat().st_size} B",
            encoding_formats=["text/csv"],
            sha256=digest.hexdigest(),
        )

    manifest = selected.recording.manifest
    settings = manifest["settings"]
    return mlc.Metadata(
        name="memtransfer-trajectories",
        description="Trajectories of agents in the simulated warehouse of MemTransfer, which is a grid of cells: "
        f"policy {selected.recording.policy_label}, seed {settings['seed']}, recorded by version {manifest['version']}.{selected.control}",
        license=["https://spdx.org/licenses/MIT", "https://spdx.org/licenses/Apache-2.0"],
        version=manifest["version"],
        distribution=[file("trajectories.csv", "One row a trajectory."), file("steps.csv", "One row a step.")],
        record_sets=[
            table("trajectories", _TRAJECTORIES, ["id"], "Episodes of a run, and expert demonstrations."),
            table("steps", _STEPS, ["trajectory", "step"], "Where the agent was, and what it did."),
        ],
    )
