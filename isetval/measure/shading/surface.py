"""The model of relative illumination and its fit: an even curve about a fitted centre, times a tilt.

Signal of a plane at (x, y) mm from the sensor's middle::

    S = T(x, y) * sum_k c_k B_k(r^2),   r^2 = (x - xc)^2 + (y - yc)^2
    T = 1 + tx (x - xc) + ty (y - yc)

with the even functions B_k of `isetval.measure.shading.radial_basis`.  Centre and tilt are shared by the planes; the polynomials'
coefficients are each plane's own, the splines' are shared (the first plane has splines only, so that
nothing is counted twice).  Rows and columns of blocks that err together are added to the covariance at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.measure.shading.radial_basis import Radial

Float = NDArray[np.float64]
Int = NDArray[np.intp]
END_SIGMA = 3e-3  # of the last spline's third difference: cos^4 over a phone's field gives 2e-3 with the widest splines
CURVATURE_STEP = 0.02  # of the radius: curvature of cos^4 to 4e-4, far above rounding
LEAST_DETERMINED = 1e-14  # of the largest column of the normal equations: rounding of double precision
GEOMETRIES = {"center+tilt": (0, 1, 2, 3), "center": (0, 1), "tilt": (2, 3), "none": ()}


@dataclass(frozen=True, eq=False)
class Points:
    """Data of one plane for the fit, in mm and relative units; one entry a block."""

    x_mm: Float
    y_mm: Float
    spread_x_mm2: Float
    spread_y_mm2: Float
    value: Float
    sigma: Float

    def keep(self, mask: NDArray[np.bool_]) -> Points:
        """The points where ``mask`` holds."""
        return Points(*(getattr(self, name)[mask] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Surface:
    """A fitted set of planes.

    ``geometry`` is (xc, yc, tx, ty) in mm and 1/mm, ``coefficients`` one array (radial.count,) a plane.
    ``covariance`` is that of the fitted parameters; the last four are the geometry (rows of numbers held
    fixed are 0), ``places[k]`` holds the parameter number of each basis function of plane k, -1 where unused.
    """

    geometry: Float
    coefficients: tuple[Float, ...]
    covariance: Float
    places: tuple[Int, ...]
    radial: Radial
    free: tuple[int, ...]
    chi2: tuple[float, ...]
    converged: bool

    def plane_covariance(self, first: int, second: int) -> Float:
        """Covariance of two planes' coefficients, (count, count), 0 where unused."""
        rows, cols = self.places[first], self.places[second]
        used = np.outer(rows >= 0, cols >= 0)
        return np.asarray(np.where(used, self.covariance[np.ix_(rows, cols)], 0.0))


def evaluate(points: Points, geometry: Float, coefficients: Float, radial: Radial) -> Float:
    """Model at the points' middles, (points,)."""
    dx, dy = points.x_mm - geometry[0], points.y_mm - geometry[1]
    tilt = 1 + geometry[2] * dx + geometry[3] * dy
    return np.asarray(tilt * (coefficients @ radial.values(dx**2 + dy**2)))


def block_bias(points: Points, geometry: Float, coefficients: Float, radial: Radial) -> Float:
    """Mean of the model over each block minus its value at the middle: half the curvature times the spread."""
    step = CURVATURE_STEP * radial.radius_mm
    middle = evaluate(points, geometry, coefficients, radial)
    out = np.zeros_like(middle)
    for (sx, sy), spread in (((step, 0.0), points.spread_x_mm2), ((0.0, step), points.spread_y_mm2)):
        moved = [geometry + np.array([s * sx, s * sy, 0, 0]) for s in (-1, 1)]
        both = sum(evaluate(points, g, coefficients, radial) for g in moved)
        out += spread / 2 * (both - 2 * middle) / step**2
    return out


