"""A small sequential ray tracer: lenses from a prescription (radii, thicknesses, glasses, aspheres)."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.polynomials import FloatArray

BoolArray = npt.NDArray[np.bool_]
FRAUNHOFER_UM = {"F": 0.4861327, "d": 0.5875618, "C": 0.6562725}
NEWTON_STEPS = 12


@dataclass(frozen=True)
class Surface:
    """One rotationally symmetric surface, in the order of the prescription (scene to film).

    Attributes
    ----------
    radius_mm : float
        Positive when the center of curvature lies on the film side; infinity for a plane.
    thickness_mm : float
        Distance to the next vertex; that of the last surface (to the film) is not used.
    index_d, abbe : float
        Refractive index at 587.6 nm and Abbe number of what follows; 1 and 0 for air.
    conic : float
        Conic constant k (0 sphere, -1 paraboloid).
    powers : mapping
        Radial power -> coefficient (mm^(1-power)); the sag is c s^2/(1+sqrt(1-(1+k)c^2 s^2)) + sum a_p s^p.
    semi_aperture_mm : float
        Rays further out are blocked; infinity if open.
    stop : bool
        The aperture stop.
    """

    radius_mm: float = math.inf
    thickness_mm: float = 0.0
    index_d: float = 1.0
    abbe: float = 0.0
    conic: float = 0.0
    powers: Mapping[int, float] = field(default_factory=dict)
    semi_aperture_mm: float = math.inf
    stop: bool = False

    @property
    def curvature(self) -> float:
        """1/radius."""
        return 0.0 if math.isinf(self.radius_mm) else 1.0 / self.radius_mm

    def index(self, wavelength_nm: float) -> float:
        """Refractive index behind the surface, n = A + B/lambda^2 through index and Abbe number."""
        if self.abbe <= 0:
            return self.index_d
        f, d, c = (FRAUNHOFER_UM[line] ** -2 for line in "FdC")
        slope = (self.index_d - 1) / self.abbe / (f - c)
        return self.index_d + slope * ((wavelength_nm * 1e-3) ** -2 - d)

    def sag(self, s2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sag and d(sag)/d(s^2) at squared distances from the axis (mm^2)."""
        c, k = self.curvature, 1 + self.conic
        root = np.sqrt(np.maximum(1 - k * c * c * s2, 1e-6))
        sag = c * s2 / (1 + root)
        slope = c / (2 * root)
        for power, a in self.powers.items():
            half = s2 ** (power // 2 - 1) if power % 2 == 0 else s2 ** (power / 2 - 1)
            sag = sag + a * half * s2
            slope = slope + a * (power / 2) * half
        return sag, slope


@dataclass(frozen=True, eq=False)
class PrescriptionRays:
    """Rays after the last surface met.

    Attributes
    ----------
    point_mm, direction : (3, n)
        On the last surface and behind it; z from the rear vertex towards the scene.
    passed : (n,) bool
        Met every surface inside its aperture without total reflection.
    overshoot : (n,)
        Largest ratio of distance from the axis to semi-aperture; 1 on the rim of the beam.
    """

    point_mm: FloatArray
    direction: FloatArray
    passed: BoolArray
    overshoot: FloatArray


@dataclass(frozen=True, eq=False)
class Prescription:
    """A lens as surfaces from scene to film.

    Attributes
    ----------
    name, source : str
    surfaces : tuple of Surface
        Without object and film.
    """

    name: str
    surfaces: tuple[Surface, ...]
    source: str = ""

    def __post_init__(self) -> None:
        if not self.surfaces:
            raise InputError(f"prescription '{self.name}': no surfaces")

    @cached_property
    def heights_mm(self) -> FloatArray:
        """Vertex heights above the rear vertex (towards the scene), scene to film."""
        below = np.array([s.thickness_mm for s in self.surfaces[:-1]])
        return np.append(np.cumsum(below[::-1])[::-1], 0.0)

    @property
    def thickness_mm(self) -> float:
        """First to last vertex."""
        return float(self.heights_mm[0])

    # ---- tracing ------------------------------------------------------------------------------
    def from_film(self, point_mm: FloatArray, direction: FloatArray, *, wavelength_nm: float = 550.0) -> PrescriptionRays:
        """Trace rays from the film side into the scene.

        Parameters
        ----------
        point_mm : (3, n)
            Points below the rear vertex; z from the rear vertex towards the scene.
        direction : (3, n)
            Unit directions with dz > 0.
        """
        return self._trace(point_mm, direction, wavelength_nm, towards_scene=True)

    def from_scene(self, point_mm: FloatArray, direction: FloatArray, *, wavelength_nm: float = 550.0) -> PrescriptionRays:
        """Trace rays from the scene to the film side (dz < 0); same axes as `from_film`."""
        return self._trace(point_mm, direction, wavelength_nm, towards_scene=False)

    def _trace(
        self, point_mm: FloatArray, direction: FloatArray, wavelength_nm: float, *, towards_scene: bool
    ) -> PrescriptionRays:
        """Intersect and refract at each surface in turn."""
        point, direction = np.array(point_mm, dtype=float), np.array(direction, dtype=float)
        passed = np.ones(point.shape[1], dtype=bool)
        overshoot = np.zeros(point.shape[1])
        behind = [s.index(wavelength_nm) for s in self.surfaces]
        before = [1.0, *behind[:-1]]
        order = range(len(self.surfaces))
        for i in reversed(order) if towards_scene else order:
            surface = self.surfaces[i]
            point, met = _intersect(surface, float(self.heights_mm[i]), point, direction)
            n1, n2 = (behind[i], before[i]) if towards_scene else (before[i], behind[i])
            direction, refracted = _refract(surface, point, direction, n1 / n2)
            passed &= met & refracted
            if math.isfinite(surface.semi_aperture_mm):
                overshoot = np.maximum(overshoot, np.hypot(point[0], point[1]) / surface.semi_aperture_mm)
        return PrescriptionRays(point, direction, passed & (overshoot <= 1.0), np.where(passed, overshoot, np.inf))

    # ---- paraxial -----------------------------------------------------------------------------
    def paraxial(self, wavelength_nm: float = 550.0) -> tuple[float, float]:
        """Focal length and back focal distance (rear vertex to focus) in mm, from the paraxial trace.

        Notes
        -----
        n'u' = nu - y (n' - n) c at each surface, y' = y + u' t between them (Welford, Aberrations of Optical Systems).
        """
        y, nu, n = 1.0, 0.0, 1.0
        for i, s in enumerate(self.surfaces):
            following = s.index(wavelength_nm)
            nu -= y * (following - n) * (s.curvature + 2 * s.powers.get(2, 0.0))
            n = following
            if i < len(self.surfaces) - 1:
                y += nu / n * s.thickness_mm
        if nu == 0:
            raise InputError(f"prescription '{self.name}' has no power: no focal length")
        return -1.0 / nu, -y / nu * n

    # ---- files --------------------------------------------------------------------------------
    @classmethod
    def load(cls, path: str | Path) -> Prescription:
        """Read a prescription TOML (keys as the fields of `Surface`; see data/lens/default_lens.toml)."""
        try:
            content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"prescription {path}: cannot be read ({error.strerror})") from None
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"prescription {path}: {error}") from None
        rows = content.get("surface", [])
        if not rows:
            raise InputError(f"prescription {path}: no [[surface]] tables")
        return cls(str(content.get("name", "")), tuple(_surface(row, path) for row in rows), str(content.get("source", "")))


