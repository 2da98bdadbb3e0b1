"""What the formats share: the selected trajectories, temporary places, and errors."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from memtransfer.trajectories import Recording, Trajectory

STEPS_PER_SECOND = 10
"""Steps have no duration of their own: in videos one takes a tenth of a second."""


class ExportError(Exception):
    """A message for the user."""


@dataclass(frozen=True)
class Selected:
    """The trajectories to export."""

    recording: Recording
    trajectories: list[Trajectory]

    def about(self) -> str:
        """Returns what the trajectories are, for the description of a data set."""
        return f"Trajectories of a run of MemTransfer, policy {self.recording.policy_label}.{self.control}"

    @property
    def control(self) -> str:
        """The control that the frames of the run are, in words to append; empty if they show what is there."""
        frames = self.recording.manifest["settings"]["frames"]
        return "" if frames == "rendered" else f" A control: frames {frames}."

    def playable(self) -> list[Trajectory]:
        """Those with at least one action."""
        playable = [trajectory for trajectory in self.trajectories if trajectory.decided]
        if not playable:
            raise ExportError("no answer of these episodes could be read as an action: there is nothing to export")
        return playable


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
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    remove(partial)
    try:
        yield partial
        os.replace(partial, path)
    finally:
        remove(partial)


def remove(path: Path) -> None:
    """Removes a file or a folder, if there is one."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def progress(what: str, trajectories: list[Trajectory]) -> Iterator[Trajectory]:
    """The trajectories, counted on a terminal."""
    is_seen = sys.stderr.isatty()
    for number, trajectory in enumerate(trajectories, 1):
        if is_seen:
            print(f"\r{what}: trajectory {number} of {len(trajectories)}", end="", file=sys.stderr)
        yield trajectory
    if is_seen:
        print(file=sys.stderr)
