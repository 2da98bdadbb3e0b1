"""llama.cpp's own HTTP server, for tests: a real model behind an OpenAI-compatible API.

    python llama_server.py MODEL.gguf NAME CONTEXT PARALLEL PORT [MMPROJ.gguf]

Serves MODEL under NAME on the local port PORT, 0 for a free one, and prints `http://127.0.0.1:PORT/v1` when it is ready.
Exits when its standard input is closed, so that it does not outlive the process that started it. Up to PARALLEL
requests run at once, each with CONTEXT tokens for prompt and answer. With MMPROJ, an encoder of images, MODEL sees them.
"""

import os
import sys
import threading

import xllamacpp


def end_with_parent():
    """Exits the process when the standard input is closed."""
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)


def main(model, name, context, parallel, port, mmproj=None):
    threading.Thread(target=end_with_parent, daemon=True).start()
    params = xllamacpp.CommonParams()
    params.model.path = model
    if mmproj:
        params.mmproj.path = mmproj
    params.model_alias = {name}
    params.n_parallel = int(parallel)
    params.n_ctx = int(context) * int(parallel)
    # One thread, which sleeps when it waits: others compute at the same time, and several threads that
    # wait for each other on busy cores are slower than one.
    for threads in params.cpuparams, params.cpuparams_batch:
        threads.n_threads = 1
        threads.poll = 0
    # No cache of prompts beside the slots' own: it would take gigabytes.
    params.cache_ram_mib = 0
    params.port = int(port)
    server = xllamacpp.Server(params)
    print(f"{server.listening_address}/v1", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    if len(sys.argv) not in (6, 7):
        sys.exit(f"usage: {sys.argv[0]} MODEL.gguf NAME CONTEXT PARALLEL PORT [MMPROJ.gguf]")
    main(*sys.argv[1:])
