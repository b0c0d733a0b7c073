"""Ray-transfer lenses from tables of input and output rays: degree by hold-out error, pass region per field height."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isetval.core.errors import InputError
from isetval.lens.pass_region import ConvexRegion, EllipseRegion, PassRegion
from isetval.lens.polynomials import OUTPUTS, FloatArray, IntArray, OutputPolynomial, RayPolynomials, full_terms
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.tracing import WavelengthTable

SYMMETRIES = ("rotational", "mirror", "none")
MAX_HEIGHTS = 120
ROUNDING = 1e-9  # relative hold-out error below which a higher degree only fits rounding
RIM_AZIMUTHS = 120


@dataclass(frozen=True, eq=False)
class RayTable:
    """Rays that pass a lens, from the input plane to the output plane, at one wavelength.

    Attributes
    ----------
    point_mm, direction : (2, n)
        x, y and dx, dy on the input plane.
    out_point_mm, out_direction : (3, n)
        On the output side; z from the rear vertex towards the scene, dz > 0.
    wavelength_nm : float
    """

    point_mm: FloatArray
    direction: FloatArray
    out_point_mm: FloatArray
    out_direction: FloatArray
    wavelength_nm: float = 550.0

    def __post_init__(self) -> None:
        n = self.point_mm.shape[-1]
        shapes = [self.point_mm.shape, self.direction.shape, self.out_point_mm.shape, self.out_direction.shape]
        if shapes != [(2, n), (2, n), (3, n), (3, n)]:
            raise InputError(f"ray table: shapes {shapes}; (2, n), (2, n), (3, n), (3, n) are needed")

    def usable(self) -> RayTable:
        """Without blocked rays (any value not finite)."""
        every = np.vstack([self.point_mm, self.direction, self.out_point_mm, self.out_direction])
        keep = np.isfinite(every).all(axis=0)
        return replace(
            self,
            point_mm=self.point_mm[:, keep],
            direction=self.direction[:, keep],
            out_point_mm=self.out_point_mm[:, keep],
            out_direction=self.out_direction[:, keep],
        )


@dataclass(frozen=True, eq=False)
class LensFit:
    """A fitted lens and how good it is.

    Attributes
    ----------
    lens : RayTransferLens
    degree : int
        The chosen degree.
    holdout : dict
        Degree -> (rms position error in um, rms direction error in mrad) on rays that the fit did not use.
    rays_fitted, rays_held_out : int
    """

    lens: RayTransferLens
    degree: int
    holdout: dict[int, tuple[float, float]]
    rays_fitted: int
    rays_held_out: int


def from_rays(
    rays: RayTable,
    *,
    name: str,
    thickness_mm: float,
    plane_offset_input_mm: float,
    plane_offset_output_mm: float,
    plane_distance_mm: float,
    degrees: Sequence[int] = (3, 4, 5, 6, 7, 8, 9),
    symmetry: str = "rotational",
    region: str | PassRegion = "ellipse",
    holdout_fraction: float = 0.2,
    improvement: float = 0.02,
    description: str = "",
    seed: int = 0,
) -> LensFit:
    """Fit a ray-transfer lens to rays.

    Parameters
    ----------
    rays : RayTable
        Rays from the input plane; blocked ones may be present as NaN outputs.
    name, thickness_mm, plane_offset_input_mm, plane_offset_output_mm, description
        As in `RayTransferLens`.
    plane_distance_mm : float
        Distance from the input plane to the ray-pass plane; the exit pupil is a good choice.
    degrees : sequence of int
        Degrees to try, ascending.
    symmetry : {"rotational", "mirror", "none"}
        Terms kept: of a rotationally symmetric lens; even under x -> -x; all.
    region : {"ellipse", "rim"} or PassRegion
        Minimum-area ellipse, or the convex outline, of the passing rays per field height; or a known region.
    holdout_fraction : float
        Share of the rays kept out of the fit that chooses the degree; the final fit uses all.
    improvement : float
        A higher degree must lower the hold-out error by this fraction.
    seed : int
        For the choice of held-out rays.

    Raises
    ------
    InputError
        Too few rays, or no degree that the rays can determine.
    """
    if symmetry not in SYMMETRIES:
        raise InputError(f"symmetry '{symmetry}' is unknown; choose one of {', '.join(SYMMETRIES)}")
    table = rays.usable()
    inputs, outputs = _meridional(table)
    held = np.asarray(np.random.default_rng(seed).random(inputs.shape[1]) < holdout_fraction)
    if held.sum() < 10 or (~held).sum() < 50:
        raise InputError(f"{inputs.shape[1]} usable rays; a few hundred over field and pupil are needed to fit a lens")
    errors, scores = {}, {}
    for degree in degrees:
        if (~held).sum() < 2 * len(_terms(degree, symmetry, "outy")):
            continue
        fitted = _fit(inputs[:, ~held], outputs[:, ~held], degree, symmetry)
        errors[degree], scores[degree] = _holdout_error(fitted, inputs[:, held], outputs[:, held])
    if not errors:
        raise InputError(f"{(~held).sum()} rays cannot determine degree {min(degrees)}; give more rays")
    chosen = _choose(scores, improvement)
    passing = _region(inputs, plane_distance_mm, region) if isinstance(region, str) else region
    lens = RayTransferLens(
        name=name,
        description=description,
        thickness_mm=thickness_mm,
        plane_offset_input_mm=plane_offset_input_mm,
        plane_offset_output_mm=plane_offset_output_mm,
        tables=(WavelengthTable(table.wavelength_nm, passing, _fit(inputs, outputs, chosen, symmetry)),),
    )
    return LensFit(lens, chosen, errors, int((~held).sum()), int(held.sum()))


def _meridional(table: RayTable) -> tuple[FloatArray, FloatArray]:
    """Rays rotated so that the input point lies on +y: (r, dx, dy) (3, n) and the six outputs (6, n)."""
    x, y = table.point_mm
    r = np.hypot(x, y)
    safe = np.where(r > 0, r, 1.0)
    sin_g, cos_g = np.where(r > 0, x / safe, 0.0), np.where(r > 0, y / safe, 1.0)

    def turn(v: FloatArray) -> tuple[FloatArray, FloatArray]:
        return v[0] * cos_g - v[1] * sin_g, v[0] * sin_g + v[1] * cos_g

    out_x, out_y = turn(table.out_point_mm)
    out_dx, out_dy = turn(table.out_direction)
    inputs = np.stack([r, *turn(table.direction)])
    return inputs, np.stack([out_x, out_y, table.out_point_mm[2], out_dx, out_dy, table.out_direction[2]])


def _terms(degree: int, symmetry: str, output: str) -> IntArray:
    """Powers of (r, dx, dy) that the symmetry allows for an output.

    Mirror symmetry: outx and outdx are odd in dx, the others even.  Rotation by 180 degrees in addition
    makes the transverse outputs odd in all three together and the longitudinal ones even.
    """
    terms = full_terms(degree)
    if symmetry == "none":
        return terms
    terms = terms[terms[:, 1] % 2 == int(output in ("outx", "outdx"))]
    if symmetry == "rotational":
        terms = terms[terms.sum(axis=1) % 2 == int(output not in ("outz", "outdz"))]
    kept: IntArray = terms
    return kept


def _fit(inputs: FloatArray, outputs: FloatArray, degree: int, symmetry: str) -> RayPolynomials:
    """Least squares for all six outputs, with scaled variables."""
    scale = np.abs(inputs).max(axis=1)
    scale[scale == 0] = 1.0
    scaled = inputs / scale[:, None]
    powers = [np.cumprod(np.vstack([np.ones_like(v), np.tile(v, (degree, 1))]), axis=0) for v in scaled]
    fitted: dict[str, OutputPolynomial] = {}
    solved: dict[bytes, tuple[IntArray, FloatArray, list[int]]] = {}
    for row, name in enumerate(OUTPUTS):
        if name == "outz" and np.ptp(outputs[row]) < 1e-9:
            fitted[name] = OutputPolynomial(np.zeros((1, 3), dtype=np.int64), np.array([outputs[row].mean()]))
            continue
        terms = _terms(degree, symmetry, name)
        design = (powers[0][terms[:, 0]] * powers[1][terms[:, 1]] * powers[2][terms[:, 2]]).T
        solved.setdefault(terms.tobytes(), (terms, design, []))[2].append(row)
    for terms, design, rows in solved.values():
        solution = np.linalg.lstsq(design, outputs[rows].T, rcond=1e-13)[0]
        for column, row in enumerate(rows):
            fitted[OUTPUTS[row]] = OutputPolynomial(terms, solution[:, column] / (scale**terms).prod(axis=1))
    return RayPolynomials(fitted)


def _holdout_error(p: RayPolynomials, inputs: FloatArray, outputs: FloatArray) -> tuple[tuple[float, float], float]:
    """Root-mean-square position (um) and direction (mrad) errors, and their mean relative to the outputs' spread."""
    miss = p.transverse.evaluate(*inputs) - outputs[[0, 1, 3, 4]]
    rms = np.sqrt((miss**2).mean(axis=1))
    spread = outputs[[0, 1, 3, 4]].std(axis=1)
    relative = float(np.sqrt(((rms / np.where(spread > 0, spread, 1.0)) ** 2).mean()))
    return (float(np.hypot(rms[0], rms[1])) * 1e3, float(np.hypot(rms[2], rms[3])) * 1e3), relative


