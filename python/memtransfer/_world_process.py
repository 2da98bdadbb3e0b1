"""The process of a world that was given to `evaluate` as a class: run as a script by the run, with the arguments of a world's program.

The class comes as a pickle, because a world is asked by several processes, through standard input and output.
"""

import os
import pickle
import sys

PICKLE = "_MEMTRANSFER_WORLD"
"""The file with the pickled search path and world."""


def run() -> None:
    """Does what the arguments say with the world."""
    path = os.environ.get(PICKLE)
    if not path:
        sys.exit("this world is a class of the Python process that called `evaluate`: call it again")
    with open(path, "rb") as file:
        search_path, pickled = pickle.load(file)
    # Modules of the caller, this package among them, are found where the caller finds them; not beside this file.
    sys.path[:] = search_path
    from memtransfer.world import main

    main(pickle.loads(pickled))


if __name__ == "__main__":
    run()
