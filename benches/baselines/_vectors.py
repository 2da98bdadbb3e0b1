"""Reads the vectors that our own search is measured with. A program writes them: the memory's, then the queries."""

import subprocess
import time

import numpy


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


def median_seconds(ask, queries, batch, seconds):
    """Returns the median time of `ask` for a batch of queries, measured for `seconds`, at least once."""
    batches = [queries[i : i + batch] for i in range(0, len(queries) - batch + 1, batch)]
    begun = time.perf_counter()
    ask(batches[0])
    first = time.perf_counter() - begun
    times = [first] if first > seconds else []
    end = time.perf_counter() + seconds - first
    while time.perf_counter() < end or not times:
        batch = batches[len(times) % len(batches)]
        begun = time.perf_counter()
        ask(batch)
        times.append(time.perf_counter() - begun)
    return sorted(times)[len(times) // 2]