def _choose(scores: dict[int, float], improvement: float) -> int:
    """The lowest degree that no higher degree beats by the wanted fraction."""
    best = min(scores)
    for degree in sorted(scores):
        if scores[best] > ROUNDING and scores[degree] < scores[best] * (1 - improvement):
            best = degree
    return best


def _region(inputs: FloatArray, plane_distance_mm: float, kind: str) -> PassRegion:
    """Pass region of the rays, from their crossings of the ray-pass plane per field height."""
    if kind not in ("ellipse", "rim"):
        raise InputError(f"pass region '{kind}' is unknown; choose ellipse or rim")
    r, dx, dy = inputs
    slope = plane_distance_mm / np.sqrt(1 - dx**2 - dy**2)
    crossing = np.stack([dx * slope, r + dy * slope])
    positions, member = _field_groups(r)
    groups = [crossing[:, member == i] for i in range(len(positions))]
    groups = [np.hstack([g, g * np.array([[-1.0], [1.0]])]) for g in groups]
    if kind == "rim":
        outlines = [convex_rim(g) for g in groups]
        centers = np.array([c for c, _ in outlines])
        return ConvexRegion(positions, centers, np.array([rim for _, rim in outlines]), plane_distance_mm)
    ellipses = [minimum_ellipse(g) for g in groups]
    centers, radii = np.array([c for c, _ in ellipses]), np.array([a for _, a in ellipses])
    return EllipseRegion(positions, centers, radii, plane_distance_mm)


