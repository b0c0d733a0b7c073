r"""The lines of an EMVA 1288 descriptor file: series of frames with exposure times and photon numbers.

The format (documentation of the working group's package ``emva1288``, "Image Comparison", and its parser)::

    v 3.0                     version of the standard
    n 12 640 480              bits, columns, rows
    b 40000.0 120.0           bright: exposure time in ns, mean photons per pixel
    d 40000.0                 dark: exposure time in ns
    i images\b_000_001.png    a frame of the series above, relative to the file, with either slash
    l InterfaceType USB3      a word for the report, which is passed over
    # remark

Words are parted by blanks or tabs, numbers may have a decimal comma, and the file may begin with a byte order mark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from isetval.core.errors import InputError

FILE_NAME = "EMVA1288_Data.txt"
LARGEST_FILE = 10_000_000  # bytes: 100,000 frames
LARGEST_WHOLE = 2**20  # pixels of a side: 50 times the largest sensor made
SHORTEST_SERIES_S = 1e-6  # ours: no camera's longest exposure is below a microsecond, so that such times are in ms or us
NEEDED = {"v": 1, "n": 3, "b": 2, "d": 1, "i": 1, "l": 1}


@dataclass
class Series:
    """One bright (``photons`` is a number) or dark series; ``files`` as they are written, ``line`` where it begins."""

    time_s: float
    photons: float | None
    line: int
    files: list[str] = field(default_factory=list)

    @property
    def role(self) -> str:
        """What a shot of it is."""
        return "dark" if self.photons is None else "flat"


@dataclass
class EmvaLines:
    """What a descriptor states."""

    bits: int = 0
    shape: tuple[int, int] = (0, 0)
    series: list[Series] = field(default_factory=list)

    def doubt(self) -> str:
        """A sentence on exposure times that cannot be nanoseconds; empty where they can."""
        longest = max(series.time_s for series in self.series)
        if not 0 < longest < SHORTEST_SERIES_S:
            return ""
        return (
            f"exposure times reach {longest * 1e9:g} ns only; the format has nanoseconds: if they are in ms or us, multiply them "
            "in the file (dark current and times come out wrong otherwise; gain, noise and efficiency do not depend on them)"
        )


def find_emva_descriptor(path: Path | str) -> Path | None:
    """The descriptor that ``path`` is, or that lies in this folder; None if there is none.

    Raises
    ------
    InputError
        If a folder holds several, none of them of the usual name.
    """
    path = Path(path)
    if not path.is_dir():
        return path if path.suffix.lower() == ".txt" and path.is_file() and _looks_like_one(path) else None
    own = path / FILE_NAME
    others = [own] if own.is_file() else _descriptors(path)
    if len(others) > 1:
        names = ", ".join(p.name for p in others[:4])
        raise InputError(
            f"{path}: holds {len(others)} EMVA 1288 descriptors ({names}); name one of them, or join their lines in {FILE_NAME}"
        )
    return others[0] if others else None


def descriptors_below(folder: Path | str) -> list[Path]:
    """Descriptors in the sub-folders of ``folder``, sorted; none where there is no such folder."""
    if not Path(folder).is_dir():
        return []
    subs = [sub for sub in sorted(Path(folder).iterdir()) if sub.is_dir() and not sub.is_symlink()]
    return [found for sub in subs for found in _descriptors(sub)]


def _descriptors(folder: Path) -> list[Path]:
    try:
        return sorted(p for p in folder.glob("*.txt") if p.is_file() and _looks_like_one(p))
    except OSError:
        return []


def _looks_like_one(path: Path) -> bool:
    """Whether the first lines that are no remarks are a version and a format."""
    try:
        with path.open("rb") as file:
            head = file.read(4096).removeprefix(b"\xef\xbb\xbf").decode("latin-1").splitlines()
    except OSError:
        return False
    lines = [line.split() for line in head if line.strip() and not line.lstrip().startswith("#")]
    first = [line[0] for line in lines[:2]]
    return sorted(first) == ["n", "v"] and all(len(line) == 1 + NEEDED[line[0]] for line in lines[:2])


def read_emva_lines(path: Path) -> EmvaLines:
    """The content of a descriptor.

    Raises
    ------
    InputError
        For a file that is missing or too long, lines that are not of the format, and series without a frame.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; name an EMVA 1288 descriptor")
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(f"{path}: has more than {LARGEST_FILE} bytes; a descriptor is a short text file")
    found = EmvaLines()
    for number, line in enumerate(path.read_bytes().decode("utf-8-sig", errors="replace").splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            _take(found, line.strip(), f"{path}: line {number}", number)
    if not found.bits:
        raise InputError(f"{path}: has no line 'n bits columns rows'; add it")
    empty = [series for series in found.series if not series.files]
    if not found.series or empty:
        what = "no bright and no dark series" if not found.series else f"{len(empty)} series without a frame"
        raise InputError(f"{path}: has {what}; each needs a line 'b time photons' or 'd time', followed by 'i file'")
    return found


def _take(found: EmvaLines, line: str, where: str, number: int) -> None:
    """One line into the descriptor."""
    letter, rest = [*line.split(maxsplit=1), ""][:2]
    words = [rest] if letter in "il" else rest.split()
    if letter not in NEEDED or len(words) != NEEDED[letter] or not words[0]:
        raise InputError(f"{where}: {line[:80]!r} is no line of an EMVA 1288 descriptor; it knows {', '.join(NEEDED)}")
    if letter == "n":
        bits, cols, rows = (_whole(word, where) for word in words)
        if not 1 <= bits <= 16 or min(rows, cols) < 1:
            raise InputError(f"{where}: {bits} bits, {cols} columns, {rows} rows; it needs 1 to 16 bits and a size")
        found.bits, found.shape = bits, (rows, cols)
    elif letter in "bd":
        time_ns, *photons = (_number(word, where) for word in words)
        found.series.append(Series(time_ns / 1e9, photons[0] if photons else None, number))
    elif letter == "i":
        if not found.series:
            raise InputError(f"{where}: a frame before the first series; write 'b time photons' or 'd time' above it")
        found.series[-1].files.append(words[0])


def _number(word: str, where: str) -> float:
    try:
        value = float(word.replace(",", "."))
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise InputError(f"{where}: {word[:40]!r}; it needs a number, 0 or more")
    return value


def _whole(word: str, where: str) -> int:
    value = _number(word, where)
    if value != int(value) or value > LARGEST_WHOLE:
        raise InputError(f"{where}: {word[:40]!r}; it needs a whole number")
    return int(value)
