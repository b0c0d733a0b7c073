"""One code path from units of work to a result, whatever engine does the work; what is stored is never done twice."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from isetval.app.batch.measuring import Done, measure_units
from isetval.app.batch.store import ResultStore
from isetval.app.batch.units import Settings, Unit, seen_now
from isetval.core.engine import Engine, Lost, chunks, run_works
from isetval.core.errors import InputError

FILES_A_WORK = 32  # 3.5 ms of a cluster's overhead become .1 ms a file; a lost work costs half a minute at most
WORKS_A_WORKER = 4  # at least: so that all are busy to the end of a short run
MOST_IN_FLIGHT = 200  # of a cluster: its scheduler slows down beyond
MARK = re.compile("⟦([0-9]+)⟧")
Progress = Callable[[str, int, int], None]


@dataclass(eq=False)
class Batch:
    """What a run knows of its units: contents in the store by key, others here."""

    units: Sequence[Unit]
    store: ResultStore | None
    keys: dict[Unit, str] = field(default_factory=dict)
    contents: dict[Unit, Mapping[str, Any]] = field(default_factory=dict)
    known: int = 0
    notes: list[str] = field(default_factory=list)

    def results(self) -> Iterator[tuple[Unit, Mapping[str, Any]]]:
        """Every unit with its content, in the order given, file names in their places."""
        for unit in self.units:
            content = self.contents.get(unit)
            if content is None and self.store is not None and unit in self.keys:
                content = self.store.get(self.keys[unit])
            if content is None:
                raise InputError(f"{unit.files[0]}: its record left the store while the run went on; give the command again")
            yield unit, named(content, unit)


def run_batch(
    units: Sequence[Unit],
    settings: Settings,
    engine: Engine,
    *,
    store_folder: Path | None,
    must_store: bool = False,
    progress: Progress | None = None,
) -> Batch:
    """Measure units on an engine.

    Parameters
    ----------
    units, settings, engine
    store_folder : path, optional
        What is known there is not measured again; what is new is written there.
    must_store : bool
        Stop where the store cannot be written; otherwise go on without it.
    progress : callable, optional

    Raises
    ------
    InputError
        If the store cannot be written and must be, or the workers end again and again.
    """
    store = None if store_folder is None else ResultStore(store_folder)
    batch = Batch(units, store)
    todo = [unit for unit in units if not _is_known(unit, settings, batch)]
    batch.known = len(units) - len(todo)
    files = sum(len(unit.files) for unit in todo)
    done, since = 0, time.monotonic()
    work = partial(measure_units, settings, None if store_folder is None else str(store_folder))
    works = chunks(todo, _work_size(todo, engine.workers))
    for items, result in run_works(work, works, engine, in_flight=min(MOST_IN_FLIGHT, 2 * engine.workers)):
        _take(batch, items, result)
        if isinstance(result, Done) and result.not_stored:
            _refuse_or_note(batch, store_folder, result.not_stored, must=must_store)
        done += sum(len(unit.files) for unit in items)
        if progress is not None:
            progress(f"measuring, {done / max(time.monotonic() - since, 1e-9):.3g} files/s", done, files)
    if store is not None:
        store.refresh()
    return batch


def _is_known(unit: Unit, settings: Settings, batch: Batch) -> bool:
    """Whether the store holds this unit as its files lie on the disk; the others are looked at by the workers."""
    if batch.store is None or not len(batch.store):
        return False
    try:
        keys = batch.store.keys_of(seen_now(unit.parts()))
    except InputError:
        return False
    own = next((key for key in keys if key.startswith(settings.mark()) and batch.store.get(key) is not None), None)
    if own is not None:
        batch.keys[unit] = own
    return own is not None


def _work_size(units: Sequence[Unit], workers: int) -> int:
    """Units of a work: some tens of files, fewer where the run is short."""
    files = sum(len(unit.files) for unit in units)
    longest = max(1, round(FILES_A_WORK * len(units) / max(files, 1)))
    return max(1, min(longest, -(-len(units) // (WORKS_A_WORKER * workers))))


def _take(batch: Batch, units: Sequence[Unit], result: Done | Lost) -> None:
    if isinstance(result, Lost):
        for unit in units:
            skipped = [[f"⟦{i}⟧", result.words] for i in range(len(unit.files))]
            batch.contents[unit] = {"metrics": [], "files": [], "skipped": skipped, "notes": [], "empty": ""}
        return
    for outcome in result.outcomes:
        batch.known += outcome.looked_up
        if outcome.content is not None:
            batch.contents[outcome.unit] = outcome.content
        elif outcome.key is not None:
            batch.keys[outcome.unit] = outcome.key


def _refuse_or_note(batch: Batch, folder: Path | None, reason: str, *, must: bool) -> None:
    if must:
        raise InputError(
            f"{folder}: the store cannot be written ({reason}); what was stored before is kept: "
            "make room or choose another place, and give the same command again"
        )
    note = f"{folder}: cannot be written ({reason}): this run cannot be resumed"
    if note not in batch.notes:
        batch.notes.append(note)


def named(content: Mapping[str, Any], unit: Unit) -> Mapping[str, Any]:
    """A record's content with the names of the unit's files, and its series told apart from others."""
    names = [Path(file).name for file in unit.files]

    def text(value: str) -> str:
        return MARK.sub(lambda found: names[int(found[1])] if int(found[1]) < len(names) else found[0], value)

    def deep(value: Any) -> Any:
        if isinstance(value, str):
            return text(value) if "⟦" in value else value
        if isinstance(value, dict):
            return {key: deep(part) for key, part in value.items()}
        return [deep(part) for part in value] if isinstance(value, list) else value

    def path(name: str) -> str:
        found = MARK.fullmatch(name)
        return unit.files[int(found[1])] if found else name

    return {
        "metrics": [[path(name), _in_series(deep(row), unit.label)] for name, row in content["metrics"]],
        "files": [[path(name), deep(about)] for name, about in content["files"]],
        "skipped": [[path(name), deep(reason)] for name, reason in content["skipped"]],
        "notes": [f"{unit.label}: {deep(note)}" if unit.label else deep(note) for note in content["notes"]],
        "empty": deep(content["empty"]),
    }


def _in_series(row: dict[str, Any], label: str) -> dict[str, Any]:
    """The names of a series' shots and sessions are its own."""
    if not label:
        return row
    for name in ("shot", "setup", "measurement_session"):
        if row.get(name):
            row[name] = f"{label}/{row[name]}"
    return row
