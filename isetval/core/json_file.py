"""Strict reading of JSON from elsewhere: finite numbers, bounded depth, one sentence for everything else."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError

DEEPEST = 60  # levels: a result has 8; what follows them by recursion must not run out of stack
LARGEST_WHOLE = 2**63  # what TOML promises and every other reader holds; counts and sizes are far below
MOST_BYTES = 2_000_000_000  # of a text file: five times the result of 10^5 captures


def read_json(path: Path | str, *, remedy: str = "check the file") -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        If the file cannot be read, is no JSON, is nested too deeply, or holds a number that is not finite.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: has {path.stat().st_size} bytes; at most {MOST_BYTES} are read; {remedy}")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not JSON (its bytes are no text); {remedy}") from None
    return parse_json(text, str(path), remedy=remedy)


def parse_json(text: str, where: str, *, remedy: str = "check the file") -> Any:
    """The content of JSON text; ``where`` is what a refusal calls it.

    Raises
    ------
    InputError
        As `read_json`.
    """

    def constant(word: str) -> float:
        raise InputError(f"{where}: holds the number {word}; JSON has finite numbers only; {remedy}")

    def decimal(digits: str) -> float:
        value = float(digits)
        return value if math.isfinite(value) else constant(digits[:20])

    try:
        content = json.loads(text, parse_constant=constant, parse_float=decimal)
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply to be read; {remedy}") from None
    except ValueError as error:
        raise InputError(f"{where}: is not JSON ({str(error)[:200]}); {remedy}") from None
    check_nest(content, where, remedy=remedy)
    return content


def check_nest(content: Any, where: str, *, remedy: str = "write it flat") -> None:
    """Refuse what is nested deeper than `DEEPEST`, or holds a whole number of more than 63 bits.

    Raises
    ------
    InputError
        With the place.
    """
    level = [("", content)]
    for _ in range(DEEPEST):
        below: list[tuple[str, Any]] = []
        for place, value in level:
            if isinstance(value, dict):
                below += ((f"{place}.{key}", part) for key, part in value.items())
            elif isinstance(value, list):
                below += ((f"{place}[{i}]", part) for i, part in enumerate(value))
            elif isinstance(value, int) and not -LARGEST_WHOLE <= value < LARGEST_WHOLE:
                raise InputError(
                    f"{where}: {place[1:60] or 'its content'} is a number of {value.bit_length()} bits; at most 63 fit"
                )
        if not below:
            return
        level = below
    raise InputError(f"{where}: is nested deeper than {DEEPEST} levels; {remedy}")
