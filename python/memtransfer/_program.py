"""The program `memtransfer` as a child of this process: found, started so that it ends with this process, shown and interrupted."""

from __future__ import annotations

import codecs
import os
import pty
import queue
import re
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from types import FrameType

from memtransfer.errors import RunError
from memtransfer.programs import program

PROGRAM = "MEMTRANSFER_PROGRAM"
"""The variable that names the program."""

_DIE_WITH_PARENT = (
    "import ctypes, os, sys\n"
    f"ctypes.CDLL(None).prctl(1, {int(signal.SIGTERM)})\n"
    "os.getppid() == int(sys.argv[1]) or sys.exit(1)\n"
    "os.execv(sys.argv[2], sys.argv[2:])"
)
"""Makes the kernel send SIGTERM when the parent ends (`PR_SET_PDEATHSIG`), which stops a run cleanly, and becomes the program."""

_CONTROL = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")

_MESSAGE = re.compile(r"^(memtransfer: |error: |stopped: |\d+ of \d+ episodes could not be finished|no answer of the model )", re.MULTILINE)
"""The begin of the message with which the program ends."""

_ADVICE = re.compile(r"\nA (memory writes|policy attaches) .*\n +memtransfer conformance .*_MEMTRANSFER_RELAY.*")
"""How to examine a command that stands for an object."""

_SAME_COMMAND = re.compile(r"\s+(\S*/)?memtransfer run .*")

_TICK_S = 0.1

_LAST_WORDS_S = 10.0
"""How long to wait for what the program has printed, once it has ended."""


def find_program() -> str:
    """Returns the path of `memtransfer`: what the variable `MEMTRANSFER_PROGRAM` names, else the one that was installed with this package,
    else the one on the `PATH`.

    Raises:
        MemTransferError: There is none.
    """
    named = os.environ.get(PROGRAM)
    if not named:
        return str(program())
    found = shutil.which(named)
    if found is None:
        raise RunError(f"{PROGRAM} is {named}, which is no program")
    return os.path.abspath(found)


def output_of(arguments: Sequence[str], accepted: Sequence[int] = (0,)) -> str:
    """Returns what the program prints.

    Raises:
        RunError: Its exit status is none of those that are accepted.
    """
    command = [find_program(), *arguments]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, env=environment({}))
    if done.returncode not in accepted:
        raise RunError(message_in(done.stderr), done.returncode)
    return done.stdout


def environment(more: Mapping[str, str]) -> dict[str, str]:
    """Returns the variables of a child."""
    # This one is for this package.
    return {**{name: value for name, value in os.environ.items() if name != PROGRAM}, **more}


def dying_with_this_process(command: Sequence[str]) -> list[str]:
    """Returns the command of a child that stops when the thread that starts it ends."""
    return [sys.executable, "-IS", "-c", _DIE_WITH_PARENT, str(os.getpid()), *command]


def message_in(printed: str) -> str:
    """Returns the message in what the program has printed to standard error: its error, or what it says at the end of a run."""
    text = "\n".join(_CONTROL.sub("", line).rstrip() for line in printed.splitlines()).strip()
    begin = list(_MESSAGE.finditer(text))
    if begin:
        text = text[begin[-1].start() :]
    for prefix in ("memtransfer: ", "error: "):
        text = text.removeprefix(prefix)
    return _ADVICE.sub("", text).partition("\n\nUsage: ")[0] or "it ended without a message"


class Style(Enum):
    """How progress is shown."""

    TERMINAL = "terminal"
    """As the program shows it."""
    NOTEBOOK = "notebook"
    """One line, which is replaced."""
    LINES = "lines"
    """A line now and then."""
    NOTES = "notes"
    """Only what the user has to know."""


_INTERVALS_S = {Style.TERMINAL: 0.0, Style.NOTEBOOK: 0.5, Style.LINES: 5.0}
"""The least time between two lines of progress."""


def style_of_screen(progress: bool) -> Style:
    """Returns how progress is shown where this process prints to."""
    if not progress:
        return Style.NOTES
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if any(kind.__name__ == "ZMQInteractiveShell" for kind in type(shell).__mro__):
        return Style.NOTEBOOK
    return Style.TERMINAL if sys.stderr is not None and sys.stderr.isatty() else Style.LINES


class _Screen:
    """Shows what a run prints to its terminal: progress, which replaces itself, and notes, which stay."""

    def __init__(self, style: Style, words: Mapping[str, str]) -> None:
        self.notes: list[str] = []
        self._style = style
        self._words = words
        self._decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        self._line = ""
        self._is_message = False
        self._shown, self._shown_s = "", float("-inf")

    def receive(self, chunk: bytes) -> None:
        """Shows more of what the run prints."""
        *whole, self._line = (self._line + self._decoder.decode(chunk)).split("\n")
        for line in whole:
            self._note(self._last_drawn(line))
        if self._line:
            self._progress(self._last_drawn(self._line))

    def close(self, last: str) -> None:
        """Replaces the progress by a last line."""
        if self._style is not Style.NOTES and last:
            self._show(last)
            self._write("\n")
        elif self._shown:
            self._show("")

    @staticmethod
    def _last_drawn(line: str) -> str:
        return _CONTROL.sub("", line.rstrip("\r").rpartition("\r")[2])

    def _note(self, line: str) -> None:
        if _SAME_COMMAND.fullmatch(line):
            line = "  the same call of `evaluate`"
        for ours, meaning in self._words.items():
            line = line.replace(ours, meaning)
        if not line:
            return
        self.notes.append(line)
        self._is_message = self._is_message or _MESSAGE.match(line) is not None
        # A message is raised.
        if not self._is_message:
            self._show(line)
            self._write("\n")
            self._shown = ""

    def _progress(self, line: str) -> None:
        interval_s = _INTERVALS_S.get(self._style)
        now_s = time.monotonic()
        if interval_s is None or not line or line == self._shown or now_s - self._shown_s < interval_s:
            return
        self._shown_s = now_s
        self._show(line)
        if self._style is Style.LINES:
            self._write("\n")

    def _show(self, line: str) -> None:
        """Replaces the line that is shown, where a line can be."""
        if self._style is Style.TERMINAL:
            self._write(f"\r\x1b[2K{line}")
        elif self._style is Style.NOTEBOOK:
            self._write(f"\r{line:<{len(self._shown)}}")
        else:
            self._write(line)
        self._shown = line

    def _write(self, text: str) -> None:
        # A closed screen does no harm to a run.
        with suppress(OSError, ValueError, AttributeError):
            sys.stderr.write(text)
            sys.stderr.flush()


