"""Reads the files that `memtransfer export` wrote with the programs they are for.

    python read_exports.py RUN EXPORTS

RUN is the run's folder; EXPORTS holds `episodes/` and `all.mcap`, `tables/` and `hub/`.
"""

import io
import json
import pathlib
import subprocess
import sys

import pandas
import yaml
from huggingface_hub import parse_eval_result_entries
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

HEADINGS = {"N": (0.5**0.5, 0.5**0.5), "E": (0, 1), "S": (-(0.5**0.5), 0.5**0.5), "W": (1, 0)}


def read_mcap(path, records):
    """Every message of the file, against the records of its episodes."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        topics = {one.topic: summary.schemas[one.schema_id].name for one in summary.channels.values()}
        assert topics == {
            "/camera": "foxglove.CompressedImage",
            "/tf": "foxglove.FrameTransform",
            "/pose": "foxglove.PoseInFrame",
            "/events": "foxglove.Log",
            "/step": "memtransfer.Step",
            "/episode": "memtransfer.Episode",
        }, topics
        moments = sum(record["steps"] + 1 for record in records.values())
        counts = {topic: [] for topic in topics}
        for _, channel, message in reader.iter_messages():
            counts[channel.topic].append(message.log_time)
        assert all(times == sorted(times) for times in counts.values())
        assert len(counts["/camera"]) == len(counts["/pose"]) == len(counts["/step"]) == moments
        assert summary.statistics.message_count == sum(map(len, counts.values()))
        decoded = reader.iter_decoded_messages(topics=["/camera", "/pose", "/events"])
        messages = [(channel.topic, message.log_time, one) for _, channel, message, one in decoded]
        poses = [one.pose for topic, _, one in messages if topic == "/pose"]
        steps = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=["/step"])]
        for pose, step in zip(poses, steps):
            assert (pose.position.x, pose.position.y) == (step["x"], step["y"])
            z, w = HEADINGS[step["heading"]]
            assert abs(pose.orientation.z - z) < 1e-9 and abs(pose.orientation.w - w) < 1e-9
        images = [one for topic, _, one in messages if topic == "/camera"]
        image = Image.open(io.BytesIO(images[-1].data))
        assert images[-1].format == "jpeg" and image.size == (128, 128), image
        image.load()
        for topic, time, one in messages:
            assert one.timestamp.seconds * 10**9 + one.timestamp.nanos == time
        said = [one.message for topic, _, one in messages if topic == "/events"]
        failures = sum(record["ending"] != "complete" for record in records.values())
        assert sum("failed:" in words for words in said) == failures, said
        episodes = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=["/episode"])]
        assert [one["key"] for one in episodes] == sorted(records)


def read_mcap_in_rerun(path):
    """Rerun converts it, holds the result to be valid, and finds pictures, transforms and events."""
    converted = path.with_suffix(".rrd")
    rerun = [sys.executable, "-m", "rerun"]
    subprocess.run([*rerun, "mcap", "convert", path, "-o", converted], check=True, capture_output=True)
    subprocess.run([*rerun, "rrd", "verify", converted], check=True, capture_output=True)
    shown = subprocess.run([*rerun, "rrd", "print", "-vv", converted], check=True, capture_output=True, text=True)
    for archetype in ["EncodedImage", "Transform3D", "InstancePoses3D", "TextLog"]:
        assert archetype in shown.stdout, f"Rerun shows no {archetype}"


def read_tables(folder, records):
    """CSV and Parquet hold the same, and what the log holds."""
    for name, key in [("episodes", ["key"]), ("steps", ["key", "step"])]:
        parquet = pandas.read_parquet(folder / f"{name}.parquet")
        text = pandas.read_csv(folder / f"{name}.csv")
        assert list(parquet.columns) == list(text.columns)
        assert len(parquet) == len(text) and not parquet.duplicated(key).any()
        for column in ["memory", "case", "run"]:
            assert (parquet[column].astype(str) == text[column].astype(str)).all(), column
    episodes = pandas.read_parquet(folder / "episodes.parquet").set_index("key")
    assert set(episodes.index) == set(records)
    steps = pandas.read_parquet(folder / "steps.parquet")
    for key, of_episode in steps.groupby("key"):
        record = records[key]
        assert list(of_episode.step) == list(range(record["steps"] + 1))
        last = of_episode.iloc[-1]
        assert f"{last.column:.0f},{last.row:.0f},{last.heading[0].upper()}" == record["world"]["final_pose"]
        assert last.is_last and pandas.isna(last.action)
        assert of_episode.action.notna().sum() == sum(letter != "?" for letter in record["actions"])


def read_hub(folder, records):
    """The parser of huggingface_hub reads the results."""
    (file,) = folder.glob("*.yaml")
    entries = parse_eval_result_entries(yaml.safe_load(file.read_text()))
    assert len(entries) == len({key.split("/run")[0] for key in records})
    for entry in entries:
        condition = entry.task_id.removeprefix("rq2_").replace("_", "/")
        outcomes = [r["ending"] == "complete" for key, r in records.items() if key.startswith(condition + "/run")]
        assert outcomes and abs(entry.value - 100 * sum(outcomes) / len(outcomes)) < 0.01, entry
        assert entry.dataset_id == "team/memtransfer" and len(entry.date) == 10


def main(run, exports):
    lines = (run / "episodes.jsonl").read_text().splitlines()
    records = {record["key"]: record for record in map(json.loads, lines)}
    read_mcap(exports / "all.mcap", records)
    files = sorted((exports / "episodes").iterdir())
    assert len(files) == 1
    for path in [files[0], exports / "all.mcap"]:
        read_mcap_in_rerun(path)
    read_tables(exports / "tables", records)
    read_hub(exports / "hub", records)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
