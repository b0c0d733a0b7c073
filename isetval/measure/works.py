"""The measurements of single shots as works that somebody else may do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from isetval.core.campaign import Shot
from isetval.core.capture import Capture

T = TypeVar("T")
Work = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and its arguments."""
InTurn = Callable[[Iterable[Work]], Iterator[Any]]
"""Does works, taken one by one as there is room, and gives what they gave in their order."""
SENT_PIXELS = 10_000_000  # 20 MB of frames of a shot: a few such may wait for a worker


def done_here(works: Iterable[Work]) -> Iterator[Any]:
    """Does works one after the other; nothing of one is held while the next is taken."""
    for function, arguments in works:
        found = function(*arguments)
        del function, arguments
        yield found
        del found


def sent_or_done(measure: Callable[..., Any], shot: Shot, captures: Sequence[Capture], *more: Any) -> Work:
    """``measure(shot, captures, *more)`` as a work; done already where frames are many, or decoded as they are looked at."""
    few = isinstance(captures, tuple) and sum(capture.mosaic.size for capture in captures) <= SENT_PIXELS
    return (measure, (shot, captures, *more)) if few else done(measure(shot, captures, *more))


def done(found: Any) -> Work:
    """A work that is done: what it gave."""
    return _as_it_is, (found,)


def _as_it_is(found: T) -> T:
    return found
