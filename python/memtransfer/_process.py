"""What a process of a run asks of the system: to end with its orchestrator."""

from __future__ import annotations

import ctypes
import os
import select
import signal

from memtransfer.errors import AttachError

_PR_SET_PDEATHSIG = 1


class Orchestrator:
    """The process that the run belongs to."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        try:
            # Whoever gets this number later, a file descriptor goes on naming the process itself.
            self._file = os.pidfd_open(pid)
        except ProcessLookupError:
            raise AttachError(f"the run's orchestrator, process {pid}, is gone") from None
        except OSError as error:
            raise AttachError(f"cannot watch the run's orchestrator, process {pid}: {error}") from error

    def takes_this_process_along(self) -> None:
        """If it started this process: the system ends this one when it dies, whatever this one does."""
        if os.getppid() != self.pid:
            return
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
            code = ctypes.get_errno()
            raise AttachError(f"cannot tie this process to its orchestrator: {os.strerror(code)}")
        if os.getppid() != self.pid:
            raise AttachError(f"process {self.pid}, which started this one, is gone")

    def lives(self) -> bool:
        """Whether it is still there."""
        readable, _, _ = select.select([self._file], [], [], 0)
        return not readable

    def close(self) -> None:
        """Lets go of it."""
        os.close(self._file)
