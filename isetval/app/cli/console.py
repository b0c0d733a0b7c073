"""Words for people: on stderr beside ``--json``, a progress line on terminals, no color where none is wanted."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterable
from types import TracebackType

PATIENCE_S = 2.0
TICK_S = 0.25


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
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Console:
        if not self.quiet and sys.stderr.isatty():
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
        with self._lock:
            self._label, self._since = text, time.monotonic()
        if self.verbose:
            self.note(text)

    def step(self, text: str) -> None:
        """A step that is always told: part of a story."""
        self.note(text)
        with self._lock:
            self._label, self._since = text, time.monotonic()

    def progress(self, what: str, done: int, total: int) -> None:
        """``done`` of ``total`` steps of one kind."""
        with self._lock:
            if not self._label.startswith("["):
                self._since = time.monotonic()
            self._label = f"[{done}/{total}] {what}"

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
        while not self._stop.wait(TICK_S):
            with self._lock:
                label, seconds = self._label, time.monotonic() - self._since
            if label and seconds > PATIENCE_S:
                width = shutil.get_terminal_size().columns - 12
                sys.stderr.write(f"\r\x1b[K{label[:width]} ... {seconds:.0f} s")
                sys.stderr.flush()
                self._shown = True

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
