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
