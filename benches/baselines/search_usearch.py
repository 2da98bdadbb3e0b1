"""usearch from Python."""

import numpy
import usearch
from usearch.index import Index

from _serve import serve
from _vectors import median_seconds, nearest, read, recall

state = {}


def load(command, entries, dimension, queries, threads, graph):
    """Builds a graph of the vectors that `command` writes."""
    index = Index(
        ndim=dimension,
        metric="ip",
        dtype="bf16",
        connectivity=graph["connectivity"],
        expansion_add=graph["building"],
    )
    *blocks, state["queries"] = read(command, entries, dimension, queries)
    vectors = numpy.concatenate(blocks)
    index.add(numpy.arange(len(vectors)), vectors, threads=threads)
    state["truth"] = nearest(vectors, state["queries"], 10)
    state["index"], state["threads"] = index, threads
    return {"entries": len(index), "version": usearch.__version__}


def query(searching, batch, seconds):
    """Measures time and recall of a batch with expansion_search = `searching`."""
    index, queries = state["index"], state["queries"]
    index.expansion_search = searching
    found = index.search(queries, 10, threads=state["threads"]).keys
    threads = 1 if batch == 1 else state["threads"]
    ask = lambda q: index.search(q if batch > 1 else q[0], 1, threads=threads)
    return {
        "recall_at_10": recall(found, state["truth"]),
        "seconds": median_seconds(ask, queries, batch, seconds),
    }


serve(load=load, query=query)
