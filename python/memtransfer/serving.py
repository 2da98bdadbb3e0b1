"""The functions that connect a policy or a memory to a run."""

from __future__ import annotations

import copy
import hashlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TypeAlias

from memtransfer import _native
from memtransfer.errors import MemTransferError, PolicyError
from memtransfer.memory import Memory
from memtransfer.policy import Policy

Program: TypeAlias = Policy | Memory | type[Memory]
"""What can take part in a run. Of a memory each bank of demonstrations gets a deep copy, of a class an instance."""


def run(program: Program) -> None:
    """Serves the run that the environment variable `MEMTRANSFER_ATTACH` names, until the run ends.

    Returns when the run is over. If the run cannot be joined, exits with status 2 and a message; if a policy
    breaks its contract, with status 1. SIGINT and SIGTERM exit with status 128 plus the signal's number; a memory
    ends by the signal itself, unless the program has handlers of its own.
    """
    in_main = threading.current_thread() is threading.main_thread()
    previous = _set_handlers(program) if in_main else {}
    try:
        _serve(program, None)
    except PolicyError as error:
        sys.exit(_report(error, 1))
    except MemTransferError as error:
        sys.exit(_report(error, 2))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def serve(program: Program, folder: str | Path) -> None:
    """Serves the run in `folder` until the run ends, across restarts of the run's processes.

    The folder of a memory is the one that `memtransfer run --memory external` prints.

    Raises:
        AttachError: The run cannot be joined, or the memory's name is not valid.
        BusError: The run's transport failed.
        PromptLogError: The run asks for a prompt log that cannot be created.
        PolicyError: The policy broke its contract.
    """
    _serve(program, os.fspath(folder))


def _serve(program: Program, folder: str | None) -> None:
    if isinstance(program, Policy):
        _native.serve(program, code_of(type(program)), folder)
    elif isinstance(program, Memory):
        _serve_memory(program, partial(copy.deepcopy, program), folder)
    elif isinstance(program, type) and issubclass(program, Memory):
        _serve_memory(program, program, folder)
    else:
        raise TypeError(f"{program!r} is neither a Policy nor a Memory")


def _serve_memory(
    memory: Memory | type[Memory], create: Callable[[], Memory], folder: str | None
) -> None:
    kind = memory if isinstance(memory, type) else type(memory)
    name = memory.name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", kind.__name__).lower()
    if memory.scope not in ("case", "all"):
        raise ValueError(f"scope of memory {name} is {memory.scope!r}, but must be 'case' or 'all'")
    if not isinstance(memory.version, str):
        raise TypeError(f"version of memory {name} is {memory.version!r}, but must be a str")
    for attribute in ("embeddings", "frames", "deterministic", "learns"):
        if not isinstance(getattr(memory, attribute), bool):
            raise TypeError(f"{attribute} of memory {name} is {getattr(memory, attribute)!r}, but must be a bool")
    if memory.learns and (kind.save is Memory.save or kind.load is Memory.load):
        raise TypeError(f"memory {name} learns: it must override save and load, or a resumed run loses what it has learned")
    needs = (memory.embeddings, memory.frames, memory.deterministic, memory.learns)
    _native.serve_memory(create, (name, memory.version, memory.scope, *needs, code_of(kind)), folder)


def code_of(kind: type) -> str:
    """Returns the files that a policy's or memory's code is in, each with the start of its SHA-256: the file of the main program,
    and those of the modules that define the class and its bases. Modules of the standard library and of this package are left
    out. Empty if there is no file, as in a notebook."""
    names = ["__main__", *(base.__module__ for base in kind.__mro__)]
    hashes = {}
    for name in dict.fromkeys(names):
        file = getattr(sys.modules.get(name), "__file__", None)
        package = name.partition(".")[0]
        if file and package not in sys.stdlib_module_names and package != __package__ and Path(file).is_file():
            hashes[os.path.abspath(file)] = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]
    told = " ".join(f"{os.path.basename(file)}={digest}" for file, digest in hashes.items())
    if len(told.encode()) > 100:
        return f"{len(hashes)} files={hashlib.sha256(told.encode()).hexdigest()[:16]}"
    return told


def _set_handlers(program: Program) -> dict[int, signal._HANDLER]:
    if isinstance(program, Policy):
        return {signal.SIGTERM: signal.signal(signal.SIGTERM, _exit_on_signal)}
    # Between two queries no Python code runs, so no Python handler would.
    is_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return {signal.SIGINT: signal.signal(signal.SIGINT, signal.SIG_DFL)} if is_default else {}


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    sys.exit(128 + number)


def _report(error: MemTransferError, status: int) -> int:
    print(f"memtransfer: {error}", file=sys.stderr)
    return status
