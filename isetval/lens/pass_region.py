"""Which rays a lens lets through: ellipses, circles or convex polygons on one plane, per field height."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from isetval.core.errors import InputError
from isetval.lens.polynomials import FloatArray


class PassRegion(Protocol):
    """The part of the ray-pass plane that a beam may use, in the rotated frame (field point on +y).

    ``gauge`` grows in proportion to the distance from ``center`` and is 1 on the rim, so that a ray
    passes where it is <= 1 and the rim along any direction is found by a few secant steps.
    """

    @property
    def plane_distance_mm(self) -> float:
        """Distance h from the input plane to the ray-pass plane."""
        ...

    @property
    def last_position_mm(self) -> float:
        """Largest field height in the table; rays beyond use the last entry and are reported."""
        ...

    def center(self, r_mm: FloatArray) -> FloatArray:
        """Center of the region, (2, n)."""
        ...

    def radius(self, r_mm: FloatArray) -> FloatArray:
        """A typical radius of the region, (n,)."""
        ...

    def gauge(self, r_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Relative distance from the center, 1 on the rim, (n,)."""
        ...

    def to_json(self) -> dict[str, Any]:
        """The ``passnopass`` object of the ISET files."""
        ...


def _table(r_mm: FloatArray, positions: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation of the columns of ``values`` (positions, columns) at r, (n, columns), held at the ends."""
    if len(positions) == 1:
        return np.broadcast_to(values[0], (r_mm.size, values.shape[1]))
    index = np.clip(np.searchsorted(positions, r_mm, side="right") - 1, 0, len(positions) - 2)
    weight = np.clip((r_mm - positions[index]) / (positions[index + 1] - positions[index]), 0.0, 1.0)[:, None]
    found: FloatArray = values[index] * (1 - weight) + values[index + 1] * weight
    return found


@dataclass(frozen=True, eq=False)
class EllipseRegion:
    """Axis-aligned ellipses at tabulated field heights (method ``minimalellipse``).

    Attributes
    ----------
    positions_mm : (n,)
        Field heights on the input plane, increasing.
    centers_mm, radii_mm : (n, 2)
        Center and semi-axes along x (sagittal) and y (meridional).
    plane_distance_mm : float
        Distance from the input plane to the ray-pass plane.
    """

    positions_mm: FloatArray
    centers_mm: FloatArray
    radii_mm: FloatArray
    plane_distance_mm: float

    def __post_init__(self) -> None:
        n = len(self.positions_mm)
        if n < 1 or self.centers_mm.shape != (n, 2) or self.radii_mm.shape != (n, 2):
            raise InputError(
                f"pass region: {n} positions, centers {self.centers_mm.shape}, radii {self.radii_mm.shape}; "
                "each position needs one center and one pair of radii"
            )
        if np.any(np.diff(self.positions_mm) <= 0) or np.any(self.radii_mm <= 0):
            raise InputError("pass region: positions must increase and radii be positive")

    @property
    def last_position_mm(self) -> float:
        """Largest field height in the table."""
        return float(self.positions_mm[-1])

    @cached_property
    def _columns(self) -> FloatArray:
        """Center and semi-axes side by side, (positions, 4)."""
        return np.hstack([self.centers_mm, self.radii_mm])

    @cached_property
    def _step_mm(self) -> float | None:
        """Spacing of a uniform table, else None."""
        steps = np.diff(self.positions_mm)
        if len(steps) == 0 or self.positions_mm[0] != 0 or np.ptp(steps) > 1e-9 * steps[0]:
            return None
        return float(steps.mean())

    @cached_property
    def _intervals(self) -> FloatArray:
        """Value at the start of every interval and the change per table step, (8, intervals + 1)."""
        columns = self._columns
        slopes = np.vstack([np.diff(columns, axis=0), np.zeros((1, 4))])
        return np.ascontiguousarray(np.hstack([columns, slopes]).T)

    def _ellipse(self, r_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """cx, cy, Rx, Ry at r, each (n,)."""
        if self._step_mm is None:
            cx, cy, rx, ry = _table(r_mm, self.positions_mm, self._columns).T
            return cx, cy, rx, ry
        place = np.minimum(r_mm * (1.0 / self._step_mm), len(self.positions_mm) - 1.0)
        index = place.astype(np.int32)
        place -= index
        values = [np.take(row, index) for row in self._intervals]
        cx, cy, rx, ry = (values[k] + place * values[k + 4] for k in range(4))
        return cx, cy, rx, ry

    def center(self, r_mm: FloatArray) -> FloatArray:
        """Center of the ellipse, (2, n)."""
        cx, cy, _, _ = self._ellipse(r_mm)
        return np.stack([cx, cy])

    def radius(self, r_mm: FloatArray) -> FloatArray:
        """Geometric mean of the semi-axes, (n,)."""
        _, _, rx, ry = self._ellipse(r_mm)
        mean: FloatArray = np.sqrt(rx * ry)
        return mean

    def gauge(self, r_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Relative distance from the center, (n,)."""
        cx, cy, rx, ry = self._ellipse(r_mm)
        u = (x_mm - cx) / rx
        v = (y_mm - cy) / ry
        found: FloatArray = np.sqrt(u * u + v * v)
        return found

    def to_json(self) -> dict[str, Any]:
        """The ``passnopass`` object."""
        return {
            "method": "minimalellipse",
            "positions": self.positions_mm.tolist(),
            "radiiX": self.radii_mm[:, 0].tolist(),
            "radiiY": self.radii_mm[:, 1].tolist(),
            "centersX": self.centers_mm[:, 0].tolist(),
            "centersY": self.centers_mm[:, 1].tolist(),
            "intersectPlaneDistance": self.plane_distance_mm,
        }


@dataclass(frozen=True, eq=False)
class CircleRegion:
    """Several circles whose centers move in proportion to the field height; a ray must be inside all.

    Attributes
    ----------
    radii_mm, sensitivities : (circles,)
        Radius, and center divided by field height.
    plane_distance_mm, last_position_mm : float
        As in `PassRegion`.
    """

    radii_mm: FloatArray
    sensitivities: FloatArray
    plane_distance_mm: float
    last_position_mm: float = np.inf

    def center(self, r_mm: FloatArray) -> FloatArray:
        """Middle of the meridional extent of the intersection, (2, n)."""
        low, high = self._meridional(r_mm)
        return np.stack([np.zeros_like(r_mm), (low + high) / 2])

    def _meridional(self, r_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper end of the intersection on the meridian; equal where nothing passes."""
        centers = np.outer(self.sensitivities, r_mm)
        low = (centers - self.radii_mm[:, None]).max(axis=0)
        high = (centers + self.radii_mm[:, None]).min(axis=0)
        middle = (low + high) / 2
        return np.minimum(low, middle), np.maximum(high, middle)

    def radius(self, r_mm: FloatArray) -> FloatArray:
        """Half the meridional extent, (n,)."""
        low, high = self._meridional(r_mm)
        half: FloatArray = (high - low) / 2
        return half

    def gauge(self, r_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Relative distance from the center: distance divided by that of the rim in the same direction, (n,)."""
        _, cy = self.center(r_mm)
        offset = y_mm - cy
        distance = np.hypot(x_mm, offset)
        safe = np.where(distance > 0, distance, 1.0)
        ey = np.where(distance > 0, offset / safe, 1.0)
        rim = np.full_like(distance, np.inf)
        for radius, sensitivity in zip(self.radii_mm, self.sensitivities, strict=True):
            shift = cy - sensitivity * r_mm
            along = shift * ey
            rim = np.minimum(rim, -along + np.sqrt(np.maximum(along**2 - shift**2 + radius**2, 0.0)))
        found: FloatArray = np.where(rim > 0, distance / np.where(rim > 0, rim, 1.0), np.inf)
        return found

    def to_json(self) -> dict[str, Any]:
        """The ``passnopass`` object."""
        return {
            "method": "circles",
            "radii": self.radii_mm.tolist(),
            "sensitivities": self.sensitivities.tolist(),
            "intersectPlaneDistance": self.plane_distance_mm,
        }


@dataclass(frozen=True, eq=False)
class ConvexRegion:
    """Star-shaped outlines at tabulated field heights: rim distance from a center, per azimuth.

    An own extension of the file format (method ``rim``), exact for clipped pupils that no ellipse fits.

    Attributes
    ----------
    positions_mm : (n,)
    centers_mm : (n, 2)
    rim_mm : (n, azimuths)
        Distance of the rim from the center at azimuths 0, 360/azimuths, ... degrees from +x.
    plane_distance_mm : float
    """

    positions_mm: FloatArray
    centers_mm: FloatArray
    rim_mm: FloatArray
    plane_distance_mm: float

    @property
    def last_position_mm(self) -> float:
        """Largest field height in the table."""
        return float(self.positions_mm[-1])

    def center(self, r_mm: FloatArray) -> FloatArray:
        """Center of the outline, (2, n)."""
        return np.ascontiguousarray(_table(r_mm, self.positions_mm, self.centers_mm).T)

    def radius(self, r_mm: FloatArray) -> FloatArray:
        """Root mean square rim distance: that of the circle of equal area, (n,)."""
        mean: FloatArray = np.sqrt((_table(r_mm, self.positions_mm, self.rim_mm) ** 2).mean(axis=1))
        return mean

    def gauge(self, r_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Distance from the center divided by the rim distance in that direction, (n,)."""
        cx, cy = self.center(r_mm)
        azimuths = self.rim_mm.shape[1]
        place = np.arctan2(y_mm - cy, x_mm - cx) * (azimuths / (2 * np.pi)) % azimuths
        index = place.astype(np.int64) % azimuths
        rim = _table(r_mm, self.positions_mm, self.rim_mm)
        rows = np.arange(len(index))
        here, following = rim[rows, index], rim[rows, (index + 1) % azimuths]
        found: FloatArray = np.hypot(x_mm - cx, y_mm - cy) / (here + (place - np.floor(place)) * (following - here))
        return found

    def to_json(self) -> dict[str, Any]:
        """The ``passnopass`` object."""
        return {
            "method": "rim",
            "positions": self.positions_mm.tolist(),
            "centersX": self.centers_mm[:, 0].tolist(),
            "centersY": self.centers_mm[:, 1].tolist(),
            "rim": self.rim_mm.tolist(),
            "intersectPlaneDistance": self.plane_distance_mm,
        }


def _numbers(source: Mapping[str, Any], key: str) -> FloatArray:
    """A list of finite numbers from the JSON, or an error that names the key."""
    try:
        values = np.atleast_1d(np.asarray(source[key], dtype=np.float64))
    except KeyError:
        raise InputError(f"pass region ({source.get('method')}): '{key}' is missing") from None
    except (OverflowError, TypeError, ValueError):
        raise InputError(f"pass region ({source.get('method')}): '{key}' must be a list of numbers") from None
    if values.ndim != (2 if key == "rim" else 1) or not values.size:
        raise InputError(f"pass region ({source.get('method')}): '{key}' must be a list of numbers")
    if not np.isfinite(values).all():
        raise InputError(f"pass region ({source.get('method')}): '{key}' holds values that are not finite")
    return values


def _pairs(source: Mapping[str, Any], key: str) -> FloatArray:
    """The numbers of two lists of equal length, ``keyX`` and ``keyY``, (n, 2)."""
    x, y = _numbers(source, f"{key}X"), _numbers(source, f"{key}Y")
    if len(x) != len(y):
        raise InputError(f"pass region: '{key}X' has {len(x)} numbers and '{key}Y' {len(y)}; they need as many")
    return np.stack([x, y], axis=1)


def region_from_json(source: Mapping[str, Any]) -> PassRegion:
    """The pass region of a ``passnopass`` object; raises InputError for an unknown method or missing lists."""
    method = str(source.get("method", "")).lower()
    distance = float(_numbers(source, "intersectPlaneDistance")[0])
    if method.startswith("circle"):
        return CircleRegion(_numbers(source, "radii"), _numbers(source, "sensitivities"), distance)
    if method not in ("minimalellipse", "rim"):
        raise InputError(f"pass region: method '{method}' is unknown; minimalellipse, circles and rim can be read")
    positions = _numbers(source, "positions")
    centers = _pairs(source, "centers")
    if method == "rim":
        return ConvexRegion(positions, centers, _numbers(source, "rim"), distance)
    radii = _pairs(source, "radii")
    return EllipseRegion(positions, centers, radii, distance)
