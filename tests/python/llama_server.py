"""llama.cpp's own HTTP server, for tests: a real model behind an OpenAI-compatible API.

    python llama_server.py MODEL.gguf NAME CONTEXT PARALLEL

Serves MODEL under NAME on a free port of the loopback, prints `http://127.0.0.1:PORT/v1` on one line
once it answers, and ends when its standard input does, which is when whoever started it is gone. At most
PARALLEL requests are worked on at once, each with CONTEXT tokens for its prompt and its answer.
"""

import os
import sys
import threading

import xllamacpp


def end_with_parent():
    """Waits for the end of the standard input, and ends the process whatever it is doing."""
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)


def main(model, name, context, parallel):
    threading.Thread(target=end_with_parent, daemon=True).start()
    params = xllamacpp.CommonParams()
    params.model.path = model
    params.model_alias = {name}
    params.n_parallel = int(parallel)
    params.n_ctx = int(context) * int(parallel)
    # One thread, which sleeps when it waits: others compute at the same time, and several threads that
    # wait for each other on busy cores are slower than one.
    for threads in params.cpuparams, params.cpuparams_batch:
        threads.n_threads = 1
        threads.poll = 0
    # Prompts kept beside the slots' own: none, they would take gigabytes.
    params.cache_ram_mib = 0
    params.port = 0
    server = xllamacpp.Server(params)
    print(f"{server.listening_address}/v1", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(f"usage: {sys.argv[0]} MODEL.gguf NAME CONTEXT PARALLEL")
    main(*sys.argv[1:])
