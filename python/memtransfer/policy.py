"""The policy interface, and the functions that connect a policy to a run."""

from __future__ import annotations

import os
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType

from memtransfer import _native
from memtransfer.errors import MemTransferError, PolicyError
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


def run(policy: Policy) -> None:
    """Serves the run that the environment variable `MEMTRANSFER_ATTACH` names, until the run ends.

    Returns when the run is over. If the run cannot be joined, exits with status 2 and a message; if the policy
    breaks its contract, with status 1. SIGINT and SIGTERM exit with status 128 plus the signal's number.
    """
    in_main = threading.current_thread() is threading.main_thread()
    previous = signal.signal(signal.SIGTERM, _exit_on_signal) if in_main else None
    try:
        _native.serve(policy, None)
    except PolicyError as error:
        sys.exit(_report(error, 1))
    except MemTransferError as error:
        sys.exit(_report(error, 2))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, previous)


def serve(policy: Policy, folder: str | Path) -> None:
    """Serves the run in `folder` until the run ends, across restarts of the run's processes.

    Raises:
        AttachError: The run cannot be joined.
        BusError: The run's transport failed.
        PromptLogError: The run asks for a prompt log that cannot be created.
        PolicyError: The policy broke its contract.
    """
    _native.serve(policy, os.fspath(folder))


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    sys.exit(128 + number)


def _report(error: MemTransferError, status: int) -> int:
    print(f"memtransfer: {error}", file=sys.stderr)
    return status
