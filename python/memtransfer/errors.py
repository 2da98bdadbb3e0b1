"""The exceptions of this package."""

from __future__ import annotations


class MemTransferError(Exception):
    """Base class of all errors of this package."""


class AttachError(MemTransferError):
    """The run cannot be joined: it does not exist, has ended, or uses another wire version."""


class BusError(MemTransferError):
    """The transport of a run failed, for example because another process of the run is gone."""


class PromptLogError(MemTransferError):
    """The prompt log that the run asks for cannot be created."""


class FrameGone(MemTransferError):
    """The run has evicted the frame, so its pixels are no longer available.

    Copy pixels that you want to keep while the request is open: `frame.pixels.copy()`.
    """


class WorldError(MemTransferError):
    """The world broke its contract: its declaration, a case or an observation is not valid."""


class PolicyError(MemTransferError):
    """The policy broke its contract: the wrong number of answers, or a value that is not an answer."""


class RunError(MemTransferError):
    """A run could not begin, could not go on, or could not finish all episodes; or its folder cannot be read.

    The message is the program's own. If an object that was given to `evaluate` raised an exception, it is the cause.
    """

    def __init__(self, message: str, status: int = 2) -> None:
        """`status` is the exit status of the program: 1 if episodes are missing, which the same call runs again; 2 for an error."""
        super().__init__(message)
        self.status = status
