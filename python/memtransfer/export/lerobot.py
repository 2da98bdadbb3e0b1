"""LeRobot data sets, written by LeRobot's own class."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from memtransfer.export.common import (
    STEPS_PER_SECOND,
    Selected,
    left_out,
    library,
    new,
    progress,
    refuse_existing,
)


def features(width: int, height: int) -> dict[str, dict[str, object]]:
    """The features of a frame, beside those that LeRobot adds."""

    def number(dtype: str, names: list[str]) -> dict[str, object]:
        return {"dtype": dtype, "shape": (len(names),), "names": names}

    return {
        "observation.images.camera": {
            "dtype": "video",
            "shape": (height, width, 3),
            "names": ["height", "width", "channels"],
        },
        "observation.state": number("float32", ["column", "row", "heading"]),
        "observation.feedback": number("int64", ["feedback"]),
        "action": number("int64", ["action"]),
        "next.reward": number("float32", ["reward"]),
        "next.done": number("bool", ["done"]),
        "next.success": number("bool", ["success"]),
        "step": number("int64", ["step"]),
        "trajectory": number("string", ["id"]),
    }


def write(selected: Selected, folder: Path) -> str:
    """Writes the data set into a new folder. Returns what was written, in words."""
    refuse_existing(folder)
    # Its encoder, its muxer and its tables each report every episode.
    os.environ.setdefault("SVT_LOG", "1")
    av = library("av", "lerobot")
    av.logging.set_libav_level(av.logging.ERROR)
    library("datasets", "lerobot").disable_progress_bars()
    lerobot = library("lerobot.datasets.lerobot_dataset", "lerobot")
    recording = selected.recording
    frames_shown = recording.manifest["settings"]["frames"]
    episodes = unreadable = frames = 0
    with new(folder) as partial:
        dataset = lerobot.LeRobotDataset.create(
            repo_id=f"memtransfer/{folder.name}",
            root=partial,
            fps=STEPS_PER_SECOND,
            features=features(*recording.frame_size),
            robot_type="memtransfer" + (f", frames {frames_shown}" if selected.control else ""),
        )
        for trajectory in progress("LeRobot", selected.trajectories()):
            if not trajectory.decided:
                unreadable += 1
                continue
            episodes += 1
            views = recording.views(trajectory)
            last = trajectory.decided[-1]
            for step, shown in zip(trajectory.decided, trajectory.observed):
                is_success = trajectory.success and step == last
                dataset.add_frame(
                    {
                        "observation.images.camera": views[shown],
                        "observation.state": trajectory.poses[shown].astype(np.float32),
                        "observation.feedback": np.array([trajectory.feedback[shown]], np.int64),
                        "action": np.array([trajectory.actions[step]], np.int64),
                        "next.reward": np.array([is_success], np.float32),
                        "next.done": np.array([step == last]),
                        "next.success": np.array([is_success]),
                        "step": np.array([step], np.int64),
                        "trajectory": trajectory.id,
                        "task": trajectory.instruction,
                    }
                )
                frames += 1
            dataset.save_episode()
        more = left_out(episodes, unreadable)
        dataset.finalize()
        # The format itself has no place for a description.
        (partial / "README.md").write_text(selected.about() + "\n", encoding="utf-8")
    return f"{folder}: {episodes} episodes, {frames} frames{more}"
