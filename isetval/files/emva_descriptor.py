r"""The EMVA 1288 working group's descriptor file as a campaign: bright and dark series with stated photon numbers.

Lines of the format (reference implementation of the working group, package ``emva1288``, and its public data sets)::

    v 3.0                     version of the standard
    n 12 640 480              bits, columns, rows
    b 40000.0 120.0           bright: exposure time in ns, mean photons per pixel
    d 40000.0                 dark: exposure time in ns
    i images\b_000_001.png    a frame of the series above, relative to the file, with either slash
    # remark
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median

import numpy as np

from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.core.sensor import Black, Exposure, Sensor, Window
from isetval.core.toml import inside
from isetval.files.captures import FileCaptures
from isetval.files.image_file import read_image

FILE_NAME = "EMVA1288_Data.txt"
LARGEST_FILE = 10_000_000  # bytes: 100,000 frames
FEWEST_OF_A_STACK = 8  # frames: levels have two, stacks for the spatial part sixteen and more (EMVA 1288 R4.0, 8.2)
F_NUMBER = 8.0  # of the standard's light: a disc seen under f/8 (EMVA 1288 R4.0, 6.1)
WAVELENGTH_NM, HALF_WIDTH_NM = 550.0, 5.0  # stands for the wavelength, which the format does not state
PLANCK_J_S, LIGHT_M_PER_S = 6.62607015e-34, 299_792_458.0
UNKNOWN_PITCH_UM = 1.0  # the format has no pitch; lengths in mm then mean thousands of pixels
LIGHT = "emva"
NEEDED = {"v": 1, "n": 3, "b": 2, "d": 1, "i": 1}


@dataclass
class _Series:
    """One bright (``photons`` is a number) or dark series."""

    time_s: float
    photons: float | None
    files: list[str] = field(default_factory=list)

    @property
    def role(self) -> str:
        return "dark" if self.photons is None else "flat"


@dataclass
class _Descriptor:
    bits: int = 0
    shape: tuple[int, int] = (0, 0)
    series: list[_Series] = field(default_factory=list)


def find_emva_descriptor(path: Path | str) -> Path | None:
    """The descriptor that ``path`` is, or that lies in this folder; None if there is none."""
    path = Path(path)
    if path.is_dir():
        own = path / FILE_NAME
        others = sorted(p for p in path.glob("*.txt") if p.is_file() and _looks_like_one(p))
        return own if own.is_file() else (others[0] if len(others) == 1 else None)
    return path if path.suffix.lower() == ".txt" and path.is_file() and _looks_like_one(path) else None


def _looks_like_one(path: Path) -> bool:
    """Whether the first lines that are no remarks are a version and a format."""
    try:
        with path.open("rb") as file:
            head = file.read(4096).decode("latin-1").splitlines()
    except OSError:
        return False
    lines = [line.split() for line in head if line.strip() and not line.startswith("#")]
    first = [line[0] for line in lines[:2]]
    return sorted(first) == ["n", "v"] and all(len(line) == 1 + NEEDED[line[0]] for line in lines[:2])


def load_emva_descriptor(path: Path | str, *, pixel_um: float = UNKNOWN_PITCH_UM) -> Campaign:
    """A campaign of an EMVA 1288 descriptor file.

    Series become shots of role flat and dark, in the order of the file.  Stacks of eight and more frames, which the standard
    takes for the spatial part, are a measurement session of their own (``B``).  The sensor has the stated bits and size; its
    black level, which the format lacks, is the mean of the dark frames of the shortest exposure.

    Parameters
    ----------
    path : path
        The descriptor.
    pixel_um : float
        Pixel pitch, which the format lacks.

    Returns
    -------
    Campaign
        Flats state ``photons_per_pixel``.  Their light has the radiance that gives these photons to a pixel of ``pixel_um``
        through an ``aperture`` of f/8, at 550 nm; only the photon number is the laboratory's.

    Raises
    ------
    InputError
        For lines that are not of the format, paths that lead out of the folder, and no usable dark series.
    """
    path = Path(path)
    found = _parsed(path)
    sensor = Sensor(*found.shape, pixel_um, "MONO", _everywhere(0.0), 2.0**found.bits - 1, found.bits)
    shots = _shots(found, sensor)
    raw = _FrameReader(path.parent, sensor, {shot.name: shot for shot in shots})
    black_dn, remark = _black_dn(raw, shots, path)
    sensor = replace(sensor, black_dn=_everywhere(black_dn))
    read = replace(raw, sensor=sensor)
    rates = [shot.photons_per_pixel / shot.exposure.time_s for shot in shots if shot.photons_per_pixel and shot.exposure.time_s]
    return Campaign(
        name=path.resolve().parent.name,
        shots=shots,
        lights={LIGHT: Light(LIGHT, _spectrum(median(rates) if rates else 0.0, pixel_um))},
        sensor=sensor,
        folder=path.parent,
        provenance={"descriptor": path.name},
        captures=FileCaptures({shot.name: shot.files for shot in shots}, read, folder=path.parent),
        notes=(
            remark,
            f"the descriptor states no pixel pitch, {pixel_um:g} um is used; no wavelength, {WAVELENGTH_NM:g} nm stands for it; "
            "no error of its photon numbers: a nuisance light_level of scope campaign (isetval campaign init drafts it)",
        ),
    )


def _everywhere(black_dn: float) -> Black:
    return ((black_dn, black_dn), (black_dn, black_dn))


def _parsed(path: Path) -> _Descriptor:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; name an EMVA 1288 descriptor")
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(f"{path}: has more than {LARGEST_FILE} bytes; a descriptor is a short text file")
    found = _Descriptor()
    for number, line in enumerate(path.read_bytes().decode("utf-8", errors="replace").splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            _take(found, line.strip(), f"{path}: line {number}", path.parent)
    if not found.bits:
        raise InputError(f"{path}: has no line 'n bits columns rows'; add it")
    empty = [series for series in found.series if not series.files]
    if not found.series or empty:
        what = "no bright and no dark series" if not found.series else f"{len(empty)} series without a frame"
        raise InputError(f"{path}: has {what}; each needs a line 'b time photons' or 'd time', followed by 'i file'")
    return found


def _take(found: _Descriptor, line: str, where: str, folder: Path) -> None:
    """One line into the descriptor."""
    letter, _, rest = line.partition(" ")
    words = [rest.strip()] if letter == "i" else rest.split()
    if letter not in NEEDED or len(words) != NEEDED[letter] or not words[0]:
        raise InputError(f"{where}: {line[:80]!r} is no line of an EMVA 1288 descriptor; it knows v, n, b, d and i")
    if letter == "n":
        bits, cols, rows = (_whole(word, where) for word in words)
        if not 1 <= bits <= 16 or min(rows, cols) < 1:
            raise InputError(f"{where}: {bits} bits, {cols} columns, {rows} rows; it needs 1 to 16 bits and a size")
        found.bits, found.shape = bits, (rows, cols)
    elif letter in "bd":
        time_ns, *photons = (_number(word, where) for word in words)
        found.series.append(_Series(time_ns / 1e9, photons[0] if photons else None))
    elif letter == "i":
        if not found.series:
            raise InputError(f"{where}: a frame before the first series; write 'b time photons' or 'd time' above it")
        name = words[0].replace("\\", "/")
        inside(folder, name)
        found.series[-1].files.append(name)


def _number(word: str, where: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise InputError(f"{where}: {word[:40]!r}; it needs a number, 0 or more")
    return value


def _whole(word: str, where: str) -> int:
    value = _number(word, where)
    if value != int(value) or value > 2**20:
        raise InputError(f"{where}: {word[:40]!r}; it needs a whole number")
    return int(value)


def _shots(found: _Descriptor, sensor: Sensor) -> tuple[Shot, ...]:
    rates = [s.photons / s.time_s for s in found.series if s.photons and s.time_s]
    unit = median(rates) if rates else 1.0
    numbers = dict.fromkeys(("dark", "flat", "dark_stack", "flat_stack"), 0)
    shots = []
    for series in found.series:
        stack = len(series.files) >= FEWEST_OF_A_STACK
        kind = series.role + ("_stack" if stack else "")
        lit = series.photons is not None
        rate = series.photons / series.time_s if series.photons and series.time_s else 0.0
        shots.append(
            Shot(
                name=f"{kind}_{numbers[kind]:03d}",
                role=series.role,
                setup=series.role,
                measurement_session="B" if stack else "A",
                exposure=Exposure(series.time_s or None),
                frames=len(series.files),
                light=LIGHT if lit else None,
                light_level=rate / unit if lit else 1.0,
                window=Window(0, 0, sensor.rows, sensor.cols),
                files=tuple(series.files),
                photons_per_pixel=series.photons,
            )
        )
        numbers[kind] += 1
    return tuple(shots)


@dataclass(frozen=True, eq=False)
class _FrameReader:
    """Reads a frame of a shot with what the descriptor states."""

    folder: Path
    sensor: Sensor
    shots: dict[str, Shot]

    def __call__(self, name: str, file: str) -> Capture:
        said = {"cfa": "MONO", "black_dn": self.sensor.black_dn[0][0], "bits": self.sensor.bits, "pixel_um": self.sensor.pixel_um}
        capture = read_image(inside(self.folder, file), said)
        if capture.mosaic.shape != (self.sensor.rows, self.sensor.cols):
            found, wanted = " x ".join(map(str, capture.mosaic.shape)), f"{self.sensor.rows} x {self.sensor.cols}"
            raise InputError(f"{file}: has {found} pixels, the descriptor says {wanted} (rows x columns); correct one of them")
        provenance = dict(capture.provenance) | {"sidecar": FILE_NAME, "black_used": "mean of the shortest dark frames"}
        return Capture(capture.mosaic, self.sensor, (0, 0), self.shots[name].exposure, provenance)


def _black_dn(read: _FrameReader, shots: Sequence[Shot], path: Path) -> tuple[float, str]:
    """Mean of the dark frames of the shortest exposure, and the sentence that says so."""
    darks = sorted((s for s in shots if s.role == "dark"), key=lambda s: s.exposure.time_s or 0.0)
    reasons = []
    for shot in darks:
        means = []
        for file in shot.files:
            try:
                mosaic = read(shot.name, file).mosaic
            except InputError as error:
                reasons.append(str(error))
                continue
            means.append(float(mosaic.mean()))
        if means:
            words = f"mean of {len(means)} dark frames of the shortest exposure ({shot.name}), an error that all shots share: "
            words += 'a nuisance "black_level.offset_dn" of scope "campaign" (isetval campaign init drafts it)'
            return float(np.mean(means)), f"black level {np.mean(means):.3f} DN: {words}"
    why = f"none can be read; the first: {reasons[0]}" if reasons else "it lists none"
    raise InputError(f"{path}: needs a dark series for the black level, and {why}")


def _spectrum(photons_per_s: float, pixel_um: float) -> Spectrum:
    """Radiance in W/(sr m2 nm), a narrow band, that sends so many photons a second to a pixel behind f/8: E = pi L / (4 N^2)."""
    joule = PLANCK_J_S * LIGHT_M_PER_S / (WAVELENGTH_NM * 1e-9)
    irradiance = photons_per_s * joule / (pixel_um * 1e-6) ** 2
    peak = irradiance * 4 * F_NUMBER**2 / math.pi / HALF_WIDTH_NM
    band = np.array([WAVELENGTH_NM - HALF_WIDTH_NM, WAVELENGTH_NM, WAVELENGTH_NM + HALF_WIDTH_NM])
    return Spectrum(band, np.array([0.0, peak, 0.0]))
