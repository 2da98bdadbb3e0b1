"""Reads the files that `memtransfer export` wrote with the programs they are for.

    python read_exports.py RUN EXPORTS

RUN is the run's folder; EXPORTS holds `episodes/` and `all.mcap`, `tables/` and `hub/`.
"""

import io
import json
import pathlib
import re
import subprocess
import sys

import pandas
import pyarrow
import pyarrow.parquet
import yaml
from huggingface_hub import parse_eval_result_entries
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from memtransfer.results import DTYPES, read
from PIL import Image

NULLABLE = {
    pyarrow.int64(): pandas.Int64Dtype(),
    pyarrow.uint64(): pandas.UInt64Dtype(),
    pyarrow.float64(): pandas.Float64Dtype(),
    pyarrow.bool_(): pandas.BooleanDtype(),
}
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


def described_types(table):
    """The type of each column of the table, from docs/exports.md."""
    page = (pathlib.Path(__file__).parents[2] / "docs/exports.md").read_text()
    types = {}
    for heading in ("Both", f"`{table}`"):
        (section,) = re.findall(rf"^### {re.escape(heading)}$(.*?)^##", page, re.MULTILINE | re.DOTALL)
        for names, kind in re.findall(r"^\| (`.*?) \| (\w+) \|", section, re.MULTILINE):
            types.update(dict.fromkeys(re.findall(r"`(\w+)`", names), kind))
    return types


ARROW = {
    "text": pyarrow.string(),
    "word": pyarrow.string(),
    "whole": pyarrow.int64(),
    "natural": pyarrow.uint64(),
    "real": pyarrow.float64(),
    "flag": pyarrow.bool_(),
}


def read_tables(run, folder, records):
    """CSV and Parquet hold the same, with the types of docs/exports.md, and so does `read`; they hold what the log holds."""
    for name, key in [("episodes", ["key"]), ("steps", ["key", "step"])]:
        types = described_types(name)
        file = pyarrow.parquet.ParquetFile(folder / f"{name}.parquet")
        columns = file.schema_arrow.names
        assert {column: file.schema_arrow.field(column).type for column in columns} == {
            column: ARROW[types[column]] for column in columns
        }
        metadata = file.metadata.row_group(0)
        for index in range(metadata.num_columns):
            column = metadata.column(index)
            assert column.compression == "ZSTD" and column.has_dictionary_page == (column.physical_type != "BOOLEAN")
        dtypes = {column: DTYPES[types[column]] for column in columns}
        parquet = file.read().to_pandas(types_mapper=NULLABLE.get).astype(dtypes)
        text = pandas.read_csv(folder / f"{name}.csv", dtype=dtypes, keep_default_na=False, na_values=[""])
        assert len(parquet) and not parquet.duplicated(key).any()
        for column in columns:
            if types[column] in ("text", "word"):
                # An apostrophe keeps a spreadsheet from computing a text.
                literal = text[column].astype("string").str.replace(r"^'(?=\s*[=+\-@])", "", regex=True)
                text[column] = literal.astype(dtypes[column])
        pandas.testing.assert_frame_equal(text, parquet, check_categorical=False)
        if name == "episodes":
            same = read(run).episodes[columns].sort_values("key", ignore_index=True)
            pandas.testing.assert_frame_equal(same, parquet, check_categorical=False)
            assert parquet["seed"].tolist() == [records[key]["seed"] for key in parquet["key"]]
            assert parquet["key"].tolist() == sorted(records)
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
    read_tables(run, exports / "tables", records)
    read_hub(exports / "hub", records)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
