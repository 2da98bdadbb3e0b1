"""`attach.json` in a run's folder: what a process must know to take part.

The orchestrator writes it once a generation. All sizes of queues and of the frame store follow from it,
so peers that read the same file agree on them without a word.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from memtransfer import _wire
from memtransfer.errors import AttachError

VARIABLE = "MEMTRANSFER_ATTACH"
"""Names the folder of the run to take part in."""

HOW_TO = f"""\
{VARIABLE} is not set, so this policy does not know which run to take part in. Either let the run start it:
  memtransfer run --policy-cmd "python my_policy.py"
or start a run that waits for one, and then the policy with the folder that the run names:
  memtransfer run --policy external
  {VARIABLE}=FOLDER python my_policy.py"""


@dataclass(frozen=True)
class Attach:
    """What `attach.json` says, as far as a policy wants to know."""

    root: Path
    """The run's folder, where the file was read from."""
    prefix: str
    """Starts the name of everything the run has in shared memory."""
    generation: int
    """Grows by one whenever the processes are started anew; part of every service's name."""
    orchestrator_pid: int
    crew: frozenset[str]
    """The processes that take part beside the orchestrator, by name."""
    lanes: int
    """Episodes that run at once."""
    width: int
    height: int
    frame_capacity: int
    """Frames that may be resident at once."""
    spin_us: int
    """Microseconds to look for work before sleeping."""
    prompts: Path | None
    """Folder of this session's prompt log, where one is asked for."""

    @property
    def pages(self) -> int:
        """Whole pages that hold a frame."""
        return -(-self.width * self.height * 4 // _wire.PAGE_BYTES)

    @property
    def spare_chunks(self) -> int:
        """Chunks that may hold evicted frames which a consumer has not let go of yet."""
        return self.frame_chunks - self.frame_capacity - _wire.MAX_LOANED_FRAMES

    @property
    def frame_chunks(self) -> int:
        """Chunks that the frame store owns, each of one frame."""
        return _wire.frame_chunks(self.frame_capacity, self.lanes)

    def count(self, roles: tuple[_wire.Role, ...]) -> int:
        """How many of `roles` take part in the run."""
        orchestrator = _wire.Role.ORCHESTRATOR
        return sum(role is orchestrator or role.words in self.crew for role in roles)


def folder_from_environment() -> Path:
    """The folder that the environment names."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        raise AttachError(HOW_TO)
    return Path(folder)


def read(folder: Path) -> Attach:
    """Reads and checks `attach.json` in the run's folder."""
    path = folder / _wire.ATTACH_FILE
    try:
        root = folder.resolve(strict=True)
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise AttachError(
            f"there is no run in {folder} ({_wire.ATTACH_FILE} is missing): it has ended, or {VARIABLE} names the "
            "wrong folder"
        ) from None
    except (OSError, ValueError) as error:
        raise AttachError(f"{path}: {error}") from error
    if not isinstance(values, dict):
        raise AttachError(f"{path}: not a JSON object")
    theirs = values.get("wire_version")
    # The version comes first: a file of another version may well have other fields.
    if theirs != _wire.WIRE_VERSION:
        raise AttachError(
            f"the run speaks wire version {theirs} and this package {_wire.WIRE_VERSION}: install the "
            "package from the checkout that the program was built from (pip install ./python)"
        )
    return _Checked(path, values).attach(root)


class _Checked:
    """Takes values out of the file, and says which one cannot be."""

    def __init__(self, path: Path, values: dict[str, Any]) -> None:
        self.path = path
        self.values = values

    def attach(self, root: Path) -> Attach:
        prefix = self.values.get("prefix")
        if not isinstance(prefix, str) or not re.fullmatch(r"mt[A-Za-z0-9_]{0,14}", prefix):
            raise self.wrong("prefix", prefix, '"mt" and up to 14 letters, digits or underscores')
        crew = self.values.get("crew")
        known = {role.words for role in _wire.Role}
        if not isinstance(crew, list) or not known.issuperset(crew):
            raise self.wrong("crew", crew, f"names out of {sorted(known)}")
        if "policy" not in crew:
            raise AttachError("the run decides itself (--policy expert) and takes no policy")
        frame, wait = (self.group(name) for name in ("frame", "wait"))
        attach = Attach(
            root=root,
            prefix=prefix,
            generation=self.whole(self.values, "generation", 0, (1 << 32) - 1),
            orchestrator_pid=self.whole(self.values, "orchestrator_pid", 1, (1 << 31) - 1),
            crew=frozenset(crew),
            lanes=self.whole(self.values, "lanes", 1, _wire.MAX_LANES),
            width=self.whole(frame, "width", 64, 4096),
            height=self.whole(frame, "height", 1, 4096),
            frame_capacity=self.whole(self.values, "frame_capacity", 1, _wire.MAX_FRAMES),
            spin_us=self.whole(wait, "spin_us", 0, 1_000_000),
            prompts=self.prompts(),
        )
        if attach.width % 64:
            raise self.wrong("width", attach.width, "a multiple of 64")
        return attach

    def prompts(self) -> Path | None:
        value = self.values.get("prompts")
        if value is None:
            return None
        if not isinstance(value, str) or not os.path.isabs(value):
            raise self.wrong("prompts", value, "an absolute path")
        return Path(value)

    def group(self, name: str) -> dict[str, Any]:
        value = self.values.get(name)
        if not isinstance(value, dict):
            raise self.wrong(name, value, "an object")
        return value

    def whole(self, values: dict[str, Any], name: str, least: int, most: int) -> int:
        value = values.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.wrong(name, value, f"{least} to {most}")
        return value

    def wrong(self, name: str, value: object, expected: str) -> AttachError:
        return AttachError(f"{self.path}: {name} is {value!r}, but must be {expected}")
