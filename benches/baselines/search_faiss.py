"""FAISS: the flat index, which searches exactly.

    {"do": "load", "command": [...], "entries": 1000, "dimension": 384, "queries": 1024, "threads": 2}
                                                 ->    {"version": "..."}
    {"do": "time", "batch": 64, "seconds": 2}    ->    {"seconds": 0.001}

"load" fills the index with the vectors that a program writes: those of the memory, then the queries.
"""

import subprocess
import time

import faiss
import numpy

from _serve import serve

state = {}


def read(command, entries, dimension, queries):
    """Yields the memory's vectors in blocks, then the queries, as arrays with one vector per row."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=1 << 20) as program:
        for count in [*blocks(entries), queries]:
            wanted = count * dimension * 4
            data = program.stdout.read(wanted)
            if len(data) != wanted:
                raise RuntimeError(f"{command[0]} ended early")
            yield numpy.frombuffer(data, dtype=numpy.float32).reshape(count, dimension)


def blocks(entries, size=65536):
    """Returns the sizes of the blocks for this number of entries."""
    return [min(size, entries - first) for first in range(0, entries, size)]


def load(command, entries, dimension, queries, threads):
    """Fills an index with the vectors that `command` writes."""
    faiss.omp_set_num_threads(threads)
    index = faiss.IndexFlatIP(dimension)
    # Reserves room for all entries; otherwise growing the index would need memory for two copies.
    index.codes.resize(4 * dimension * entries)
    index.codes.resize(0)
    for block in read(command, entries, dimension, queries):
        if index.ntotal < entries:
            index.add(block)
        else:
            state["queries"] = block
    state["index"] = index
    return {"version": faiss.__version__}


def median_time(batch, seconds):
    """Returns the median time of a batch of queries, measured for `seconds`, at least once."""
    index, queries = state["index"], state["queries"]
    batches = [queries[i : i + batch] for i in range(0, len(queries) - batch + 1, batch)]
    begun = time.perf_counter()
    index.search(batches[0], 1)
    first = time.perf_counter() - begun
    times = [first] if first > seconds else []
    end = time.perf_counter() + seconds - first
    while time.perf_counter() < end or not times:
        asked = batches[len(times) % len(batches)]
        begun = time.perf_counter()
        index.search(asked, 1)
        times.append(time.perf_counter() - begun)
    return {"seconds": sorted(times)[len(times) // 2]}


serve(load=load, time=median_time)
