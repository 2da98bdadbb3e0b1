"""FAISS: the flat index, which searches exactly."""

import faiss

from _serve import serve
from _vectors import median_seconds, read

state = {}


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


def time(batch, seconds):
    """Measures the time of a batch."""
    index, queries = state["index"], state["queries"]
    return {"seconds": median_seconds(lambda q: index.search(q, 1), queries, batch, seconds)}


serve(load=load, time=time)
