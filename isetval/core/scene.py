"""What stands in front of the camera: spectra, light, target, stray light; before it is turned into radiance."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.sensor import Roi, RoiLike

Float = NDArray[np.float64]
FWHM_SIGMAS = math.sqrt(8 * math.log(2))  # full width of a Gaussian at half maximum
CUT_NM = 1e-3  # a table is held at its ends: a zero right beside them
BAND_SIGMAS, BAND_POINTS = 4.0, 81  # 6e-5 of the light lies beyond; steps of a tenth of a sigma


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values on a rising wavelength grid; ``wavelength_nm`` and ``values`` are both (n,)."""

    wavelength_nm: Float
    values: Float

    def __post_init__(self) -> None:
        grid, values = np.atleast_1d(np.asarray(self.wavelength_nm, float)), np.atleast_1d(np.asarray(self.values, float))
        if grid.ndim != 1 or grid.shape != values.shape:
            raise InputError(f"a spectrum has {grid.shape} wavelengths and {values.shape} values; it needs as many of both")
        if np.any(np.diff(grid) <= 0):
            raise InputError("the wavelengths of a spectrum do not rise; sort the rows and drop repeated wavelengths")
        if not (np.all(np.isfinite(grid)) and np.all(np.isfinite(values))):
            raise InputError("a spectrum holds values that are not finite; it needs numbers in every row")
        object.__setattr__(self, "wavelength_nm", grid)
        object.__setattr__(self, "values", values)

    @cached_property
    def content(self) -> tuple[bytes, bytes]:
        """Both arrays as bytes: the key of what is computed from them."""
        return self.wavelength_nm.tobytes(), self.values.tobytes()

    @classmethod
    def flat(cls, value: float) -> Spectrum:
        """The same value at every wavelength."""
        return cls(np.array([550.0]), np.array([float(value)]))

    def at(self, wavelength_nm: ArrayLike) -> Float:
        """Linear interpolation; held at its end values outside the table."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.values))

    def band_means(self, wavelength_nm: ArrayLike) -> Float:
        """Means over the hat functions of a grid, so that narrow lines keep their energy.

        Summed with trapezoid weights against any curve that is linear between the grid's nodes, the
        result has the exact integral of the two (values are held outside the table).
        """
        grid = np.asarray(wavelength_nm, float)
        if grid.size < 2 or self.wavelength_nm.size < 2:
            return self.at(grid)
        return _band_means(*self.content, grid.tobytes())

    def photon_means(self, wavelength_nm: ArrayLike) -> Float:
        """Means (bands,) over the hat functions of a grid by the number of photons, lambda L/lambda_k, in the unit of ``values``.

        What a light is before a camera: times lambda_k and an efficiency that is linear between the grid's nodes (nm), summed
        with trapezoid weights, it has the exact number of photo-electrons.  `band_means` counts energy: if all of a band has
        the photons of its middle, efficiencies err by h^2/6 QE'/(QE lambda) for bands h apart (second order of the hat's
        variance).  Products are taken at the wavelengths of the tables, as CIE 15 sums them, and at every nm.
        """
        grid = np.asarray(wavelength_nm, float)
        if grid.size < 2 or self.wavelength_nm.size < 2:
            return self.at(grid)
        return _photon_means(*self.content, grid.tobytes())

    def photon_shares(self, wavelength_nm: ArrayLike) -> tuple[Float, Float]:
        """Wavelengths (points,) and the shares (bands, points) that each band of a grid has of its photons there.

        What depends on the wavelength more finely than the grid has bands is averaged with these; read-only, each row sums to 1.
        A band without light has those of even light.
        """
        return _photon_shares(self.content, np.asarray(wavelength_nm, float).tobytes())


@lru_cache(maxsize=1024)
def _band_means(table_nm: bytes, values: bytes, grid_nm: bytes) -> Float:
    """Read-only; a plan asks for the same few spectra thousands of times."""
    table, known, grid = (np.frombuffer(part) for part in (table_nm, values, grid_nm))
    fine = np.union1d(np.union1d(grid, table), np.arange(grid[0], grid[-1], 0.5))
    fine = fine[(fine >= grid[0]) & (fine <= grid[-1])]
    hats = np.array([np.interp(fine, grid, unit) for unit in np.eye(grid.size)])
    means = np.trapezoid(hats * np.interp(fine, table, known), fine, axis=1) / np.trapezoid(hats, fine, axis=1)
    means.flags.writeable = False
    return np.asarray(means)


@lru_cache(maxsize=1024)
def _photon_means(table_nm: bytes, values: bytes, grid_nm: bytes) -> Float:
    """`Spectrum.photon_means`, read-only."""
    grid, light = np.frombuffer(grid_nm), Spectrum(np.frombuffer(table_nm), np.frombuffer(values))
    points = _points(grid, light)
    means = Spectrum(points, light.at(points) * points).band_means(grid) / grid
    means.flags.writeable = False
    return np.asarray(means)


def _points(grid: Float, *tables: Spectrum) -> Float:
    """Wavelengths at which tables are multiplied, (points,): their own and every nm of a grid."""
    own = [table.wavelength_nm for table in tables]
    return np.unique(np.concatenate([np.arange(grid[0], grid[-1] + 1.0), *own]))


@lru_cache(maxsize=4096)
def _weighted_means(light: tuple[bytes, bytes], spectrum: tuple[bytes, bytes], grid_nm: bytes) -> Float:
    """Band means of a spectrum with a light's photons as weight, read-only: a fit asks for the same tables at every point."""
    wavelength_nm = np.frombuffer(grid_nm)
    weights, values = (Spectrum(*map(np.frombuffer, table)) for table in (light, spectrum))
    points = _points(wavelength_nm, weights, values)
    weight = weights.at(points) * points
    total = Spectrum(points, weight).band_means(wavelength_nm)
    part = Spectrum(points, weight * values.at(points)).band_means(wavelength_nm)
    means = np.where(total > 0, part / np.where(total > 0, total, 1.0), values.at(wavelength_nm))
    means.flags.writeable = False
    return np.asarray(means)


