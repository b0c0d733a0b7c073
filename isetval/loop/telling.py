"""Telling a person what is being computed, how far it is and, from both, how long it may take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

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

    def counted_as(self, words: str, done: int, total: int) -> None:
        """Progress under words that somebody else said."""
        if self._progress is not None:
            self._progress(words, done, total)

    def counted(self, done: int, total: int) -> None:
        """``done`` of the ``total`` parts of the step."""
        if self._progress is not None:
            self._progress(self.words, done, total)


class TimeUp(Exception):
    """The time that was given is over."""


class Deadline(Teller):
    """A teller that ends what is being done when its time is over: at the next word, or the next part that is done.

    ``open`` is False once nobody is to be stopped any more.
    """

    def __init__(self, limit_s: float, say: Say | None = None, progress: Progress | None = None) -> None:
        inner = say if isinstance(say, Teller) else Teller(say, progress)
        super().__init__(inner, inner.counted_as)
        self.limit_s = limit_s
        self.end_s = self.stage_end_s = monotonic() + limit_s
        self.open = True

    def stage(self, seconds: float | None = None) -> None:
        """What comes now has so many seconds, or all that are left; never more than those."""
        self.stage_end_s = self.end_s if seconds is None else min(monotonic() + seconds, self.end_s)

    @contextmanager
    def to_its_end(self) -> Iterator[None]:
        """What is begun within the block goes on when the time of the stage is over: it is worth more than what it takes."""
        kept, self.stage_end_s = self.stage_end_s, self.end_s
        try:
            yield
        finally:
            self.stage_end_s = kept

    @property
    def is_over(self) -> bool:
        """Whether all of the time is over, and not that of a stage alone."""
        return monotonic() > self.end_s

    def __call__(self, words: str) -> None:
        """A step is about to begin."""
        super().__call__(words)
        self.check()

    def counted(self, done: int, total: int) -> None:
        """``done`` of the ``total`` parts of the step."""
        super().counted(done, total)
        self.check()

    def check(self) -> None:
        """End here where the time of the stage is over.

        Raises
        ------
        TimeUp
        """
        if self.open and monotonic() > self.stage_end_s:
            raise TimeUp
