"""Opens what `memtransfer.export` wrote of a run with LeRobot's reader, and compares it with the run.

    python open_lerobot.py RUN FOLDER
"""

import sys
from pathlib import Path

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from memtransfer.trajectories import Recording

run, folder = sys.argv[1:]
recording = Recording(run)
trajectories = recording.episodes() + recording.demonstrations()
dataset = LeRobotDataset("memtransfer/test", root=folder, video_backend="pyav")
assert dataset.meta.info["codebase_version"] == "v3.0"
assert recording.policy_label in (Path(folder) / "README.md").read_text()
assert dataset.num_episodes == len(trajectories) == 5
assert len(dataset) == sum(len(trajectory.decided) for trajectory in trajectories)
assert set(dataset.meta.tasks.index) == {trajectory.instruction for trajectory in trajectories}
frames = iter(range(len(dataset)))
for number, trajectory in enumerate(trajectories):
    views = recording.views(trajectory)
    for step, shown in zip(trajectory.decided, trajectory.observed):
        frame = dataset[next(frames)]
        is_last = step == trajectory.decided[-1]
        assert frame["episode_index"] == number and frame["step"] == step
        assert frame["trajectory"] == trajectory.id and frame["task"] == trajectory.instruction
        assert frame["observation.state"].tolist() == trajectory.poses[shown].tolist()
        assert frame["observation.feedback"] == trajectory.feedback[shown]
        assert frame["action"] == trajectory.actions[step]
        assert frame["next.done"] == is_last
        assert frame["next.success"] == (is_last and trajectory.success) == bool(frame["next.reward"])
        picture = frame["observation.images.camera"].permute(1, 2, 0).numpy() * 255
        assert np.abs(picture - views[shown]).mean() < 12, (number, step)
# As training reads it.
batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=4)))
assert batch["observation.images.camera"].shape == (4, 3, 64, 64)
