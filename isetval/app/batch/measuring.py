"""What a worker does with units of work: look them up, measure what is not known, write one segment, hand small rows back."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from isetval.app.batch.store import Record, ResultStore, Seen
from isetval.app.batch.units import Settings, Unit, fingerprint, seen_now
from isetval.app.provenance import METRIC_VERSIONS
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.metric import Metric
from isetval.core.threads import one_blas_thread
from isetval.core.version import VERSION
from isetval.files.captures import defect_words
from isetval.files.loose_files import FileMeasurement, file_reader, try_files

LOOK_AGAIN_S = 30.0  # between looks for segments of others: a listing of the store's folder
SETTLED_NS = 2_000_000_000  # a file changed less long ago may change again within one tick of the disk's clock
UNSETTLED = -1  # in place of the time of a file that may still change: its place is known, and never matches
PASSING = re.compile(r"cannot be read \(|no such file|has changed while|a defect of isetval")
"""Reasons of a refusal that may be gone next time: never stored."""
LEFT_OUT = ("summary", "count", "sigma")
_STORES: dict[str, tuple[float, ResultStore]] = {}


@dataclass(frozen=True)
class Outcome:
    """What became of a unit: the key of a stored record, or the content itself where nothing was stored."""

    unit: Unit
    key: str | None
    content: Mapping[str, Any] | None
    looked_up: bool = False


@dataclass(frozen=True)
class Done:
    """What a worker hands back of a work, and why nothing could be stored ("": it was, or there is no store)."""

    outcomes: tuple[Outcome, ...]
    not_stored: str = ""


@one_blas_thread()
def measure_units(settings: Settings, store_folder: str | None, units: Sequence[Unit]) -> Done:
    """Measure units; known ones are looked up, new ones go into the store as one segment."""
    store = None if store_folder is None else _store(store_folder)
    outcomes: list[Outcome] = []
    records: list[Record] = []
    for unit in units:
        key = _known(unit, settings, store)
        if key is not None:
            outcomes.append(Outcome(unit, key, None, looked_up=True))
            continue
        content, record = _measured(unit, settings)
        if record is not None:
            records.append(record)
        outcomes.append(Outcome(unit, None if record is None else record.key, content))
    if store is None:
        return Done(tuple(outcomes))
    try:
        store.write(records)
    except OSError as error:
        return Done(tuple(outcomes), error.strerror or str(error))
    return Done(tuple(replace(o, content=None) if o.key is not None else o for o in outcomes))


def _store(folder: str) -> ResultStore:
    """The store as this process knows it, looked at again now and then."""
    now = time.monotonic()
    looked, store = _STORES.get(folder, (now, None))
    if store is None:
        store = ResultStore(folder)
    elif now - looked > LOOK_AGAIN_S:
        store.refresh()
        looked = now
    _STORES[folder] = looked, store
    return store


def _known(unit: Unit, settings: Settings, store: ResultStore | None) -> str | None:
    """The key of a unit that was measured before; its files are hashed only where they look familiar."""
    if store is None or not len(store):
        return None
    try:
        if all(store.knows_print(fingerprint(file)) for file in unit.files):
            key = unit.key(settings, {})
            return key if key in store and store.get(key) is not None else None
    except InputError:  # said when it is measured
        pass
    return None


def _measured(unit: Unit, settings: Settings) -> tuple[dict[str, Any], Record | None]:
    """The content of a unit, and its record unless something about it may be different next time."""
    try:
        before = seen_now(unit.parts())
    except InputError:  # one of the files is gone: the others are measured, nothing is stored
        return content_of(unit, settings)[0], None
    content, hashes = content_of(unit, settings)
    if any(PASSING.search(reason) for _, reason in content["skipped"]) or _speaks_of_defect(content):
        return content, None
    try:
        after = seen_now(unit.parts())
        record = Record(unit.key(settings, hashes), content, _settled(after), [fingerprint(file) for file in unit.files])
        same = before == after == seen_now(unit.parts())
    except InputError:
        same = False
    return content, record if same else None


def _speaks_of_defect(content: Mapping[str, Any]) -> bool:
    return any(PASSING.search(note) or "please report it" in note for note in content["notes"])


def _settled(seen: tuple[Seen, ...]) -> tuple[Seen, ...]:
    """Files by place, size and time, unless one is so new that a change might leave all three as they are."""
    newest = max(s.modified_ns for s in seen)
    return seen if time.time_ns() - newest > SETTLED_NS else tuple(replace(s, modified_ns=UNSETTLED) for s in seen)


def content_of(unit: Unit, settings: Settings) -> tuple[dict[str, Any], dict[str, str]]:
    """What a unit gives as plain JSON in which its files are called ⟦0⟧, ⟦1⟧ ..., and the hashes of those that were decoded."""
    real = {mark(i): Path(file) for i, file in enumerate(unit.files)}
    own = file_reader(black=settings.black, raw=settings.raw, channel=settings.asked.channel)

    def read(path: Path) -> Capture:
        file = real[path.name]
        try:
            capture = own(file)
        except InputError as error:
            raise InputError(str(error).replace(str(file), path.name).replace(file.name, path.name)) from None
        return replace(capture, provenance={**capture.provenance, "file": path.name})

    paths = [Path(name) for name in real]
    try:
        found = try_files(paths, read=read, asked=settings.asked)
    except InputError as error:
        found = FileMeasurement(skipped=tuple((name, str(error)) for name in real))
    except Exception as error:  # what a series breaks on must not lose the other series
        found = FileMeasurement(skipped=tuple((name, defect_words(error)) for name in real))
    hashes = {str(real[name]): str(about["sha256"]) for name, about in found.files.items() if about.get("sha256")}
    content = {
        "metrics": [[name, _row(m)] for name, m in found.metrics],
        "files": [[name, about] for name, about in found.files.items()],
        "skipped": [[name, reason] for name, reason in found.skipped],
        "notes": list(found.notes),
        "empty": found.empty,
        "settings": settings.table(),
        "made_by": {"isetval": VERSION, "metric_versions": METRIC_VERSIONS},
    }
    return plain(content), hashes


def mark(number: int) -> str:
    """What a unit's file is called in its record: records know no names, only contents."""
    return f"⟦{number}⟧"


def _row(m: Metric) -> dict[str, Any]:
    """A metric without the fields it leaves empty."""
    return {k: v for k, v in vars(m).items() if v not in ("", None) and k not in LEFT_OUT} | {"sigma": float(m.sigma)}
