"""What a policy is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from memtransfer.request import Answer, Request


class Policy(ABC):
    """Something that decides. Subclass it and hand an instance to `memtransfer.run`."""

    name: str = ""
    """What the run's manifest calls it. Left empty, the name of the class."""

    def facts(self) -> Mapping[str, str]:
        """What else the manifest says about it, such as the model's name: a few short words."""
        return {}

    def reset(self, lane: int) -> None:
        """A new episode begins in `lane`: forget whatever was kept for it."""

    @abstractmethod
    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        """One answer for each request, in the same order. The requests are of different lanes: all that
        wait for an answer at this moment. An answer may not depend on what else is in the batch.

        What requests show is theirs until this returns; copy what is to be kept.
        """
