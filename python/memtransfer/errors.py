"""What can go wrong, in one place."""

from __future__ import annotations


class MemTransferError(Exception):
    """Base of all errors of this package. Its text says what, which value, and what to do."""


class AttachError(MemTransferError):
    """The run cannot be taken part in: it is not there, or speaks another version of the wire."""


class BusError(MemTransferError):
    """The transport of a run failed: a peer is gone, or hangs."""


class PromptLogError(MemTransferError):
    """The prompt log that the run asks for cannot be written."""


class FrameGone(MemTransferError):
    """A frame was looked at after the run let go of it.

    Its memory shows, or will show, another view. Whoever wants to keep pixels copies them while the
    request is being answered: `frame.pixels.copy()`.
    """


class PolicyError(MemTransferError):
    """The policy broke its contract: wrong number of answers, or answers that are none."""
