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

_CONTROL = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")

_MESSAGE = re.compile(r"^(memtransfer: |error: |stopped: |\d+ of \d+ episodes could not be finished|no answer of the model )", re.MULTILINE)
"""The begin of the message with which the program ends."""

_ADVICE = re.compile(r"\nA (memory writes|policy attaches) .*\n +memtransfer conformance .*_MEMTRANSFER_RELAY.*")
"""How to examine a command that stands for an object."""

_COMMAND = re.compile(r"\s+(\S*/)?memtransfer .*")
_SAME_COMMAND = re.compile(r"\s+(\S*/)?memtransfer run .*")

_LOG = re.compile(r"\d{4}-\d\d-\d\dT\S+ +(?:WARN|ERROR) \S.*")
"""A line of the program's log. It may follow the progress that it does not erase."""

_ENDING = re.compile(r"a process of run \w+ is still alive|the processes could not be asked to end")
"""In log lines about services of objects that end later than the run, which `evaluate` waits for itself."""

_FLAGS = re.compile(r"`(?:run )?--([a-z][a-z-]*)(?: ([^`]+))?`|`[^`]*`|^(  (?=\S*:)|(?:memtransfer: |error: )?--)([a-z][a-z-]*)|(?<![\w-])--([a-z][a-z-]*)")
"""A flag in backticks, with a value or without; other text in backticks, which is left as it is; a flag or a setting at the begin of a
line; a flag elsewhere."""

_TIME_LEFT = re.compile(r", (\d+ (s|min|h) ?)+left")

_LONG_CALL_S = 3.0
"""A call of an object that takes longer is shown."""

_COLUMNS = 200
"""The width of lines of progress where there is no terminal."""

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
    """Returns the command of a child that stops when this process ends: `command` is one of `memtransfer run`, `work` or `view`."""
    return [*command, "--die-with", str(os.getpid())]


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
    return Style.TERMINAL if _is_screen() else Style.LINES


def _is_screen() -> bool:
    """Whether standard error is a terminal that erases lines; one with `TERM=dumb` does not."""
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def _in_python(line: str, keywords: Mapping[str, str]) -> str:
    """Returns a line of the program with the keywords of `evaluate` in place of flags. A command for the shell keeps its own."""
    if _COMMAND.fullmatch(line):
        return line

    def keyword(found: re.Match[str]) -> str:
        quoted, value, begin, first, bare = found.groups()
        name = keywords.get(quoted or first or bare or "")
        if name is None:
            return found[0]
        if first:
            return begin.removesuffix("--") + name
        return f"`{name}={value!r}`" if value else f"`{name}=True`" if name == "fresh" else f"`{name}`"

    return _FLAGS.sub(keyword, line)


class Screen:
    """Shows what a run prints to its terminal: progress, which replaces itself, and notes, which stay."""

    notes: list[str]
    """What the run has printed, without progress and its log."""
    left_behind: bool
    """Whether the run could not remove what it has in shared memory, because an object still used it."""

    def __init__(
        self,
        style: Style,
        words: Mapping[str, str],
        keywords: Mapping[str, str],
        calls: Callable[[float], Sequence[str]] = lambda _: (),
    ) -> None:
        """`words` are replaced in notes; `keywords` are those of `evaluate`, by flag; `calls` names the calls of objects that have
        taken a number of seconds."""
        self.notes = []
        self.left_behind = False
        self._style = style
        self._words = words
        self._keywords = keywords
        self._calls = calls
        self._is_quiet = False
        self._decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        self._line = ""
        self._drawn = ""
        self._is_message = False
        self._shown, self._shown_s = "", float("-inf")

    def receive(self, chunk: bytes) -> None:
        """Shows more of what the run prints."""
        *whole, self._line = (self._line + self._decoder.decode(chunk)).split("\n")
        for line in whole:
            # What is printed beside the display does not erase it.
            self._note(self._last_drawn(line).removeprefix(self._drawn))
            self._drawn = ""
        if self._line:
            self._drawn = self._last_drawn(self._line)
            self._progress(self._drawn)

    def interrupted(self) -> None:
        """Says what an interrupt waits for."""
        calls = " and ".join(self._calls(0.0))
        self._stay(f"stopping{calls and f'; waiting for {calls}'} (interrupt again to end at once)")

    def be_quiet(self) -> None:
        """Shows nothing from now on: what stops the run is raised."""
        self._is_quiet = True

    def close(self, last: str) -> None:
        """Replaces the progress by a last line."""
        if self._style is not Style.NOTES and last:
            self._stay(last)
        elif self._shown and self._style is not Style.LINES:
            self._show("")

    @staticmethod
    def _last_drawn(line: str) -> str:
        return _CONTROL.sub("", line.rstrip("\r").rpartition("\r")[2])

    def _note(self, line: str) -> None:
        if logged := _LOG.search(line):
            if not _ENDING.search(line):
                self._stay(logged[0])
            self.left_behind = self.left_behind or "is still alive" in line
            return
        for ours, meaning in self._words.items():
            line = line.replace(ours, meaning)
        if _SAME_COMMAND.fullmatch(line):
            line = "  the same call of `evaluate`"
        else:
            line = _in_python(line, self._keywords)
        if not line:
            return
        self.notes.append(line)
        self._is_message = self._is_message or _MESSAGE.match(line) is not None
        # A message is raised.
        if not self._is_message:
            self._stay(line)

    def _stay(self, line: str) -> None:
        if not self._is_quiet:
            self._show(line)
            self._write("\n")
            self._shown = ""

    def _progress(self, line: str) -> None:
        interval_s = _INTERVALS_S.get(self._style)
        now_s = time.monotonic()
        if interval_s is None or not line or self._is_quiet or now_s - self._shown_s < interval_s:
            return
        if calls := " and ".join(self._calls(_LONG_CALL_S)):
            line = f"{_TIME_LEFT.sub('', line)}, waiting for {calls}"
            if self._style is Style.TERMINAL:
                # A line that wraps cannot be replaced.
                line = line[: shutil.get_terminal_size().columns - 1]
        if line == self._shown:
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
        # A notebook shows standard error as if it were a failure.
        screen = sys.stdout if self._style is Style.NOTEBOOK else sys.stderr
        # A closed screen does no harm to a run.
        with suppress(OSError, ValueError, AttributeError):
            screen.write(text)
            screen.flush()