def _field_groups(r: FloatArray) -> tuple[FloatArray, IntArray]:
    """Field heights with enough rays, and each ray's group; scattered heights are binned."""
    heights, member = np.unique(np.round(r, 6), return_inverse=True)
    if len(heights) <= MAX_HEIGHTS:
        return heights, member.astype(np.int64)
    edges = np.linspace(r.min(), r.max(), 52)
    member = np.clip(np.searchsorted(edges, r, side="right") - 1, 0, 50).astype(np.int64)
    counts = np.bincount(member, minlength=51)
    if counts.min() < 12:
        raise InputError(f"only {counts.min()} rays in one of 51 field-height bins; at least 12 are needed for a pass region")
    return np.bincount(member, weights=r, minlength=51) / counts, member


def minimum_ellipse(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimum-area ellipse around points (2, n) that are symmetric about x = 0: center (2,), semi-axes (2,).

    Such an ellipse has its axes along x and y and its center on x = 0 (it is unique, so it shares the
    symmetry).  For a ratio k of its axes and a center y0 the least y-axis is max sqrt((x/k)^2 + (y - y0)^2);
    its area is convex in both, and two nested searches find the minimum.
    """
    hull = _hull(points)
    x2, y = hull[0] ** 2, hull[1]

    def axis(k: float, center: float) -> float:
        return float(np.sqrt((x2 / k**2 + (y - center) ** 2).max()))

    def best_center(k: float) -> float:
        return _minimum(lambda center: axis(k, center), float(y.min()), float(y.max()))

    aspect = np.sqrt(x2.max()) / (np.ptp(y) / 2)
    log_k = _minimum(lambda t: t + 2 * np.log(axis(np.exp(t), best_center(np.exp(t)))), np.log(aspect) - 1, np.log(aspect) + 1)
    k = float(np.exp(log_k))
    center = best_center(k)
    semi_y = axis(k, center)
    return np.array([0.0, center]), np.array([k * semi_y, semi_y])


def _minimum(function: Callable[[float], float], low: float, high: float) -> float:
    """Place of the least value of a convex function between two ends (Brent's method)."""
    from scipy.optimize import minimize_scalar

    return float(minimize_scalar(function, bounds=(low, high), method="bounded", options={"xatol": 1e-12}).x)


def _hull(points: FloatArray) -> FloatArray:
    """Vertices of the convex hull, (2, m), counter-clockwise."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points.T)
    except (QhullError, ValueError):
        raise InputError(f"{points.shape[1]} rays at one field height span no area on the ray-pass plane") from None
    return np.ascontiguousarray(points[:, hull.vertices])


def convex_rim(points: FloatArray, azimuths: int = RIM_AZIMUTHS) -> tuple[FloatArray, FloatArray]:
    """Convex outline of points (2, n): middle of the extent (2,), rim distance per azimuth (azimuths,)."""
    hull = _hull(points)
    center = (hull.max(axis=1) + hull.min(axis=1)) / 2
    a = hull - center[:, None]
    b = np.roll(a, -1, axis=1)
    normal = np.stack([b[1] - a[1], a[0] - b[0]])
    distance = (normal * a).sum(axis=0)
    angle = np.arange(azimuths) * (2 * np.pi / azimuths)
    toward = normal.T @ np.stack([np.cos(angle), np.sin(angle)])
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(toward > 1e-15, distance[:, None] / toward, np.inf)
    return center, reach.min(axis=0)
