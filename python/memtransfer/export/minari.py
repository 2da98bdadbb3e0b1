"""Minari data sets, written by Minari's own functions, with the spaces of our Gymnasium environment."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from memtransfer.export.common import ExportError, Selected, left_out, library, parents_of, progress
from memtransfer.trajectories import Trajectory


@dataclass
class _Contents:
    """What a data set is made of."""

    cases: set[str] = field(default_factory=set)
    starts: set[str] = field(default_factory=set)
    routes: set[str] = field(default_factory=set)
    episodes: int = 0
    steps: int = 0
    unreadable: int = 0
    """Episodes without an answer that could be read."""


def write(selected: Selected, name: str) -> str:
    """Writes the data set `name` into Minari's folder. Returns what was written, in words."""
    minari = library("minari", "minari")
    library("h5py", "minari")
    gymnasium = library("gymnasium", "minari")
    parse_dataset_id = library("minari.dataset.minari_dataset", "minari").parse_dataset_id
    storage = library("minari.storage", "minari")
    namespace_file = library("minari.namespace", "minari").NAMESPACE_METADATA_FILENAME
    try:
        parse_dataset_id(name)
    except (TypeError, ValueError) as error:
        # The version is missing, or the id has another form.
        raise ExportError(
            f"{name!r} is no id of a Minari data set: write one like memtransfer/quick-v0, with a version"
        ) from error
    contents = _contents(selected)
    more = left_out(contents.episodes, contents.unreadable)
    # This makes the folder of all data sets.
    folder = Path(storage.get_dataset_path(name))
    if folder.exists():
        raise ExportError(f"Minari has a data set {name} in {folder}: name another, or remove it")
    recording = selected.recording
    settings = recording.manifest["settings"]
    env = gymnasium.make(
        "memtransfer.gym:MemTransfer-v0",
        case=_one_or_all(contents.cases),
        **{
            option: _one_or_all(values)
            for option, values in (("start", contents.starts), ("route", contents.routes))
            if values
        },
        frame_size=recording.frame_size,
        plates=settings["plates"] == "on",
        labels=settings["labels"] == "on",
        appearance_seed=settings["appearance-seed"],
        max_steps=settings["max-steps"],
        assets=settings.get("assets"),
    )

    def episodes() -> Iterator[Any]:
        for trajectory in progress("Minari", selected.playable()):
            yield minari.data_collector.EpisodeBuffer(**_episode(selected, trajectory))

    with parents_of(folder) as made:
        try:
            dataset = minari.create_dataset_from_buffers(
                name,
                episodes(),
                env=env,
                algorithm_name=recording.policy_label,
                description=f"{selected.about()} Cases: {', '.join(sorted(contents.cases))}.",
                requirements=["memtransfer[gym]"],
            )
            dataset.storage.update_episode_metadata(map(_metadata, selected.playable()))
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            for parent in made:
                (parent / namespace_file).unlink(missing_ok=True)
            raise
    return f"{name} in {folder}: {contents.episodes} episodes, {contents.steps} steps{more}"


def _contents(selected: Selected) -> _Contents:
    contents = _Contents()
    for trajectory in selected.trajectories():
        if not trajectory.decided:
            contents.unreadable += 1
            continue
        contents.episodes += 1
        contents.steps += len(trajectory.decided)
        contents.cases.add(trajectory.case)
        if trajectory.environment is not None:
            start, route = trajectory.environment
            contents.starts.add(start)
            contents.routes.add(route)
    return contents


def _one_or_all(values: set[str]) -> str | list[str]:
    """The value, or all values where there are several."""
    ordered = sorted(values)
    return ordered[0] if len(ordered) == 1 else ordered


def _episode(selected: Selected, trajectory: Trajectory) -> dict[str, Any]:
    """An observation before each action, and one after the last."""
    steps, shown = trajectory.decided, trajectory.observed
    last = np.arange(len(steps)) == len(steps) - 1
    return {
        "observations": {
            "pixels": selected.recording.views(trajectory)[shown],
            "pose": trajectory.poses[shown].astype(np.int32),
            "instruction": [trajectory.instruction] * len(shown),
            "feedback": np.array(trajectory.feedback, np.int64)[shown],
        },
        "actions": np.array([trajectory.actions[step] for step in steps], np.int64),
        "rewards": (last & trajectory.success).astype(np.float64),
        "terminations": last & trajectory.success,
        "truncations": last & (not trajectory.success),
    }


def _metadata(trajectory: Trajectory) -> dict[str, Any]:
    start, route = trajectory.environment or ("", "")
    return {
        "trajectory": trajectory.id,
        "case": trajectory.case,
        "start": start,
        "route": route,
        "is_demonstration": trajectory.record is None,
        "unread": trajectory.unread,
    }
