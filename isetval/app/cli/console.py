"""Words for people: on stderr beside ``--json``, progress with the time left, no color where none is wanted."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterable
from functools import lru_cache
from types import TracebackType
from typing import TextIO

PATIENCE_S = 2.0  # what takes longer is told
TICK_S = 0.25  # a line that is alive, at next to no cost
LOG_S = 30.0  # between lines where stderr is a file: a log of an hour stays a page or two


class Console:
    """Where a command speaks.

    Parameters
    ----------
    json : bool
        Results go to stdout as JSON, so words go to stderr.
    quiet, verbose : bool
        Nothing but errors; every step on a line of its own.
    """

    def __init__(self, *, json: bool = False, quiet: bool = False, verbose: bool = False) -> None:
        self.json, self.quiet, self.verbose = json, quiet, verbose
        self._label, self._since, self._shown = "", 0.0, False
        self._done, self._total = 0, 0
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Console:
        if not self.quiet:
            self._thread = threading.Thread(target=self._tick, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._label = ""
        self._clear()

    def show(self, lines: Iterable[str]) -> None:
        """The result in words."""
        if self.quiet:
            return
        self._clear()
        stream = sys.stderr if self.json else sys.stdout
        for line in lines:
            print(self._styled(line, stream), file=stream)

    def note(self, text: str) -> None:
        """A line for people beside the result."""
        if not self.quiet:
            self._clear()
            print(harmless(text), file=sys.stderr)

    def say(self, text: str) -> None:
        """A step has begun: its name stands on the progress line once it takes longer than two seconds."""
        self._begin(text)
        if self.verbose:
            self.note(text)

    def step(self, text: str) -> None:
        """A step that is always told: part of a story."""
        self.note(text)
        self._begin(text)

    def progress(self, what: str, done: int, total: int) -> None:
        """``done`` of ``total`` steps of one kind."""
        with self._lock:
            if total != self._total or done < self._done:
                self._since = time.monotonic()
            self._label, self._done, self._total = what, done, total

    def _begin(self, text: str) -> None:
        with self._lock:
            self._label, self._since, self._done, self._total = text, time.monotonic(), 0, 0

    def can_ask(self) -> bool:
        """Whether a person can see a question and answer it."""
        return sys.stdin.isatty() and sys.stderr.isatty()

    def ask(self, question: str) -> bool:
        """Whether the person answers yes."""
        self._clear()
        sys.stderr.write(harmless(question))
        sys.stderr.flush()
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def error(self, text: str) -> None:
        """One sentence on what went wrong; never silenced."""
        self._clear()
        print(f"isetval: {harmless(text)}", file=sys.stderr)

    def _tick(self) -> None:
        terminal = understands_escapes(sys.stderr)
        while not self._stop.wait(TICK_S if terminal else LOG_S):
            line = harmless(self._line()).replace("\n", " ")
            if line and terminal:
                width = shutil.get_terminal_size().columns - 1
                sys.stderr.write(f"\r\x1b[K{line[:width]}")
                self._shown = True
            elif line:
                sys.stderr.write(f"{line}\n")
            sys.stderr.flush()

    def _line(self) -> str:
        """What is being done, how far it is and how long it may take; empty while it is quick."""
        with self._lock:
            label, done, total, seconds = self._label, self._done, self._total, time.monotonic() - self._since
        if not label or seconds < PATIENCE_S:
            return ""
        if not total:
            return f"{label} ... {seconds:.0f} s"
        left = f", {seconds_words(seconds * (total - done) / done)} left" if 0 < done < total else ""
        return f"{done} of {total} ({100 * done / total:.0f} %{left}): {label}"

    def _clear(self) -> None:
        if self._shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
            self._shown = False

    def _styled(self, line: str, stream: TextIO) -> str:
        """Lines that begin with ``# `` are headings: bold on a terminal, plain elsewhere."""
        line = harmless(line)
        if not line.startswith("# "):
            return line
        bold = not os.environ.get("NO_COLOR") and understands_escapes(stream)
        return f"\x1b[1m{line[2:]}\x1b[0m" if bold else line[2:]


def harmless(text: str) -> str:
    """Text without what a terminal would act on: control characters, of file names and tags too, are shown as escapes.

    Line breaks and tabs stay; so do letters of every script.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode("ascii") for c in text)


def understands_escapes(stream: TextIO) -> bool:
    """Whether a stream is a terminal that moves and colours by escape sequences; older Windows consoles have to be asked to."""
    if not stream.isatty() or os.environ.get("TERM") == "dumb":
        return False
    return os.name != "nt" or _windows_escapes(stream)


@lru_cache(maxsize=4)
def _windows_escapes(stream: TextIO) -> bool:
    """Switch a Windows console to escape sequences (ENABLE_VIRTUAL_TERMINAL_PROCESSING, Windows 10 and later)."""
    import ctypes

    kernel = getattr(ctypes, "windll", None)
    if kernel is None:
        return False
    handle = kernel.kernel32.GetStdHandle(-12 if stream is sys.stderr else -11)
    mode = ctypes.c_uint32()
    if not kernel.kernel32.GetConsoleMode(handle, ctypes.byref(mode)):
        return False
    return bool(kernel.kernel32.SetConsoleMode(handle, mode.value | 0x0004))


def seconds_words(seconds: float) -> str:
    """A duration as a person says it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