def design(points: Points, geometry: Float, coefficients: Float | None, radial: Radial) -> Float:
    """Weighted rows (count + 4, points): the basis times the tilt, then derivatives by xc, yc, tx, ty."""
    dx, dy = points.x_mm - geometry[0], points.y_mm - geometry[1]
    r2 = dx**2 + dy**2
    weight = 1 / points.sigma
    tilt = (1 + geometry[2] * dx + geometry[3] * dy) * weight
    out = np.empty((radial.count + 4, points.value.size))
    if coefficients is None:
        np.multiply(radial.values(r2), tilt, out=out[: radial.count])
        out[radial.count :] = 0.0
        return out
    basis, slopes = radial.with_slopes(r2)
    np.multiply(basis, tilt, out=out[: radial.count])
    curve = (coefficients @ basis) * weight
    inner = tilt * (coefficients @ slopes) * -2
    out[-4] = inner * dx - geometry[2] * curve
    out[-3] = inner * dy - geometry[3] * curve
    out[-2], out[-1] = curve * dx, curve * dy
    return out


def parameter_places(planes: int, radial: Radial) -> tuple[tuple[Int, ...], int]:
    """Parameter number of every plane's basis functions (-1: unused), and the number of parameters without geometry."""
    if radial.kind == "polynomial":
        return tuple(np.arange(radial.own) + k * radial.own for k in range(planes)), planes * radial.own
    first = (planes - 1) * radial.own
    shared = first + np.arange(radial.count - radial.own)
    own = [np.full(radial.own, -1), *(np.arange(radial.own) + k * radial.own for k in range(planes - 1))]
    return tuple(np.concatenate([part, shared]) for part in own), first + shared.size


def _solve(normal: Float, right: Float) -> tuple[Float, Float]:
    """Solution and covariance of the normal equations, columns scaled; unseen directions get the least norm."""
    diagonal = np.diag(normal)
    scale = np.where(diagonal > LEAST_DETERMINED * diagonal.max(), 1 / np.sqrt(np.maximum(diagonal, 1e-300)), 0)
    scaled = normal * np.outer(scale, scale)
    try:
        inverse = np.linalg.inv(scaled) if scale.all() and np.linalg.cond(scaled) < 1e11 else None
    except np.linalg.LinAlgError:
        inverse = None
    if inverse is None:
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    inverse = inverse * np.outer(scale, scale)
    return inverse @ right, inverse


def _step(
    planes: Sequence[Points], geometry: Float, coefficients: Sequence[Float | None], *, radial: Radial, free: tuple[int, ...]
) -> tuple[Float, list[Float], Float]:
    """One Gauss-Newton step of all planes together: geometry change, coefficients, covariance."""
    places, size = parameter_places(len(planes), radial)
    width = size + 4
    normal, right = np.zeros((width, width)), np.zeros(width)
    for place, points, known in zip(places, planes, coefficients, strict=True):
        columns = np.concatenate([np.flatnonzero(place >= 0), radial.count + np.array(free, dtype=np.intp)])
        index = np.concatenate([place[place >= 0], size + np.array(free, dtype=np.intp)])
        rows = design(points, geometry, known, radial)
        rows = rows if columns.size == rows.shape[0] else rows[columns]
        normal[np.ix_(index, index)] += rows @ rows.T
        right[index] += rows @ (points.value / points.sigma)
    if radial.kind == "spline":
        # the last spline lives on the outermost corner alone: hold its third difference to 0 +- END_SIGMA
        third = np.array([-1.0, 3.0, -3.0, 1.0]) / END_SIGMA
        normal[size - 4 : size, size - 4 : size] += np.outer(third, third)
    active = np.concatenate([np.arange(size), size + np.array(free, dtype=np.intp)])
    solution, covariance = np.zeros(width), np.zeros((width, width))
    solution[active], covariance[np.ix_(active, active)] = _solve(normal[np.ix_(active, active)], right[active])
    parts = [np.where(place >= 0, solution[place], 0.0) for place in places]
    return solution[-4:], parts, covariance


