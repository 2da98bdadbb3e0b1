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
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import FrameType

from memtransfer.errors import RunError

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
_TICK_S = 0.1
_LINE_INTERVAL_S = 5.0
_REDRAW_INTERVAL_S = 0.5


def find_program() -> str:
    """Returns the path of `memtransfer`: what the variable `MEMTRANSFER_PROGRAM` names, or the one that came with this package, or the
    one on the `PATH`.

    Raises:
        RunError: There is none.
    """
    named = os.environ.get(PROGRAM)
    if named:
        found = shutil.which(named)
        if found is None:
            raise RunError(f"{PROGRAM} is {named}, which is no program")
        return os.path.abspath(found)
    folders = [str(Path(__file__).with_name("bin")), sysconfig.get_path("scripts"), os.environ.get("PATH", os.defpath)]
    found = shutil.which("memtransfer", path=os.pathsep.join(folders))
    if found is None:
        raise RunError(
            f"there is no program `memtransfer` beside this package or on the PATH: build it with `cargo build --release`, and name it in "
            f"{PROGRAM}=target/release/memtransfer"
        )
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
    """Returns the message in what a run has printed to standard error, without commands of the shell."""
    lines = [_CONTROL.sub("", line).rstrip() for line in printed.splitlines()]
    kept = [line for line in lines if not re.match(r"\s+(\S*/)?memtransfer .*", line)]
    text = "\n".join(kept).strip()
    for prefix in ("memtransfer: ", "error: "):
        before, found, after = text.rpartition(f"\n{prefix}")
        if found or text.startswith(prefix):
            text = after if found else text.removeprefix(prefix)
            break
    usage = text.find("\n\nUsage: ")
    return (text if usage < 0 else text[:usage]) or "it ended without a message"


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

    def __init__(self, style: Style) -> None:
        self.notes: list[str] = []
        self._style = style
        self._decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        self._line = ""
        self._shown, self._shown_s = "", float("-inf")

    def receive(self, chunk: bytes) -> None:
        text = self._decoder.decode(chunk)
        if self._style is Style.TERMINAL:
            self._write(text)
        *whole, self._line = (self._line + text).split("\n")
        for line in whole:
            self._note(self._last_drawn(line))
        if self._line:
            self._progress(self._last_drawn(self._line))

    def close(self, last: str) -> None:
        """Replaces the line of a notebook by a last one."""
        if self._style is Style.NOTEBOOK:
            self._replace(last)
            self._write("\n")

    @staticmethod
    def _last_drawn(line: str) -> str:
        return _CONTROL.sub("", line.rstrip("\r").rpartition("\r")[2])

    def _note(self, line: str) -> None:
        if not line:
            return
        self.notes.append(line)
        if self._style is Style.NOTEBOOK:
            self._replace(line)
            self._shown = ""
        if self._style is not Style.TERMINAL:
            self._write("\n" if self._style is Style.NOTEBOOK else f"{line}\n")

    def _progress(self, line: str) -> None:
        interval_s = {Style.NOTEBOOK: _REDRAW_INTERVAL_S, Style.LINES: _LINE_INTERVAL_S}.get(self._style)
        now_s = time.monotonic()
        if interval_s is None or line == self._shown or now_s - self._shown_s < interval_s:
            return
        self._shown_s = now_s
        if self._style is Style.NOTEBOOK:
            self._replace(line)
        else:
            self._write(f"{line}\n")
        self._shown = line

    def _replace(self, line: str) -> None:
        self._write(f"\r{line:<{len(self._shown)}}")
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


def attend(command: Sequence[str], variables: Mapping[str, str], style: Style, last: str) -> Ended:
    """Starts the program, shows its progress, and waits until it ends. `last` is the last line of a successful one in a notebook.

    In the main thread, an interrupt is passed on, and the program stops cleanly; a second one ends it at once. In another thread, which
    gets no interrupts, the program is in the process group of this process, and gets those of the terminal by itself.
    """
    screen = _Screen(style)
    in_main = threading.current_thread() is threading.main_thread()
    terminal, end = pty.openpty()
    _copy_size(end)
    dumb = {} if style is Style.TERMINAL else {"TERM": "xterm", "NO_COLOR": "1"}
    children: list[subprocess.Popen[bytes]] = []
    with _interrupts_go_to(lambda: _send_interrupt(children)) as count:
        try:
            child = subprocess.Popen(
                dying_with_this_process(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=end,
                env=environment({**variables, **dumb}),
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
            _show(child, chunks, screen)
        finally:
            if child.poll() is None:
                child.terminate()
                child.wait()
        status = child.wait()
        interrupted = bool(count()) or status == 128 + signal.SIGINT
        screen.close(last if status == 0 else f"stopped with status {status}")
        return Ended(status, "\n".join(screen.notes), interrupted and status != 0)


def _show(child: subprocess.Popen[bytes], chunks: queue.SimpleQueue[bytes | None], screen: _Screen) -> None:
    while True:
        try:
            chunk = chunks.get(timeout=_TICK_S)
        except queue.Empty:
            if child.poll() is not None:
                return
            continue
        if chunk is None:
            # Until it has ended, too: interrupts are handled between two looks.
            while child.poll() is None:
                time.sleep(_TICK_S)
            return
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
def _interrupts_go_to(send: Callable[[], None]) -> Iterator[Callable[[], int]]:
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
