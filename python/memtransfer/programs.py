"""Where the benchmark's programs are."""

from __future__ import annotations

import shutil
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from memtransfer.errors import MemTransferError


def program(name: str = "memtransfer") -> Path:
    """Returns the path of a program: the one that was installed with this package, else the one on the PATH.

    Raises:
        MemTransferError: There is no such program.
    """
    try:
        installed = distribution("memtransfer").files or []
    except PackageNotFoundError:  # a package that is used from a checkout
        installed = []
    # The other file of this name may be the package's folder.
    paths = [Path(file.locate()) for file in installed if file.name == name]
    found = next((path for path in paths if path.is_file()), None) or shutil.which(name)
    if found is None:
        raise MemTransferError(
            f"there is no program `{name}`: install the wheel, which has it, or build it in a checkout and add "
            "the folder target/release to the PATH"
        )
    return Path(found).resolve()
