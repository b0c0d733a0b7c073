"""What a command hands back to the shell around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

FINE, OUTSIDE_LIMITS, USAGE, BAD_INPUT, MISSING_PART, INTERNAL = 0, 1, 2, 3, 4, 70

PAGE_SUFFIXES = (".html", ".htm", ".pdf", ".png")
MEASURED_SUFFIXES = (*PAGE_SUFFIXES, ".xml")
"""Of `isetval measure`, which writes the table of EMVA 1288 as XML too."""


@dataclass(frozen=True)
class Outcome:
    """Result for programs, lines for people, exit code, and the inputs' hashes.

    ``table`` is written instead of the JSON where the output file ends in ``.csv``; ``page`` makes what a suffix of
    `MEASURED_SUFFIXES` asks for, from the suffix and the result.
    """

    result: Mapping[str, Any] = field(default_factory=dict)
    lines: Sequence[str] = ()
    code: int = FINE
    inputs: Mapping[str, str] = field(default_factory=dict)
    table: Sequence[Mapping[str, Any]] = ()
    page: Callable[[str, Mapping[str, Any]], bytes] | None = None