@lru_cache(maxsize=64)  # .2 MB each
def _photon_shares(light: tuple[bytes, bytes], grid_nm: bytes) -> tuple[Float, Float]:
    """`Spectrum.photon_shares`, read-only; sums with trapezoid weights."""
    grid, spectrum = np.frombuffer(grid_nm), Spectrum(*map(np.frombuffer, light))
    points = _points(grid, spectrum)
    points = points[(points >= grid[0]) & (points <= grid[-1])]
    wide = np.gradient(points)
    wide[[0, -1]] /= 2
    hats = np.array([np.interp(points, grid, unit) for unit in np.eye(grid.size)]) * wide
    weight = hats * np.maximum(spectrum.at(points), 0.0) * points
    total = weight.sum(axis=1, keepdims=True)
    shares = np.where(total > 0, weight, hats) / np.where(total > 0, total, hats.sum(axis=1, keepdims=True))
    for array in (points, shares):
        array.flags.writeable = False
    return points, shares


def read_spectra(path: Path | str) -> Mapping[str, Spectrum]:
    """The columns of a CSV file as spectra, by column name.

    The first column is the wavelength in nm (``wavelength_nm``); lines that begin with ``#`` are remarks.

    Raises
    ------
    InputError
        For a missing file, a missing header, a cell that is not a number, or wavelengths that do not rise.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: the file of spectra does not exist; check the path in the file that names it")
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and not line.startswith("#")]
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; a CSV file with wavelength_nm in its first column is needed") from None
    rows = list(csv.reader(lines))
    if len(rows) < 2 or "wavelength" not in rows[0][0].lower():
        raise InputError(f"{path}: no table of spectra; the first row needs column names, the first of them wavelength_nm")
    names = [name.strip() for name in rows[0]]
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise InputError(f"{path}: a cell is not a number ({error}); every row needs {len(names)} numbers") from None
    if table.shape[1] != len(names):
        raise InputError(f"{path}: rows have {table.shape[1]} cells, the header {len(names)}; they must agree")
    try:
        return {name: Spectrum(table[:, 0], table[:, i]) for i, name in enumerate(names) if i}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def narrow_band(peak_nm: float, width_nm: float, scale: float = 1.0) -> Spectrum:
    """A Gaussian band, as of a filter: ``width_nm`` is its full width at half maximum, ``scale`` its value at ``peak_nm``."""
    offset = np.linspace(-BAND_SIGMAS, BAND_SIGMAS, BAND_POINTS)
    values = np.exp(-(offset**2) / 2)
    values[[0, -1]] = 0.0  # a table is held at its ends
    return Spectrum(peak_nm + width_nm / FWHM_SIGMAS * offset, scale * values)


def band_limited(spectrum: Spectrum, low_nm: float, high_nm: float) -> Spectrum:
    """The spectrum between two wavelengths and nothing outside.

    Raises
    ------
    InputError
        If the table has fewer than two wavelengths between them.
    """
    inside = (spectrum.wavelength_nm >= low_nm) & (spectrum.wavelength_nm <= high_nm)
    if inside.sum() < 2:
        raise InputError(f"the table has {inside.sum()} wavelengths between {low_nm:g} and {high_nm:g} nm; it needs two or more")
    grid = spectrum.wavelength_nm[inside]
    values = spectrum.values[inside]
    return Spectrum([grid[0] - CUT_NM, *grid, grid[-1] + CUT_NM], [0.0, *values, 0.0])  # type: ignore[arg-type]


ORIENTATIONS = ("vertical", "horizontal")


@dataclass(frozen=True, eq=False)
class EdgeTarget:
    """A straight edge between a dark and a bright half plane.

    ``angle_deg`` is the tilt of the edge away from the column axis (orientation *vertical*) or from
    the row axis (*horizontal*), positive when the edge moves to higher columns (rows) with the row
    (column).  ``offset_px`` is (row, col) of a point of the edge from the window's middle.
    ``dark_side`` is *low* (small columns or rows are dark) or *high*.  ``surround`` is the mean reflectance of all
    that the camera sees around the window (None: the mean of both sides); it feeds veiling glare.  ``roi`` is (row0, row1, col0,
    col1) in the window; None is the whole window.
    """

    name: str
    angle_deg: float = 5.0
    orientation: str = "vertical"
    offset_px: tuple[float, float] = (0.0, 0.0)
    dark_side: str = "low"
    dark_reflectance: Spectrum = field(default_factory=lambda: Spectrum.flat(0.05))
    bright_reflectance: Spectrum = field(default_factory=lambda: Spectrum.flat(0.8))
    surround: Spectrum | None = None
    roi: RoiLike | None = None

    def __post_init__(self) -> None:
        if self.orientation not in ORIENTATIONS:
            raise InputError(f"target {self.name}: orientation is {self.orientation!r}; it needs vertical or horizontal")
        if self.roi is not None:
            object.__setattr__(self, "roi", Roi.of(self.roi))
        if self.dark_side not in ("low", "high"):
            raise InputError(f"target {self.name}: dark_side is {self.dark_side!r}; it needs low or high")


@dataclass(frozen=True, eq=False)
class Patch:
    """A uniform patch: ``box`` is (row0, row1, col0, col1) in the window, half open."""

    name: str
    box: RoiLike
    reflectance: Spectrum

    def __post_init__(self) -> None:
        object.__setattr__(self, "box", Roi.of(self.box))


@dataclass(frozen=True, eq=False)
class ChartTarget:
    """Uniform patches on a uniform surround; ``margin_px`` is cut from each box before it is measured.

    ``outline`` (row0, row1, col0, col1) in the window is where the chart ends and its ``background`` begins, to which no
    border is set (None: the surround has no end).
    ``disks`` are boxes around printed disks whose places and edges are measured; only the patches are simulated.
    """

    name: str
    patches: tuple[Patch, ...] = ()
    surround: Spectrum = field(default_factory=lambda: Spectrum.flat(0.1))
    margin_px: int = 4
    background: Spectrum | None = None
    outline: RoiLike | None = None
    disks: tuple[RoiLike, ...] = ()

    def __post_init__(self) -> None:
        if (self.background is None) != (self.outline is None):
            raise InputError(f"target {self.name}: background and outline belong together; state both or neither")
        if self.outline is not None:
            object.__setattr__(self, "outline", Roi.of(self.outline))


@dataclass(frozen=True, eq=False)
class RenderedTarget:
    """A 3-D scene that a renderer turns into radiance.

    ``spec`` is the scene as plain numbers and names (see `isetval.scenes`); ``patches`` are boxes in
    the window whose means are measured, ``lines`` are line profiles (name, row0, col0, row1, col1).
    """

    name: str
    spec: Mapping[str, Any] = field(default_factory=dict)
    patches: tuple[Patch, ...] = ()
    lines: tuple[tuple[str, float, float, float, float], ...] = ()


@dataclass(frozen=True)
class Highlight:
    """White light that a target's surface mirrors: ``level`` in reflectance, at a place (x, y) and of a width in half windows."""

    level: float
    place: tuple[float, float]
    width: float


