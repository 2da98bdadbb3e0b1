#!/usr/bin/env python3
"""What an encoder of lower precision would gain and cost: the default encoder's file with weights and products of 8 bits, and
with numbers of 16 bits, beside the file itself.

    pip install onnx==1.23.2 onnxruntime==1.22.1 onnxconverter-common==1.16.0
    python3 benches/encoder_precision.py --programs target/release

embeds the same views with each, in turns, and executes the episodic conditions of a suite with each. It prints images per
second, and how often memory retrieved the same step, over the steps before which all actions were the same. The runs begin
without embeddings, in a cache folder of their own.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

import onnx
from onnxconverter_common import float16
from onnxruntime.quantization import QuantType, quantize_dynamic
from onnxruntime.quantization.shape_inference import quant_pre_process

ENCODER = "dinov2-s14"
ROOT = Path(__file__).resolve().parent.parent
# Bytes of an embedding in a file that `memory-proc embeddings` writes: the image's hash, and 384 numbers.
EMBEDDING_BYTES = 16 + 4 * 384
POSES = ["1,16,N", "3,13,W", "7,28,N", "10,14,E", "12,25,N", "2,6,S", "6,2,E", "4,15,S"]


def write_models(model, folder):
    """The files of the variants, by name."""
    prepared = folder / "prepared.onnx"
    quant_pre_process(model, prepared, skip_symbolic_shape=True)
    eight, half = folder / "int8.onnx", folder / "fp16.onnx"
    # The runtime has no convolution of integers; the one of this model is a small part of its work.
    quantize_dynamic(
        prepared, eight, op_types_to_quantize=["MatMul", "Gemm"], weight_type=QuantType.QInt8, per_channel=True
    )
    onnx.save(float16.convert_float_to_float16(onnx.load(prepared), keep_io_types=True), half)
    return {"int8": eight, "fp16": half}


def write_assets(folder):
    """Assets that also list an encoder without a fixed file."""
    assets = folder / "assets"
    shutil.copytree(ROOT / "assets", assets)
    manifest = (assets / "models.toml").read_text()
    entry = next(part for part in manifest.split("[[model]]") if f'name = "{ENCODER}"' in part)
    fixed = ("file =", "sha256 =", "brought_by =")
    lines = [line for line in entry.splitlines() if not line.startswith(fixed)]
    entry = "\n".join(lines).replace(f'name = "{ENCODER}"', 'name = "variant"')
    (assets / "models.toml").write_text(f"{manifest}\n[[model]]{entry}\n")
    return assets


def episodes(run):
    records = map(json.loads, (run / "episodes.jsonl").read_text().splitlines())
    return {record["key"]: record for record in records}


def agreement(run, reference):
    """The number of steps with the same actions before them, and the share of them at which the same step was retrieved."""
    run, reference = episodes(run), episodes(reference)
    steps = same = 0
    for key, record in run.items():
        other = reference[key]
        before = os.path.commonprefix([record["actions"], other["actions"]])
        found = zip(record["retrieved"].split(), other["retrieved"].split())
        for here, there in list(found)[: len(before) + 1]:
            steps += 1
            same += here == there
    return steps, same / steps


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", type=Path, default=ROOT / "target/release")
    parser.add_argument("--suite", default="paper")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    cache = Path(os.environ.get("MEMTRANSFER_CACHE") or os.path.expanduser("~/.cache/memtransfer"))
    programs = options.programs.resolve()

    with tempfile.TemporaryDirectory(prefix="precision-") as folder:
        folder = Path(folder)
        own_cache = folder / "cache"
        own_cache.mkdir()
        for part in ["models", "onnxruntime"]:
            (own_cache / part).symlink_to(cache / part)
        environment = {**os.environ, "MEMTRANSFER_CACHE": str(own_cache)}

        def call(program, *arguments):
            command = [programs / program, *map(str, arguments)]
            return subprocess.run(command, check=True, capture_output=True, env=environment).stdout

        variants = write_models(cache / "models" / f"{ENCODER}.onnx", folder)
        assets = write_assets(folder)
        flags = {"fp32": []}
        for name, file in variants.items():
            flags[name] = ["--assets", assets, "--encoder", "variant", "--encoder-file", file]
        views = [folder / f"{number}.png" for number in range(len(POSES))]
        for pose, view in zip(POSES, views):
            call("memtransfer", "render", "--pose", pose, "--out", view)
        rates = {name: [] for name in flags}
        for _ in range(options.rounds):
            for name, chosen in flags.items():
                told = json.loads(call("memory-proc", "embed", *chosen, "--repeat", 20, *views))
                rates[name].append(told["images_per_second"])
        print("| encoder | images/s | ratio | steps compared | same step retrieved | same episodes | success rate |")
        print("|---|---|---|---|---|---|---|")
        for name, chosen in flags.items():
            out = folder / name
            settings = ["--suite", options.suite, "--memory", "episodic", "--policy", "grounded"]
            call("memtransfer", "run", *settings, *chosen, "--out", out, "--quiet")
            steps, same = agreement(out, folder / "fp32")
            records, reference = episodes(out), episodes(folder / "fp32")
            equal = sum(record["actions"] == reference[key]["actions"] for key, record in records.items())
            successes = sum(record["ending"] == "complete" for record in records.values())
            rate = statistics.median(rates[name])
            print(
                f"| {name} | {rate:.1f} | {rate / statistics.median(rates['fp32']):.2f} | {steps:,} | {100 * same:.1f} % | "
                f"{100 * equal / len(records):.1f} % | {100 * successes / len(records):.1f} % |",
                flush=True,
            )
        embeddings = folder / "embeddings"
        call("memory-proc", "embeddings", "--out", embeddings)
        print(f"{embeddings.stat().st_size // EMBEDDING_BYTES:,} views embedded with fp32")


if __name__ == "__main__":
    main()
