"""Running the command behind a result again, and comparing every number."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from isetval.app.provenance import versions
from isetval.core.errors import InputError

AGAIN = ("measure", "compare", "identify", "diagnose", "effects", "lens")
"""Commands that make numbers and write nothing but the result that -o names."""
MAX_LISTED = 20
NOT_NUMBERS = ("provenance", "pictures")
Run = Callable[[], tuple[Mapping[str, Any], Mapping[str, str]]]


@dataclass(frozen=True)
class Moved:
    """One entry of a result that is no longer what it was."""

    place: str
    before: Any
    now: Any


@dataclass(frozen=True)
class Rerun:
    """What a second run gave: entries that moved, inputs and versions that changed, entries compared."""

    command: tuple[str, ...]
    moved: tuple[Moved, ...]
    compared: int
    changed_inputs: tuple[str, ...]
    changed_versions: Mapping[str, tuple[str, str]]

    def lines(self) -> list[str]:
        """The outcome in words."""
        out = [f"{' '.join(self.command)}: {self.compared} entries compared, {len(self.moved)} moved"]
        out += [f"  {m.place}: was {m.before}, is {m.now}{_percent(m)}" for m in self.moved[:MAX_LISTED]]
        if len(self.moved) > MAX_LISTED:
            out.append(f"  and {len(self.moved) - MAX_LISTED} more")
        out += [f"  changed input: {path}" for path in self.changed_inputs]
        out += [f"  changed version: {name} {old} -> {new}" for name, (old, new) in self.changed_versions.items()]
        return out


def _percent(moved: Moved) -> str:
    if not all(isinstance(v, int | float) for v in (moved.before, moved.now)) or not moved.before:
        return ""
    return f" ({100 * (moved.now / moved.before - 1):+.3g} %)"


def command_of(result: Mapping[str, Any]) -> list[str]:
    """The words behind ``isetval`` that made a result.

    Raises
    ------
    InputError
        If the result does not say which command made it, or that command makes no numbers.
    """
    made = result.get("provenance")
    if not isinstance(made, Mapping) or not isinstance(made.get("command"), list) or len(made["command"]) < 2:
        raise InputError(
            "the result does not say which command made it (no provenance); only results written with -o can be rerun"
        )
    words = [str(word) for word in made["command"][1:]]
    if words[0] not in AGAIN:
        raise InputError(f"the result was made by 'isetval {words[0]}'; only {', '.join(AGAIN)} can be run again")
    return words


def rerun_result(result: Mapping[str, Any], run: Run, *, rtol: float = 1e-9) -> Rerun:
    """Run the command of ``result`` again and compare.

    Parameters
    ----------
    result : mapping
        As read from a file that ``-o`` wrote.
    run : callable
        Runs the command of `command_of` and gives its result and the SHA-256 of its inputs.
    rtol : float
        Largest relative difference of equal numbers.

    Raises
    ------
    InputError
        As `command_of`, or if the command fails now.
    """
    words = command_of(result)
    try:
        again, inputs = run()
    except InputError as error:
        raise InputError(f"the command failed now: {error}") from None
    old, new = (dict(_leaves({k: v for k, v in r.items() if k not in NOT_NUMBERS})) for r in (result, again))
    places = {**old, **new}
    moved = [Moved(place, old.get(place), new.get(place)) for place in places if not _same(old.get(place), new.get(place), rtol)]
    made = result["provenance"]
    was = made.get("versions", {})
    changed = {name: (str(was[name]), v) for name, v in versions().items() if name in was and was[name] != v}
    return Rerun(("isetval", *words), tuple(moved), len(places), _changed_inputs(made.get("inputs", {}), inputs), changed)


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _leaves(part, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from _leaves(part, f"{place}[{i}]")
    else:
        yield place, value


def _same(a: Any, b: Any, rtol: float) -> bool:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (a, b))
    return math.isclose(a, b, rel_tol=rtol, abs_tol=1e-12) if numbers else bool(a == b)


def _changed_inputs(before: Mapping[str, Any], now: Mapping[str, str]) -> tuple[str, ...]:
    """Inputs of the first run that the second did not find, or found changed; no file is opened for this."""
    gone = [f"{path} (gone)" for path in before if path not in now]
    return (*gone, *(path for path, entry in before.items() if path in now and now[path] != entry["sha256"]))
