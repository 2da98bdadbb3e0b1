"""The policy interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from memtransfer.request import Answer, Request


class Policy(ABC):
    """Decides what the agent does. Subclass it and pass an instance to `memtransfer.run`."""

    name: str = ""
    """The policy's name in the run's manifest; the name of the class if empty."""

    def facts(self) -> Mapping[str, str]:
        """Returns further entries for the manifest, such as the model's name. Keep them short."""
        return {}

    def reset(self, lane: int) -> None:
        """Called when a new episode begins in `lane`. Discard any state of the lane's last episode."""

    @abstractmethod
    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        """Returns one answer for each request of `batch`, in the same order.

        The batch holds all open requests, at most one per lane. An answer must not depend on the other
        requests of the batch. Frames may be evicted after this method returns: copy the pixels that you keep.
        """
