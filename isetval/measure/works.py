"""The measurements of single shots as works that somebody else may do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

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


def may_be_sent(captures: Sequence[Capture]) -> bool:
    """Whether frames are in memory, where some are decoded only when they are looked at, and few enough to go to a worker."""
    return isinstance(captures, tuple) and sum(capture.mosaic.size for capture in captures) <= SENT_PIXELS


def as_it_is(found: T) -> T:
    """A work that was done already."""
    return found
