"""Telling a person what is being computed, how far it is and, from both, how long it may take."""

from __future__ import annotations

from collections.abc import Callable

Say = Callable[[str], None]
Counted = Callable[[int, int], None]
Progress = Callable[[str, int, int], None]
"""``progress(what is being done, done, total)``: `isetval.app.cli.console.Console.progress` shows fraction and time left."""


class Teller:
    """Passes words on, and progress under the last words that were said.

    It can be called like the ``say`` that it is made from, and given to whatever takes one: `prepare` and what is built on it
    then tell their progress too.
    """

    def __init__(self, say: Say | None = None, progress: Progress | None = None) -> None:
        self._say, self._progress = say, progress
        self.words = ""

    @classmethod
    def of(cls, say: Say | None, progress: Progress | None = None) -> Teller:
        """``say`` itself where it is one already."""
        return say if isinstance(say, Teller) else cls(say, progress)

    def __call__(self, words: str) -> None:
        """A step has begun."""
        self.words = words
        if self._say is not None:
            self._say(words)

    def counted(self, done: int, total: int) -> None:
        """``done`` of the ``total`` parts of the step."""
        if self._progress is not None:
            self._progress(self.words, done, total)
