"""The functions that connect a policy or a memory to a run."""

from __future__ import annotations

import copy
import hashlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import TypeAlias, TypeGuard

from memtransfer import _native
from memtransfer.errors import MemTransferError, PolicyError
from memtransfer.memory import Memory
from memtransfer.policy import Policy

Program: TypeAlias = Policy | Memory | type[Memory]
"""What can take part in a run. Of a memory each bank of demonstrations gets a deep copy, of a class an instance."""


def run(program: Program) -> None:
    """Serves the run that the environment variable `MEMTRANSFER_ATTACH` names, until the run ends.

    Returns when the run is over. If the run cannot be joined, exits with status 2 and a message; if a policy
    breaks its contract, with status 1. SIGINT and SIGTERM exit with status 128 plus the signal's number, unless the program
    has handlers of its own. Whatever else the program's methods raise, `SystemExit` as well, costs the episode that they were called for.

    Raises:
        TypeError: `program` is an instance of a memory that cannot be copied: pass the class.
    """
    with terminated():
        try:
            _serve(program, None)
        except PolicyError as error:
            sys.exit(_report(error, 1))
        except MemTransferError as error:
            sys.exit(_report(error, 2))


def serve(program: Program, folder: str | Path) -> None:
    """Serves the run in `folder` until the run ends, across restarts of the run's processes.

    The folder of a memory is the one that `memtransfer run --memory external` prints.

    Raises:
        KeyboardInterrupt: It was interrupted. The run waits until it is called again, and goes on with the same episodes.
        AttachError: The run cannot be joined, or the memory's name is not valid.
        BusError: The run's transport failed.
        PromptLogError: The run asks for a prompt log that cannot be created.
        PolicyError: The policy broke its contract.
        TypeError: `program` is an instance of a memory that cannot be copied: pass the class.
    """
    _serve(program, os.fspath(folder))


def _serve(program: Program, folder: str | None) -> None:
    if isinstance(program, Policy):
        _native.serve(program, code_of(type(program)), folder, False)
    elif is_memory(program):
        kind = program if isinstance(program, type) else type(program)
        _native.serve_memory(maker_of(program), (*described(program), code_of(kind)), folder, False)
    else:
        raise TypeError(f"{program!r} is neither a Policy nor a Memory")


def is_memory(program: object) -> TypeGuard[Memory | type[Memory]]:
    """Returns whether `program` is a memory, or the class of one."""
    return isinstance(program, Memory) or (isinstance(program, type) and issubclass(program, Memory))


def maker_of(memory: Memory | type[Memory]) -> Callable[[], Memory]:
    """Returns what makes the memory of a bank: the class, or deep copies of the instance.

    Raises:
        TypeError: The instance cannot be copied.
    """
    if isinstance(memory, type):
        return memory
    try:
        copy.deepcopy(memory)
    except Exception as error:
        name = type(memory).__name__
        raise TypeError(
            f"{name}(...) cannot be copied, and each bank of demonstrations gets a copy ({type(error).__name__}: {error}): "
            f"pass the class: {name}, not {name}(...)"
        ) from error
    return partial(copy.deepcopy, memory)


def described(memory: Memory | type[Memory]) -> tuple[str, str, str, bool, bool, bool, bool]:
    """Returns what a memory says of itself: name, version, scope, and whether it uses embeddings, looks at frames, is deterministic
    and learns.

    Raises:
        TypeError: An attribute is of the wrong type, or the memory learns and does not override `save` and `load`.
        ValueError: There is no such scope.
    """
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
    return name, memory.version, memory.scope, memory.embeddings, memory.frames, memory.deterministic, memory.learns


def code_of(kind: type) -> str:
    """Returns the files that a policy's or memory's code is in, each with the start of its SHA-256: the file of the main program,
    and those of the modules that define the class and its bases. Modules of the standard library and of this package are left
    out. Empty if there is no file, as in a notebook."""
    names = ["__main__", *(base.__module__ for base in kind.__mro__)]
    hashes: dict[str, str] = {}
    for name in dict.fromkeys(names):
        hashes.update(_hash_of_module(name))
    return _in_words(hashes)


