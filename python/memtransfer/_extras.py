"""What is said where a package that only an extra brings is missing."""

from __future__ import annotations


def missing(error: ModuleNotFoundError, extra: str) -> ModuleNotFoundError:
    """Returns `error` with the command that installs the packages of `extra`."""
    return ModuleNotFoundError(f"{error.msg}: run pip install 'memtransfer[{extra}]'", name=error.name)