Target = EdgeTarget | ChartTarget | RenderedTarget


@dataclass(frozen=True, eq=False)
class Scene:
    """Light and target of one shot, as the scene-stage effects see and change them.

    Parameters
    ----------
    wavelength_nm : (bands,)
    white : (bands,)
        Radiance in W/(sr m2 nm) of a perfect white diffuser in the light, or of the light itself
        where the camera looks into it (flats); means over the bands by the number of photons.
    light : Spectrum or None
        The light's own table: reflectances are averaged over the bands with its weight.
    lamp_factor : float or (bands,)
        What the shot's level and the nuisances of its spectrum multiply a light with; in ``white`` already.  A rendered scene's
        own lamp takes it where the shot names no light.
    target : Target or None
        None is a uniform field.
    tilt : (x, y)
        Relative rise of the light from the middle to the end of the half diagonal, along x and y.
    radial : float
        Relative rise of the light with the square of the field radius (1 at the corner).
    bow : (xx, yy, xy)
        Relative rise of the light with the squares of x and y and with their product, at the end of the half diagonal.
    target_tilt : (x, y)
        Relative rise of the target's brightness from its middle to the border of the window.
    target_bow : (xx, yy, xy)
        Relative rise of the target's brightness with the squares and the product of both, 1 at the border.
    target_shift_px : (x, y)
        Shift of the picture of a chart or a rendered scene to higher columns and rows.
    patch_factor : mapping
        What the reflectance of a chart's patch is multiplied with, (bands,), by the patch's name (1 where it has none).
    patch_added : mapping
        Reflectance added to a chart's patch, (bands,), by the patch's name: of what it sends beside the light that it reflects.
    surround : float
        Reflectance added to all that lies around patches and edges.
    black : float
        Reflectance added to black elements (the dark side of an edge).
    ambient : (bands,)
        Stray radiance in front of the lens, W/(sr m2 nm).
    gloss : float
        Reflectance of a white additive lift of all patches of a chart.
    highlights : tuple of Highlight
        Mirror images of lamps on a chart.
    bounce : float
        Strength of light that side walls throw on a target, as a fraction per unit of wall albedo.
    """

    wavelength_nm: Float
    white: Float
    light: Spectrum | None = None
    lamp_factor: Float | float = 1.0
    target: Target | None = None
    tilt: tuple[float, float] = (0.0, 0.0)
    radial: float = 0.0
    bow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target_tilt: tuple[float, float] = (0.0, 0.0)
    target_bow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target_shift_px: tuple[float, float] = (0.0, 0.0)
    patch_factor: Mapping[str, Float] = field(default_factory=dict)
    patch_added: Mapping[str, Float] = field(default_factory=dict)
    surround: float = 0.0
    black: float = 0.0
    ambient: Float | None = None
    gloss: float = 0.0
    highlights: tuple[Highlight, ...] = ()
    bounce: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)

    def reflectance(self, spectrum: Spectrum) -> Float:
        """Band means (bands,) of a reflectance, weighted with the light's photons: white times it holds the exact number."""
        if self.light is None or self.light.wavelength_nm.size < 2 or spectrum.wavelength_nm.size < 2:
            return spectrum.band_means(self.wavelength_nm)
        return _weighted_means(self.light.content, spectrum.content, self.wavelength_nm.tobytes())

    def with_white(self, factor: Any) -> Scene:
        """The scene with its light times ``factor`` (scalar or (bands,))."""
        return replace(self, white=self.white * factor)
