r"""What a picture without metadata cannot say, from a TOML file beside it: levels, pattern, place, exposure.

Looked for as ``NAME.toml`` beside ``NAME.tif``, else ``images.toml`` or ``sidecar.toml`` in its folder, else in the
folder above::

    cfa = "GBRG"                  # at sensor pixel (0, 0), as in a camera's [sensor]; "MONO" for one channel
    black_dn = 0                  # one number or four (2x2, row major from sensor pixel (0, 0))
    white_dn = 255                # or bits = 8
    pixel_um = 3.45
    exposure_s = 0.1              # also iso, f_number, focus_m
    name_rule = '_(?P<wavelength_nm>\d+)nm_(?P<exposure_ms>\d+)ms_'     # what file names say, searched in the name

    [[image]]                     # for some of the files: the same keys again
    match = "d1_*.tif"
    window = [1364, 1632]         # sensor pixel of the picture's first pixel
    sensor = [2048, 2448]         # rows and columns of the sensor
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError
from isetval.core.sensor import CFA_PATTERNS, Black, Exposure
from isetval.core.toml import check_keys, number, numbers, read_toml, text

FOLDER_NAMES = ("images.toml", "sidecar.toml")
ENCODINGS = ("linear", "srgb")
EXPOSURE_UNITS_S = {"exposure_s": 1.0, "exposure_ms": 1e-3, "exposure_us": 1e-6, "exposure_ns": 1e-9}
NUMBERS = ("white_dn", "bits", "pixel_um", "iso", "f_number", "focus_m", "wavelength_nm", *EXPOSURE_UNITS_S)
TEXTS = ("cfa", "channel", "encoding", "name_rule", "notes")
KEYS = ("black_dn", "window", "sensor", "levels_only", *NUMBERS, *TEXTS)
LARGEST_SIDE = 2**20  # pixels: 50 times the largest sensor made
LONGEST_RULE = 500  # characters of a regular expression: a rule for names, not a program


@dataclass(frozen=True)
class Sidecar:
    """What is said of one picture; None (or empty) where nothing is.

    ``labels`` are the named groups of the name rule that are no quantity (scene, visit, position); ``source`` is the
    file that says it, for people; ``levels_only`` that noise and sharpness are not the sensor's (a resampled picture).
    """

    cfa: str = ""
    black_dn: tuple[float, ...] = ()
    white_dn: float | None = None
    bits: int | None = None
    pixel_um: float | None = None
    window: tuple[int, int] | None = None
    sensor: tuple[int, int] | None = None
    exposure: Exposure = Exposure()
    wavelength_nm: float | None = None
    channel: str = ""
    encoding: str = ""
    levels_only: bool = False
    notes: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    @property
    def black_2x2(self) -> Black:
        """The stated black level at the four places of the pattern."""
        a, b, c, d = self.black_dn * 4 if len(self.black_dn) == 1 else self.black_dn
        return ((a, b), (c, d))


def find_sidecar(path: Path) -> Path | None:
    """The sidecar of a picture: its own, that of its folder, or that of the folder above; None if there is none."""
    own = path.with_suffix(".toml")
    folders = (path.parent, path.parent.parent)
    places = [own, *(folder / name for folder in folders for name in FOLDER_NAMES)]
    return next((place for place in places if place.is_file()), None)


def read_sidecar(path: Path, sidecar: Path | str | Mapping[str, Any] | None = None) -> Sidecar:
    """What is said of the picture ``path``.

    Parameters
    ----------
    path : Path
        The picture; only its name is looked at.
    sidecar : path or mapping, optional
        The TOML file, or its content; by default the one that `find_sidecar` finds.

    Raises
    ------
    InputError
        For unknown keys, values of the wrong kind, and a name rule that does not fit the name.
    """
    if isinstance(sidecar, Mapping):
        table, where = dict(sidecar), "sidecar"
    else:
        found = Path(sidecar) if sidecar is not None else find_sidecar(path)
        if found is None:
            return Sidecar()
        table, where = read_toml(found), str(found)
    return _sidecar(_for_name(table, path.name, where), path.name, where)


def _for_name(table: Mapping[str, Any], name: str, where: str) -> dict[str, Any]:
    """The keys that hold for a file: those of all, overruled by every [[image]] whose pattern fits, in order."""
    out = dict(check_keys(table, where, known=(*KEYS, "image")))
    images = out.pop("image", [])
    if not isinstance(images, list):
        raise InputError(f'{where}: image is {images!r}; it needs [[image]] tables, each with match = "*.tif"')
    for i, entry in enumerate(images, 1):
        place = f"{where}: [[image]] number {i}"
        entry = dict(check_keys(entry, place, known=(*KEYS, "match"), needed=("match",)))
        pattern = text(entry, "match", place)
        del entry["match"]
        if fnmatchcase(name, pattern):
            out |= entry
    return out


def _sidecar(table: Mapping[str, Any], name: str, where: str) -> Sidecar:
    texts = {key: text(table, key, where) for key in TEXTS}
    said = {key: _finite(number(table, key, where), key, where) for key in NUMBERS if key in table}
    from_name, labels = _name_says(texts["name_rule"], name, where)
    said = {key: value for key, value in said.items() if not (key in EXPOSURE_UNITS_S and _times(from_name))} | from_name
    _check_words(texts, where)
    if not isinstance(table.get("levels_only", False), bool):
        raise InputError(f"{where}: levels_only is {table['levels_only']!r}; it needs true or false")
    bits = said.get("bits")
    if bits is not None and (bits != int(bits) or not 1 <= bits <= 16):
        raise InputError(f"{where}: bits is {bits:g}; it needs a whole number from 1 to 16")
    return Sidecar(
        cfa=texts["cfa"],
        black_dn=_black(table, where),
        white_dn=said.get("white_dn"),
        bits=None if bits is None else int(bits),
        pixel_um=said.get("pixel_um"),
        window=_pair(table, "window", where),
        sensor=_pair(table, "sensor", where),
        exposure=_exposure(said, where),
        wavelength_nm=said.get("wavelength_nm"),
        channel=texts["channel"],
        encoding=texts["encoding"],
        levels_only=table.get("levels_only", False),
        notes=texts["notes"],
        labels=labels,
        source=where,
    )


def _times(said: Mapping[str, float]) -> list[str]:
    return [key for key in EXPOSURE_UNITS_S if key in said]


def _check_words(texts: Mapping[str, str], where: str) -> None:
    for key, known in (("cfa", CFA_PATTERNS), ("channel", ("R", "G", "B")), ("encoding", ENCODINGS)):
        if texts[key] and texts[key] not in known:
            raise InputError(f"{where}: {key} is {texts[key]!r}; it needs one of {', '.join(known)}")


def _exposure(said: Mapping[str, float], where: str) -> Exposure:
    times = _times(said)
    if len(times) > 1:
        raise InputError(f"{where}: {' and '.join(times)} are both given; leave one exposure time")
    time_s = said[times[0]] * EXPOSURE_UNITS_S[times[0]] if times else None
    try:
        return Exposure(time_s, said.get("iso"), said.get("f_number"), said.get("focus_m"))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _black(table: Mapping[str, Any], where: str) -> tuple[float, ...]:
    if "black_dn" not in table:
        return ()
    four = isinstance(table["black_dn"], list)
    values = numbers(table, "black_dn", where, lengths=(4,)) if four else (number(table, "black_dn", where),)
    return tuple(_finite(value, "black_dn", where) for value in values)


def _finite(value: float, key: str, where: str) -> float:
    """Infinity is a distance of focus, and nothing else."""
    if not math.isfinite(value) and (key, value) != ("focus_m", math.inf):
        raise InputError(f"{where}: {key} is {value}; it needs a finite number")
    return value


def _pair(table: Mapping[str, Any], key: str, where: str) -> tuple[int, int] | None:
    if key not in table:
        return None
    pair = numbers(table, key, where, lengths=(2,))
    if any(not 0 <= v <= LARGEST_SIDE or v != int(v) for v in pair):
        raise InputError(f"{where}: {key} is {list(pair)}; it needs two whole numbers of pixels, 0 to {LARGEST_SIDE}")
    return int(pair[0]), int(pair[1])


def _name_says(rule: str, name: str, where: str) -> tuple[dict[str, float], dict[str, str]]:
    """Quantities and labels that a file's name holds."""
    if not rule:
        return {}, {}
    if len(rule) > LONGEST_RULE:
        raise InputError(f"{where}: name_rule has {len(rule)} characters; it needs at most {LONGEST_RULE}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what a later Python may read otherwise
            found = re.search(rule, name)
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(f"{where}: name_rule {rule!r} is no regular expression ({error}); correct it") from None
    if found is None:
        remedy = "correct it, or give the file an [[image]] of its own"
        raise InputError(f"{where}: name_rule {rule!r} does not fit the name {name!r}; {remedy}")
    groups = {key: value for key, value in found.groupdict().items() if value is not None}
    said = {key: _number_in_name(value, key, name, where) for key, value in groups.items() if key in NUMBERS}
    return said, {key: value for key, value in groups.items() if key not in NUMBERS}


def _number_in_name(value: str, key: str, name: str, where: str) -> float:
    try:
        return float(value.replace("p", ".").replace(",", "."))
    except ValueError:
        raise InputError(f"{where}: name_rule finds {key} = {value!r} in {name!r}; it needs a number") from None
