#!/usr/bin/env bash
# ./serve_vllm.sh FOLDER PORT [OPTION...]: serves the model in FOLDER under the name `tiny` with vLLM, on the CPU and without
# a network.
set -euo pipefail
model=$(realpath "$1") port=$2
shift 2
export HF_HUB_OFFLINE=1 VLLM_NO_USAGE_STATS=1 DO_NOT_TRACK=1
# One thread, bound to no core; 1 GiB for keys and values.
export OMP_NUM_THREADS=1 VLLM_CPU_OMP_THREADS_BIND=nobind VLLM_CPU_NUM_OF_RESERVED_CPU=0 VLLM_CPU_KVCACHE_SPACE=1
exec vllm serve "$model" --served-model-name tiny --host 127.0.0.1 --port "$port" --dtype float32 --enforce-eager \
    --max-model-len 16384 --limit-mm-per-prompt '{"image": 50}' --enable-prompt-tokens-details "$@"
