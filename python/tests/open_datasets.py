"""Opens what `memtransfer.export` wrote of a run, with the reader of each format, and compares it with the run.

    python open_datasets.py RUN MINARI-ID RRD CROISSANT
"""

import io
import subprocess
import sys

import minari
import mlcroissant
import numpy as np
import rerun.chunk
from PIL import Image

from memtransfer.gym import MemTransferEnv
from memtransfer.trajectories import Recording

run, minari_id, rrd, croissant = sys.argv[1:]
recording = Recording(run)
trajectories = recording.episodes() + recording.demonstrations()
assert len(trajectories) == 5
assert any(trajectory.unread for trajectory in trajectories)


def close(picture, view):
    """Whether a lossy picture shows the view; others differ by 40 and more."""
    return np.abs(np.asarray(picture, float) - view).mean() < 16


# Minari
dataset = minari.load_dataset(minari_id)
env = MemTransferEnv(frame_size=64)
assert dataset.observation_space == env.observation_space
assert dataset.action_space == env.action_space
again = dataset.recover_environment()
assert again.observation_space == env.observation_space
(case,) = {trajectory.case for trajectory in trajectories}
made = again.spec.kwargs
assert (made["case"], made["start"], made["route"]) == (case, ["new", "original"], "unchanged"), made
assert len(dataset) == len(trajectories)
assert dataset.storage.metadata["algorithm_name"] == recording.policy_label
assert recording.policy_label in dataset.storage.metadata["description"]
metadata = list(dataset.storage.get_episode_metadata(range(len(dataset))))
for trajectory, episode, about in zip(trajectories, dataset, metadata):
    steps = trajectory.decided
    views = recording.views(trajectory)
    assert about["trajectory"] == trajectory.id and about["unread"] == trajectory.unread
    assert episode.actions.tolist() == [trajectory.actions[step] for step in steps]
    assert len(episode.rewards) == len(steps) and episode.rewards.sum() == trajectory.success
    assert (bool(episode.terminations[-1]), bool(episode.truncations[-1])) == (
        trajectory.success,
        not trajectory.success,
    )
    for index, step in enumerate(trajectory.observed):
        observation = {name: values[index] for name, values in episode.observations.items()}
        assert observation in env.observation_space
        assert observation["pose"].tolist() == trajectory.poses[step].tolist()
        assert observation["feedback"] == trajectory.feedback[step]
        assert observation["instruction"] == trajectory.instruction
        assert close(observation["pixels"], views[step])
# The environment does what every episode says: a step without a readable answer is none of its transitions.
for episode, about in zip(dataset, metadata):
    options = {name: about[name] for name in ("case", "start", "route")}
    observation, _ = again.reset(options=options)
    for index, action in enumerate([None, *episode.actions]):
        if action is not None:
            observation, reward, *_ = again.step(action)
            assert reward == episode.rewards[index - 1]
        assert observation["instruction"] == episode.observations["instruction"][index]
        assert observation["pose"].tolist() == episode.observations["pose"][index].tolist()
        assert observation["feedback"] == episode.observations["feedback"][index]
        assert close(episode.observations["pixels"][index], observation["pixels"])

# Rerun
verified = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", rrd])
assert verified.returncode == 0
reader = rerun.chunk.RrdReader(rrd)
columns = {}
for chunk in reader.stream():
    assert set(chunk.timeline_names) <= {"step"}
    table = chunk.to_record_batch()
    for name in table.schema.names:
        if "step" in table.schema.names and ":" in name:
            cells = zip(table.column("step").to_pylist(), table.column(name).to_pylist())
            columns.setdefault((chunk.entity_path, name), {}).update(cells)
for trajectory in trajectories:
    entity = "/" + trajectory.id
    views = recording.views(trajectory)
    frames = columns[f"{entity}/camera", "EncodedImage:blob"]
    assert sorted(frames) == list(range(len(views)))
    for step, [blob] in frames.items():
        assert close(Image.open(io.BytesIO(bytes(blob))), views[step])
    for axis, name in enumerate(("column", "row", "heading")):
        logged = columns[f"{entity}/pose/{name}", "Scalars:scalars"]
        assert [value for _, [value] in sorted(logged.items())] == trajectory.poses[:, axis].tolist()
    assert len(columns[f"{entity}/map/path", "LineStrips2D:strips"]) == len(views)
    words = [text for [text] in columns[f"{entity}/events", "TextLog:text"].values()]
    assert words

# The views of the layout, each over something that was logged.
[layout] = reader.blueprints()
tables = [chunk.to_record_batch() for chunk in reader.stream(store=layout)]
origins = [
    origin
    for table in tables
    if "ViewBlueprint:space_origin" in table.schema.names
    for [origin] in table.column("ViewBlueprint:space_origin").to_pylist()
]
views = ["camera", "map", "events", "pose"]
wanted = ["/".join([trajectory.id, view]) for trajectory in trajectories for view in views]
assert sorted(origin.lstrip("/") for origin in origins) == sorted(wanted)

# Croissant
validated = subprocess.run(
    [sys.executable, "-m", "mlcroissant.scripts.cli", "validate", "--jsonld", f"{croissant}/croissant.json"],
    capture_output=True,
    text=True,
)
print(validated.stderr)
assert validated.returncode == 0 and "error" not in validated.stderr.lower()
tables = mlcroissant.Dataset(f"{croissant}/croissant.json")
assert recording.policy_label in tables.metadata.description
summaries = list(tables.records("trajectories"))
assert [row["trajectories/id"].decode() for row in summaries] == [one.id for one in trajectories]
assert [row["trajectories/success"] for row in summaries] == [one.success for one in trajectories]
rows = iter(tables.records("steps"))
for trajectory in trajectories:
    for step, pose in enumerate(trajectory.poses.tolist()):
        row = next(rows)
        assert (row["steps/step"], row["steps/column"], row["steps/row"]) == (step, pose[0], pose[1])
assert next(rows, None) is None
