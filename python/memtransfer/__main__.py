"""`python -m memtransfer VERB` is `memtransfer VERB` of the same environment."""

import os
import sys

from memtransfer.errors import MemTransferError
from memtransfer.programs import program

if __name__ == "__main__":
    try:
        path = program()
    except MemTransferError as error:
        sys.exit(f"memtransfer: {error}")
    # The program as a process of its own: it gets signals, and its status is this process's.
    os.execv(path, [str(path), *sys.argv[1:]])
