"""Units of work: a file, or the darks or flats of one folder; how a unit is known again without reading it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from isetval.app.batch.store import Seen
from isetval.app.provenance import METRIC_VERSIONS
from isetval.core.cache import bytes_hash, content_hash, file_hash
from isetval.core.errors import InputError
from isetval.core.paths import common_folder, seen_from
from isetval.files.capture_file import DNG_SUFFIX
from isetval.files.loose_files import SERIES_ROLES, Asked
from isetval.files.sidecar import find_sidecar

FORMAT = 1  # of a record's content; a new one makes all stored ones stale
PRINT_BYTES = 4096  # looked at in three places of a file: two captures of one camera differ there already


@dataclass(frozen=True)
class Settings:
    """All that decides what a file gives beside its bytes."""

    asked: Asked = field(default_factory=Asked)
    black: str = "auto"
    raw: Mapping[str, Any] | None = None

    def table(self) -> dict[str, Any]:
        """The settings as a result states them."""
        names = ("method", "channel", "roi", "gain_dn_per_e")
        given = {name: getattr(self.asked, name) for name in names if getattr(self.asked, name)}
        return {"role": self.asked.role} | given | {"black": self.black, "raw": self.raw}

    def mark(self) -> str:
        """First part of the key of every record made with these settings."""
        return self._mark

    @cached_property
    def _mark(self) -> str:
        return content_hash(("measure", FORMAT, METRIC_VERSIONS, self.table()))[:24]


@dataclass(frozen=True)
class Unit:
    """Files that are measured together, in order of name; ``label`` says which of several series they are."""

    files: tuple[str, ...]
    label: str = ""

    def parts(self) -> list[Path]:
        """Its files and the sidecars that state their levels."""
        out = [Path(file) for file in self.files]
        sidecars = [find_sidecar(path) for path in out if not path.name.lower().endswith(DNG_SUFFIX)]
        return out + list(dict.fromkeys(path for path in sidecars if path is not None))

    def key(self, settings: Settings, hashes: Mapping[str, str]) -> str:
        """The key of its record; names count only where a sidecar's rules may read them."""
        parts = self.parts()
        names = [Path(file).name for file in self.files] if len(parts) > len(self.files) else []
        digests = [hashes.get(str(path)) or file_hash(path) for path in parts]
        return settings.mark() + content_hash((digests, names))[:40]


def units_of(files: Sequence[Path], role: str | None) -> list[Unit]:
    """The units of the files: those of one folder together for darks and flats, else each by itself."""
    if role not in SERIES_ROLES:
        return [Unit((str(file),)) for file in files]
    folders: dict[str, list[str]] = {}
    for file in files:
        folders.setdefault(str(file.parent), []).append(str(file))
    common = common_folder(list(folders))
    several = len(folders) > 1
    return [Unit(tuple(own), seen_from(folder, common) if several else "") for folder, own in folders.items()]


def part_of(units: Sequence[Unit], part: tuple[int, int] | None) -> list[Unit]:
    """Every n-th unit from the i-th on; all without a part."""
    return list(units) if part is None else list(units[part[0] - 1 :: part[1]])


def seen_now(paths: Iterable[Path]) -> tuple[Seen, ...]:
    """How files lie on the disk now.

    Raises
    ------
    InputError
        If one is gone.
    """
    out = []
    for path in paths:
        try:
            status = os.stat(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check that it is still there") from None
        out.append(Seen(os.path.abspath(path), status.st_size, status.st_mtime_ns))
    return tuple(out)


def fingerprint(path: Path | str) -> str:
    """A hash of a file's size and of its first, middle and last bytes: equal files have it equal, most others do not.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with open(path, "rb", buffering=0) as file:
            size = file.seek(0, os.SEEK_END)
            data = str(size).encode()
            for at in (0, size // 2, size - PRINT_BYTES):
                file.seek(max(0, at))
                data += file.read(PRINT_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its permissions") from None
    return bytes_hash(data)[:16]