def fit_surface(
    planes: Sequence[Points],
    *,
    radial: Radial,
    geometry: str = "center+tilt",
    start: Float | None = None,
    steps: int = 12,
) -> Surface:
    """Weighted least squares of all planes with one centre and one tilt (Gauss-Newton).

    Parameters
    ----------
    planes : sequence of Points
    radial : Radial
        Basis of the curve; the data should lie within its radius.
    geometry : str
        Which numbers are free: ``center+tilt``, ``center``, ``tilt`` or ``none``.
    start : (4,) array, optional
        Start of (xc, yc, tx, ty); zeros by default.
    """
    free = GEOMETRIES[geometry]
    place = np.zeros(4) if start is None else np.array(start, dtype=float)
    if geometry == "center":
        place[2:] = 0.0
    _, parts, covariance = _step(planes, place, [None] * len(planes), radial=radial, free=())
    converged = not free
    for _ in range(steps if free else 0):
        change, parts, covariance = _step(planes, place, parts, radial=radial, free=free)
        largest = float(np.abs(change[:2]).max())
        place = place + change * min(1.0, 0.15 * radial.radius_mm / max(largest, 1e-12))
        if np.hypot(*place[:2]) > 2 * radial.radius_mm:
            break
        if largest < 2e-6 and float(np.abs(change[2:]).max()) < 1e-6:
            converged = True
            break
    if not converged and steps > 1:
        _, parts, _ = _step(planes, place, [None] * len(planes), radial=radial, free=())
    chi2 = tuple(
        float((((p.value - evaluate(p, place, c, radial)) / p.sigma) ** 2).sum()) for p, c in zip(planes, parts, strict=True)
    )
    places, _ = parameter_places(len(planes), radial)
    return Surface(place, tuple(parts), covariance, places, radial, free, chi2, converged)


@dataclass(frozen=True, eq=False)
class LineNoise:
    """Common error of the blocks of a line: line of each block and its standard deviation, in the fit's units."""

    line: Float
    sigma: float


def with_line_noise(surface: Surface, planes: Sequence[Points], noise: Sequence[Sequence[LineNoise]]) -> Surface:
    """The surface with the covariance that row and column noise add.

    Parameters
    ----------
    surface : Surface
        A fit whose weights already hold the line noise of single blocks.
    planes : sequence of Points
    noise : sequence of sequence of LineNoise
        For each plane its rows and its columns; planes with blocks on one line share its error.

    Notes
    -----
    With C the covariance, J the weighted design and e_l the error of line l, the added covariance is
    C sum_l (sum_b J_b e_l)(sum_b J_b e_l)' C, less the part of single blocks, which is in C.
    """
    size = surface.covariance.shape[0]
    added = np.zeros((size, size))
    for kind in range(len(noise[0])):
        keys = np.unique(np.concatenate([part[kind].line for part in noise]))
        pulls = np.zeros((keys.size, size))
        for k, points in enumerate(planes):
            part = noise[k][kind]
            if part.sigma <= 0:
                continue
            single = _influence(surface, points, k) * (part.sigma / points.sigma)[:, None]
            pulls += (keys[:, None] == part.line[None, :]).astype(float) @ single
            added -= single.T @ single
        added += pulls.T @ pulls
    extra = surface.covariance @ added @ surface.covariance
    return replace(surface, covariance=surface.covariance + (extra + extra.T) / 2)


def _influence(surface: Surface, points: Points, plane: int) -> Float:
    """Weighted design in the numbering of all parameters, (points, parameters)."""
    matrix = design(points, surface.geometry, surface.coefficients[plane], surface.radial).T
    size = surface.covariance.shape[0]
    out = np.zeros((points.value.size, size))
    used = np.flatnonzero(surface.places[plane] >= 0)
    out[:, surface.places[plane][used]] = matrix[:, used]
    for j in surface.free:
        out[:, size - 4 + j] = matrix[:, surface.radial.count + j]
    return out