@dataclass(frozen=True)
class Ended:
    """How the program ended."""

    status: int
    """Its exit status."""
    notes: str
    """What it printed to standard error, without progress."""
    interrupted: bool
    """Whether SIGINT stopped it."""


def attend(
    command: Sequence[str], variables: Mapping[str, str], stop: threading.Event, screen: tuple[Style, Mapping[str, str], str]
) -> Ended:
    """Starts the program, shows its progress, and waits until it ends. It is interrupted once `stop` is set. `screen` says how progress
    is shown, which words of messages are replaced, and the last line if the program succeeds.

    In the main thread, an interrupt is passed on, and the program stops cleanly; a second one ends it at once. In another thread, which
    gets no interrupts, the program is in the process group of this process, and gets those of the terminal by itself.
    """
    style, words, last = screen
    shown = _Screen(style, words)
    in_main = threading.current_thread() is threading.main_thread()
    terminal, end = pty.openpty()
    _copy_size(end)
    children: list[subprocess.Popen[bytes]] = []
    with _interrupts_go_to(lambda: _send_interrupt(children)) as count:
        try:
            child = subprocess.Popen(
                dying_with_this_process(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=end,
                env=environment({**variables, "TERM": "xterm", "NO_COLOR": "1"}),
                start_new_session=in_main,
            )
        except BaseException:
            os.close(terminal)
            raise
        finally:
            os.close(end)
        children.append(child)
        if count():
            _send_interrupt(children)
        chunks: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        reader = threading.Thread(target=_read, args=(terminal, chunks), name="memtransfer progress", daemon=True)
        reader.start()
        try:
            _show(child, chunks, shown, stop)
        finally:
            if child.poll() is None:
                child.terminate()
                child.wait()
        status = child.wait()
        interrupted = bool(count()) or status == 128 + signal.SIGINT
        shown.close(last if status == 0 else "")
        return Ended(status, "\n".join(shown.notes), interrupted)


def _show(
    child: subprocess.Popen[bytes], chunks: queue.SimpleQueue[bytes | None], screen: _Screen, stop: threading.Event
) -> None:
    """Shows what `child` prints until it ends."""
    is_stopped, is_read = False, False
    give_up_s = float("inf")
    # Interrupts are handled between two looks, so no wait is long.
    while not (is_read and child.poll() is not None) and time.monotonic() < give_up_s:
        if stop.is_set() and not is_stopped:
            is_stopped = True
            _send_interrupt([child])
        try:
            chunk = chunks.get(timeout=_TICK_S)
        except queue.Empty:
            if child.poll() is not None and give_up_s == float("inf"):
                # What it has started may have its terminal open still.
                give_up_s = time.monotonic() + _LAST_WORDS_S
            continue
        if chunk is None:
            is_read = True
        else:
            screen.receive(chunk)


def _read(terminal: int, chunks: queue.SimpleQueue[bytes | None]) -> None:
    try:
        while chunk := os.read(terminal, 1 << 16):
            chunks.put(chunk)
    except OSError:
        # The last process that has the other end has ended.
        pass
    finally:
        os.close(terminal)
        chunks.put(None)


def _copy_size(terminal: int) -> None:
    """Gives a terminal the size of this process's."""
    import fcntl
    import termios

    with suppress(OSError, ValueError, AttributeError):
        size = fcntl.ioctl(sys.stderr.fileno(), termios.TIOCGWINSZ, struct.pack("4H", 0, 0, 0, 0))
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, size)


def _send_interrupt(children: Sequence[subprocess.Popen[bytes]]) -> None:
    for child in children:
        child.send_signal(signal.SIGINT)


@contextmanager
def _interrupts_go_to(send: Callable[[], None]) -> Generator[Callable[[], int], None, None]:
    """Calls `send` for each interrupt, in place of the handler that is there: within `asyncio.run`, for example, it would wait for the
    coroutine. Gives a function that counts them. Does nothing in a thread that is not the main one, and where interrupts are ignored."""
    count = 0

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        nonlocal count
        count += 1
        send()

    before = signal.getsignal(signal.SIGINT)
    is_handled = threading.current_thread() is threading.main_thread() and callable(before)
    if is_handled:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield lambda: count
    finally:
        if is_handled:
            signal.signal(signal.SIGINT, before)
