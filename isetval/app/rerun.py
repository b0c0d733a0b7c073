"""Running the command behind a result again, and comparing every number."""

from __future__ import annotations

import contextlib
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isetval.app.provenance import versions
from isetval.core.errors import InputError
from isetval.core.hashing import file_hash

AGAIN = ("measure", "compare", "identify", "diagnose", "effects", "lens")
MAX_LISTED = 20
Run = Callable[[list[str]], int]


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


def rerun_result(result: Mapping[str, Any], run: Run, *, rtol: float = 1e-9) -> Rerun:
    """Run the command of ``result`` again with ``run``, the command line's main function.

    Raises
    ------
    InputError
        If the result does not say which command made it, that command makes no numbers, or it fails now.
    """
    made = result.get("provenance")
    if not isinstance(made, Mapping) or not isinstance(made.get("command"), list) or len(made["command"]) < 2:
        raise InputError(
            "the result does not say which command made it (no provenance); only results written with -o can be rerun"
        )
    command = [str(word) for word in made["command"]]
    if command[1] not in AGAIN:
        raise InputError(f"the result was made by 'isetval {command[1]}'; only {', '.join(AGAIN)} can be run again")
    again = _run(run, _without_output(command[1:]))
    before, now = (_leaves({k: v for k, v in r.items() if k != "provenance"}) for r in (result, again))
    old, new = dict(before), dict(now)
    moved = [
        Moved(place, old.get(place), new.get(place))
        for place in {**old, **new}
        if not _same(old.get(place), new.get(place), rtol)
    ]
    was = made.get("versions", {})
    changed = {name: (str(was[name]), v) for name, v in versions().items() if name in was and was[name] != v}
    return Rerun(tuple(command), tuple(moved), len({**old, **new}), _changed_inputs(made.get("inputs", {})), changed)


def _without_output(words: list[str]) -> list[str]:
    """The command with ``--json`` and without ``-o``."""
    out, skip = [], False
    for word in words:
        if skip:
            skip = False
        elif word in ("-o", "--output"):
            skip = True
        elif word not in ("--json", "-q", "--quiet", "-v", "--verbose") and not word.startswith("--output="):
            out.append(word)
    return [*out, "--json", "--quiet"]


def _run(run: Run, words: list[str]) -> dict[str, Any]:
    stdout, stderr = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        code = run(words)
    if code not in (0, 1):
        raise InputError(f"the command failed now: {stderr.getvalue().strip().removeprefix('isetval: ')}")
    out: dict[str, Any] = json.loads(stdout.getvalue())
    return out


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


def _changed_inputs(inputs: Mapping[str, Any]) -> tuple[str, ...]:
    out = []
    for path, entry in inputs.items():
        if not Path(path).is_file():
            out.append(f"{path} (gone)")
        elif file_hash(path) != entry["sha256"]:
            out.append(path)
    return tuple(out)