def _hash_of_module(name: str) -> dict[str, str]:
    """The file of a module with the start of its SHA-256; none of the standard library, of this package, and of what has no file."""
    file = getattr(sys.modules.get(name), "__file__", None)
    package = name.partition(".")[0]
    if not file or package in sys.stdlib_module_names or package == __package__ or not Path(file).is_file():
        return {}
    return {os.path.abspath(file): hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]}


def _in_words(hashes: Mapping[str, str]) -> str:
    told = " ".join(f"{os.path.basename(file)}={digest}" for file, digest in hashes.items())
    if len(told.encode()) > 100:
        return f"{len(hashes)} files={hashlib.sha256(told.encode()).hexdigest()[:16]}"
    return told


def code_of_object(program: Program) -> str:
    """Returns what tells changed code of an object that the process serves which has called `evaluate`, as `code_of` does for a program:
    the files of the modules that its class and its bases are defined in and, of what the main program or a notebook defines, the sources
    that the class uses. The rest of a main program is its call of `evaluate`, which may change."""
    kind = program if isinstance(program, type) else type(program)
    files, sources = {}, {}
    for base in kind.__mro__:
        if base.__module__ == "__main__":
            sources.update(_sources_of(base))
        else:
            files.update(_hash_of_module(base.__module__))
    if sources:
        text = "\n".join(sources[name] for name in sorted(sources))
        files[kind.__name__] = hashlib.sha256(text.encode()).hexdigest()[:16]
    return _in_words(files)


def _sources_of(used: type | FunctionType) -> dict[str, str]:
    """The sources of a class or function of the main program, and of those classes, functions and constants there that it names; by name."""
    import inspect

    sources: dict[str, str] = {}
    waiting: list[type | FunctionType] = [used]
    while waiting:
        one = waiting.pop()
        if one.__qualname__ in sources:
            continue
        names: set[str] = set()
        for function in [one] if isinstance(one, FunctionType) else _functions_of(one):
            try:
                sources[function.__qualname__] = inspect.getsource(function)
            except (OSError, TypeError):
                # As in the interactive interpreter, and in a program that is read from standard input.
                sources[function.__qualname__] = _compiled(function.__code__)
            names |= _names_in(function.__code__)
        sources.setdefault(one.__qualname__, "")
        if isinstance(one, type):
            plain = ((name, value) for name, value in vars(one).items() if isinstance(value, str | int | float))
            sources[one.__qualname__] = repr(sorted(item for item in plain if not item[0].startswith("__")))
        main = vars(sys.modules["__main__"])
        for name in sorted(names & main.keys()):
            value = main[name]
            if isinstance(value, type | FunctionType) and value.__module__ == "__main__":
                waiting.append(value)
            elif isinstance(value, str | int | float) and name.isupper():
                sources[name] = repr(value)
    return sources


def _functions_of(kind: type) -> list[FunctionType]:
    members = (getattr(value, "fget", None) or getattr(value, "__func__", value) for value in vars(kind).values())
    return [member for member in members if isinstance(member, FunctionType)]


def _compiled(code: CodeType) -> str:
    """What tells changed code where there is no source. Of one version of Python."""

    def in_words(constant: object) -> str:
        if isinstance(constant, CodeType):
            return _compiled(constant)
        # The order of a set differs from process to process.
        return str(sorted(map(repr, constant))) if isinstance(constant, frozenset) else repr(constant)

    return repr((code.co_code, code.co_names, [in_words(constant) for constant in code.co_consts]))


def _names_in(code: CodeType) -> set[str]:
    """The names that code uses, that of functions within it included."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names_in, inner))


class _Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a service as an interrupt does."""


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise _Terminated


@contextmanager
def terminated() -> Generator[None, None, None]:
    """Exits with status 128 plus the number of a SIGINT or SIGTERM that ends what the context does."""
    in_main = threading.current_thread() is threading.main_thread()
    is_default = in_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if is_default:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except _Terminated:
        sys.exit(128 + signal.SIGTERM)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        if is_default:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _report(error: MemTransferError, status: int) -> int:
    print(f"memtransfer: {error}", file=sys.stderr)
    return status