@dataclass(frozen=True)
class Ended:
    """How the program ended."""

    status: int
    """Its exit status."""
    notes: str
    """What it printed to standard error, without progress."""
    interrupted: bool
    """Whether SIGINT stopped it."""


def attend(command: Sequence[str], variables: Mapping[str, str], stop: threading.Event, screen: Screen, last: str) -> Ended:
    """Starts the program, shows its progress on `screen`, and waits until it ends. It is interrupted once `stop` is set. `last` is the last
    line that is shown if the program succeeds.

    In the main thread, an interrupt is passed on, and the program stops cleanly; a second one ends it at once. In another thread, which
    gets no interrupts, the program is in the process group of this process, and gets those of the terminal by itself.
    """
    in_main = threading.current_thread() is threading.main_thread()
    terminal, end = _open_terminal()
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
            _show(child, chunks, screen, (stop, count))
        finally:
            if child.poll() is None:
                child.terminate()
                child.wait()
        status = child.wait()
        interrupted = bool(count()) or status == 128 + signal.SIGINT
        screen.close(last if status == 0 else "")
        return Ended(status, "\n".join(screen.notes), interrupted)


def _show(
    child: subprocess.Popen[bytes],
    chunks: queue.SimpleQueue[bytes | None],
    screen: Screen,
    stops: tuple[threading.Event, Callable[[], int]],
) -> None:
    """Shows what `child` prints until it ends. `stops` are what asks to interrupt it, and the number of interrupts so far."""
    stop, interrupts = stops
    is_stopped, is_interrupted, is_read = False, False, False
    give_up_s = float("inf")
    # Interrupts are handled between two looks, so no wait is long.
    while not (is_read and child.poll() is not None) and time.monotonic() < give_up_s:
        if stop.is_set() and not is_stopped:
            is_stopped = True
            screen.be_quiet()
            _send_interrupt([child])
        if interrupts() and not is_interrupted:
            is_interrupted = True
            screen.interrupted()
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


def _open_terminal() -> tuple[int, int]:
    """Opens a terminal for the program, on which it draws its progress, and returns both ends."""
    try:
        terminal, end = pty.openpty()
    except OSError:
        # As in containers and sandboxes without /dev/pts. The program prints its progress as lines then.
        return os.pipe()
    _copy_size(end)
    return terminal, end


def _copy_size(terminal: int) -> None:
    """Gives a terminal the size of this process's. Where that has none, as in a notebook, lines need not be cut to its width."""
    import fcntl
    import termios

    size = struct.pack("4H", 24, _COLUMNS, 0, 0)
    with suppress(OSError, ValueError, AttributeError):
        size = fcntl.ioctl(sys.stderr.fileno(), termios.TIOCGWINSZ, bytes(len(size)))
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
