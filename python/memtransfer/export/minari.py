"""Minari data sets, written by Minari's own functions, with the spaces of our Gymnasium environment."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from memtransfer.export.common import ExportError, Selected, library, progress
from memtransfer.trajectories import Trajectory


def write(selected: Selected, name: str) -> str:
    """Writes the data set `name` into Minari's folder. Returns what was written, in words."""
    minari = library("minari", "minari")
    library("h5py", "minari")
    gymnasium = library("gymnasium", "minari")
    storage = library("minari.storage", "minari")
    folder = Path(storage.get_dataset_path(name))
    if folder.exists():
        raise ExportError(f"Minari has a data set {name} in {folder}: name another, or remove it")
    recording, trajectories = selected.recording, selected.playable()
    settings = recording.manifest["settings"]
    env = gymnasium.make(
        "memtransfer.gym:MemTransfer-v0",
        frame_size=recording.frame_size,
        plates=settings["plates"] == "on",
        labels=settings["labels"] == "on",
        appearance_seed=settings["appearance-seed"],
        max_steps=settings["max-steps"],
        assets=settings.get("assets"),
    )

    def episodes() -> Iterator[Any]:
        for trajectory in progress("Minari", trajectories):
            yield minari.data_collector.EpisodeBuffer(**_episode(selected, trajectory))

    try:
        dataset = minari.create_dataset_from_buffers(
            name,
            episodes(),
            env=env,
            algorithm_name=recording.policy_label,
            description=f"{selected.about()} Cases: {', '.join(sorted({t.case for t in trajectories}))}.",
            requirements=["memtransfer[gym]"],
        )
        dataset.storage.update_episode_metadata([_metadata(trajectory) for trajectory in trajectories])
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    steps = sum(len(trajectory.decided) for trajectory in trajectories)
    return f"{name} in {folder}: {len(trajectories)} episodes, {steps} steps"


def _episode(selected: Selected, trajectory: Trajectory) -> dict[str, Any]:
    """An observation before each action, and one after the last."""
    steps = trajectory.decided
    shown = [*steps, len(trajectory.actions)]
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
    return {
        "trajectory": trajectory.id,
        "case": trajectory.case,
        "is_demonstration": trajectory.record is None,
        "unread": trajectory.unread,
    }
