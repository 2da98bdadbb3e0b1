"""FAISS: the flat index and the HNSW graph."""

import faiss
import numpy

from _serve import serve
from _vectors import median_seconds, nearest, read, recall

state = {}


def load(command, entries, dimension, queries, threads, graph=None):
    """Fills an index with what `command` writes; with `graph`, an HNSW graph of that many neighbours."""
    faiss.omp_set_num_threads(threads)
    if graph is None:
        index = faiss.IndexFlatIP(dimension)
        # Reserves room for all entries; otherwise growing the index would need memory for two copies.
        index.codes.resize(4 * dimension * entries)
        index.codes.resize(0)
    else:
        index = faiss.IndexHNSWFlat(dimension, graph["connectivity"], faiss.METRIC_INNER_PRODUCT)
        index.hnsw.efConstruction = graph["building"]
    *blocks, state["queries"] = keep(read(command, entries, dimension, queries), index, graph)
    if graph is not None:
        vectors = numpy.concatenate(blocks)
        index.add(vectors)
        state["truth"] = nearest(vectors, state["queries"], 10)
    state["index"] = index
    return {"entries": index.ntotal, "version": faiss.__version__}


def keep(blocks, index, graph):
    """Adds each block at once where no graph needs all of them, so that memory holds one copy."""
    held = None
    for block in blocks:
        if held is not None:
            if graph is None:
                index.add(held)
            else:
                yield held
        held = block
    yield held


def time(batch, seconds):
    """Measures the time of a batch."""
    index, queries = state["index"], state["queries"]
    return {"seconds": median_seconds(lambda q: index.search(q, 1), queries, batch, seconds)}


def query(searching, batch, seconds):
    """Measures time and recall of a batch with efSearch = `searching`."""
    state["index"].hnsw.efSearch = searching
    _, found = state["index"].search(state["queries"], 10)
    return {"recall_at_10": recall(found, state["truth"]), **time(batch, seconds)}


serve(load=load, time=time, query=query)
