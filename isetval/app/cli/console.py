"""Words for people: on stderr beside ``--json``, progress with the time left, no color where none is wanted."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterable
from types import TracebackType

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
            print(self._styled(line, stream.isatty()), file=stream)

    def note(self, text: str) -> None:
        """A line for people beside the result."""
        if not self.quiet:
            self._clear()
            print(text, file=sys.stderr)

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
        sys.stderr.write(question)
        sys.stderr.flush()
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def error(self, text: str) -> None:
        """One sentence on what went wrong; never silenced."""
        self._clear()
        print(f"isetval: {text}", file=sys.stderr)

    def _tick(self) -> None:
        terminal = sys.stderr.isatty()
        while not self._stop.wait(TICK_S if terminal else LOG_S):
            line = self._line()
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

    def _styled(self, line: str, terminal: bool) -> str:
        """Lines that begin with ``# `` are headings: bold on a terminal, plain elsewhere."""
        if not line.startswith("# "):
            return line
        bold = terminal and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
        return f"\x1b[1m{line[2:]}\x1b[0m" if bold else line[2:]


def seconds_words(seconds: float) -> str:
    """A duration as a person says it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
