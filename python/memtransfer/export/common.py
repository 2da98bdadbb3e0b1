"""What the formats share: the selected trajectories, temporary places, and errors."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from memtransfer.trajectories import Recording, Trajectory

STEPS_PER_SECOND = 10
"""Steps have no duration of their own: in videos one takes a tenth of a second."""


class ExportError(Exception):
    """A message for the user."""


@dataclass(frozen=True)
class Selected:
    """The trajectories to export, which are read one at a time."""

    recording: Recording
    episodes: bool
    """Whether episodes are among them."""
    demonstrations: bool
    """Whether demonstrations are."""
    limit: int | None = None
    """The most episodes, and the most demonstrations; `None` for all."""

    def trajectories(self) -> Iterator[Trajectory]:
        """Reads them: the first episodes, then the first demonstrations."""
        if self.episodes:
            yield from islice(self.recording.iter_episodes(), self.limit)
        if self.demonstrations:
            yield from self.recording.demonstrations()[: self.limit]

    def playable(self) -> Iterator[Trajectory]:
        """Reads those in which at least one answer could be read as an action."""
        return (trajectory for trajectory in self.trajectories() if trajectory.decided)

    def about(self) -> str:
        """Returns what the trajectories are, for the description of a data set."""
        return f"Trajectories of a run of MemTransfer, policy {self.recording.policy_label}.{self.control}"

    @property
    def control(self) -> str:
        """The control that the frames of the run are, in words to append; empty if they show what is there."""
        frames = self.recording.manifest["settings"]["frames"]
        return "" if frames == "rendered" else f" A control: frames {frames}."


def left_out(playable: int, unreadable: int) -> str:
    """Says how many episodes are left out because none of their answers could be read as an action, in words to append.

    Raises:
        ExportError: All are.
    """
    if playable == 0:
        raise ExportError("no answer of these episodes could be read as an action: there is nothing to export")
    if unreadable == 0:
        return ""
    episodes = "1 episode is" if unreadable == 1 else f"{unreadable} episodes are"
    return f"\n{episodes} left out: none of the answers could be read as an action"


def library(module: str, extra: str) -> Any:
    """Imports a module of the library that the package's `extra` brings."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ExportError(
            f"cannot import {module} ({error}): run pip install 'memtransfer[{extra}]'"
        ) from error


def refuse_existing(path: Path) -> None:
    """Raises unless nothing is at `path`."""
    if path.exists():
        raise ExportError(f"{path} exists: name another, or remove it")


@contextmanager
def new(path: Path) -> Generator[Path, None, None]:
    """A temporary path beside `path`, which gets its name when the block has ended without an error."""
    refuse_existing(path)
    with parents_of(path):
        partial = path.with_name(path.name + ".partial")
        remove(partial)
        try:
            yield partial
            os.replace(partial, path)
        finally:
            remove(partial)


@contextmanager
def parents_of(path: Path) -> Generator[list[Path], None, None]:
    """Makes the folders above `path`, of which it gives those that were missing. It removes these when the block ends with an error,
    if they are empty."""
    missing = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield missing
    except BaseException:
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()
        raise


def remove(path: Path) -> None:
    """Removes a file or a folder, if there is one."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def progress(what: str, trajectories: Iterable[Trajectory]) -> Iterator[Trajectory]:
    """The trajectories, counted on a terminal."""
    is_seen = sys.stderr.isatty()
    for number, trajectory in enumerate(trajectories, 1):
        if is_seen:
            print(f"\r{what}: trajectory {number}", end="", file=sys.stderr)
        yield trajectory
    if is_seen:
        print(file=sys.stderr)