def _surface(row: Mapping[str, Any], path: str | Path) -> Surface:
    """A surface from its TOML table."""
    known = {"radius_mm", "thickness_mm", "index_d", "abbe", "conic", "powers", "semi_aperture_mm", "stop"}
    unknown = set(row) - known
    if unknown:
        raise InputError(f"prescription {path}: unknown key {sorted(unknown)} in a surface; known are {sorted(known)}")
    values = {k: v for k, v in row.items() if k not in ("powers", "stop")}
    if any(isinstance(v, bool) or not isinstance(v, int | float) for v in values.values()):
        raise InputError(f"prescription {path}: surface values must be numbers, found {values}")
    return Surface(
        **{k: float(v) for k, v in values.items()},
        powers={int(p): float(a) for p, a in row.get("powers", {}).items()},
        stop=bool(row.get("stop", False)),
    )


def _reach(surface: Surface) -> float:
    """Distance from the axis beyond which a surface is continued by its value there (such rays are blocked anyway)."""
    return min(1.5 * surface.semi_aperture_mm, 1e3)


def _intersect(surface: Surface, height_mm: float, point: FloatArray, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Points (3, n) where rays meet a surface, and whether they do; Newton steps from the vertex plane."""
    start = point + direction * ((height_mm - point[2]) / direction[2])
    if surface.curvature == 0 and not surface.powers:
        return start, np.ones(start.shape[1], dtype=bool)
    t = np.zeros(start.shape[1])
    error = t
    for _ in range(NEWTON_STEPS):
        x, y = start[0] + t * direction[0], start[1] + t * direction[1]
        far = np.maximum(1.0, np.hypot(x, y) / _reach(surface))
        x, y = x / far, y / far
        sag, slope = surface.sag(x * x + y * y)
        error = t * direction[2] + sag
        change = direction[2] + 2 * slope * (x * direction[0] + y * direction[1])
        t = t - error / np.where(np.abs(change) > 1e-3, change, np.copysign(1e-3, change))
        if np.abs(error).max(initial=0.0) < 1e-13:
            break
    met: BoolArray = np.abs(error) < 1e-9
    return start + t * direction, met


def _refract(surface: Surface, point: FloatArray, direction: FloatArray, ratio: float) -> tuple[FloatArray, BoolArray]:
    """Directions (3, n) behind a surface by Snell's law in vector form, and whether light gets through."""
    if ratio == 1.0:
        return direction, np.ones(point.shape[1], dtype=bool)
    far = np.maximum(1.0, np.hypot(point[0], point[1]) / _reach(surface))
    x, y = point[0] / far, point[1] / far
    _, slope = surface.sag(x * x + y * y)
    normal = np.stack([2 * slope * x, 2 * slope * y, np.ones_like(slope)])
    normal /= np.sqrt((normal**2).sum(axis=0))
    cosine = (normal * direction).sum(axis=0)
    normal, cosine = normal * np.sign(cosine), np.abs(cosine)
    square = 1 - ratio**2 * (1 - cosine**2)
    through: BoolArray = square > 0
    bent = ratio * direction + (np.sqrt(np.maximum(square, 0)) - ratio * cosine) * normal
    return bent, through
