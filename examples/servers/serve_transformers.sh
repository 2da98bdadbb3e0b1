#!/usr/bin/env bash
# ./serve_transformers.sh FOLDER PORT: serves the model in FOLDER with transformers, on the CPU and without a network. Its
# name for clients is FOLDER's absolute path.
set -euo pipefail
model=$(realpath "$1")
mkdir -p "$model/hub"
export HF_HUB_OFFLINE=1 HF_HUB_CACHE="$model/hub" OMP_NUM_THREADS=1
exec transformers serve "$model" --device cpu --host 127.0.0.1 --port "$2"
