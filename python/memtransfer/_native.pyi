"""The extension module, written in Rust (`python/src`). Use the package's other modules."""

from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from memtransfer.codes import Action, Outcome
from memtransfer.declaration import WorldDeclaration
from memtransfer.memory import Memory
from memtransfer.policy import Policy
from memtransfer.request import Request
from memtransfer.world import World

__version__: str

class Frame:
    """A view. Its pixels are in shared memory and never change."""

    @property
    def id(self) -> int:
        """Identifies the frame within the run."""

    @property
    def content_hash(self) -> bytes:
        """The first 16 bytes of the BLAKE3 hash of the pixels: the same for equal pixels in every run."""

    @property
    def width(self) -> int:
        """Pixels per row."""

    @property
    def height(self) -> int:
        """Number of rows."""

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """The pixels as a read-only array of shape (height, width, 4): RGBA, rows from top to bottom.

        The array is the shared memory itself. While it exists, the run cannot reuse that memory, of which there is
        little: copy what you keep (`frame.pixels.copy()`).

        Raises:
            FrameGone: The run has evicted the frame. No frame of an open request is evicted.
        """

    @property
    def is_gone(self) -> bool:
        """Whether the run has evicted the frame."""

    @classmethod
    def of(
        cls, pixels: NDArray[np.uint8], id: int = 1, content_hash: bytes | None = None
    ) -> Frame:
        """Returns a frame with a copy of `pixels` (height x width x 4), for tests of a policy.

        Raises:
            TypeError: The pixels are not uint8.
            ValueError: They have another shape, or no pixel.
        """

class Lanes:
    """Episodes in one world, one in each lane. As an array: their views, of shape (lanes, height, width, 3)."""

    def __init__(
        self,
        lanes: int,
        size_px: tuple[int, int],
        appearance: tuple[bool, bool, int],
        anti_aliasing: bool,
        assets: str | PathLike[str] | None,
    ) -> None: ...
    @property
    def __array_interface__(self) -> dict[str, Any]: ...
    @property
    def cases(self) -> list[str]: ...
    @property
    def longest_instruction(self) -> int: ...
    def begin(self, lane: int, case: str, reference: str) -> tuple[str, tuple[int, int, int], int]: ...
    def act(self, lane: int, action: int) -> tuple[tuple[int, int, int], int, bool]: ...
    def draw(self) -> None: ...

class RecordedRun:
    """A run folder, and a renderer of its views."""

    def __init__(self, folder: str | PathLike[str], size_px: tuple[int, int] | None) -> None: ...
    @property
    def notices(self) -> list[str]: ...
    @property
    def size_px(self) -> tuple[int, int]: ...
    def manifest(self) -> str: ...
    @property
    def policy_label(self) -> str: ...
    def episodes(self) -> EpisodeIterator: ...
    def demonstrations(self) -> str: ...
    def floor(self, variant: int) -> list[str]: ...
    def views(self, variant: int, poses: list[list[int]], seen: bool) -> bytes: ...

class EpisodeIterator:
    """The trajectories of a run's episodes as JSON."""

    def __iter__(self) -> EpisodeIterator: ...
    def __next__(self) -> str: ...
    @property
    def damaged(self) -> list[str]: ...

class Step:
    """The step behind a served request."""

    @property
    def images(self) -> int: ...
    def field(self, name: str) -> Any: ...

class MemoryStep:
    """The step behind a query."""

    def field(self, name: str) -> Any: ...

def serve(policy: Policy, code: str, folder: str | PathLike[str] | None, generation: bool) -> None: ...
def serve_memory(
    create: Callable[[], Memory],
    description: tuple[str, str, str, bool, bool, bool, bool, str],
    folder: str | PathLike[str] | None,
    generation: bool,
) -> None: ...
def world_main(
    create: Callable[[], World], declaration: str, tasks: str, arguments: list[str]
) -> None: ...
def warehouse_declaration() -> str: ...
def version() -> str: ...
def template() -> str: ...
def settings() -> str: ...
def render(
    request: Request, image_budget: int
) -> tuple[str, list[tuple[str, str | None, Frame | None]]]: ...
def read_answer(
    text: str, cut_off: bool, world: WorldDeclaration | None
) -> Action | int | Outcome: ...
def png(frame: Frame) -> bytes:
    """Returns a frame as a PNG file, without its alpha channel."""

def image_name(frame: Frame) -> str:
    """Returns the name of a frame's image in logs: `image:` and the hash of its pixels."""

def read_run(
    folder: str | PathLike[str],
) -> tuple[
    str, str, list[tuple[str, str, list[Any]]], list[tuple[str, str, list[Any]]], list[str]
]: ...
