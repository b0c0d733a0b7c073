"""The photon-transfer curve: weighted fits of temporal variance against mean, and the choice between them.

    line        V = V0 + K m
    quadratic   V = V0 + K m + c m^2            brighter-fatter, or a non-linear response
    cubic       V = V0 + K m + c m^2 + d m^3
    straight    V = V0 + K L R'(L)^2            response m = R(L) known from exposure times
    straight2   the same + c L^2                brighter-fatter on top

Weights come from the fitted variance itself (2 V^2 / dof), not from the scatter of each point.

The fits are averaged by their evidence.  A straight curve is taken as one whose c is small: c ~ N(0, SMALL_BEND_PER_E^2),
the size that charge repulsion has in silicon (Astier et al. 2019 and others: 1e-6 to 3e-6 per electron); a bent one has c
up to WIDE_BEND / (electrons at full scale).  So a quadratic term enters as far as the data demand it, a small one
is neither ignored nor fitted at full price, and the sigma covers that choice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.quantity import Quantity
from isetval.measure.noise.linearity import Response

Float = NDArray[np.float64]
# 68 % intervals then hold 66 to 70 % for bends of 0 to 2e-6 per electron, 60 to 65 % for two to four times the prior's width
SIGMA_FACTOR = 0.955
SMALL_BEND_PER_E = 2.5e-6  # Astier et al. (2019) and others: 1e-6 to 3e-6 per electron in silicon
WIDE_BEND = 0.2  # of the linear variance at full scale: a response that bends by more saturates
CUBIC_PENALTY = 10.0  # in chi2 that the third power must gain over the second: only where that plainly fails
FREE = {"line": "quadratic", "straight": "straight2"}


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a photon-transfer curve, one per light level, (levels,) each.

    ``mean_dn`` above the measured black; ``spread_dn2`` is the spatial variance of the light over the region,
    ``variance_dn2`` the temporal variance; ``dof`` its degrees of freedom for normal noise; ``sampled_dn4`` the sampling
    variance of ``variance_dn2`` where it is known otherwise (rounded levels), else nan.  ``scatter`` is a relative
    standard deviation of all variances beyond that.
    """

    mean_dn: Float
    spread_dn2: Float
    variance_dn2: Float
    dof: Float
    pixels: Float
    sampled_dn4: Float
    scatter: float = 0.0

    def take(self, index: Any) -> Points:
        """The points with this index or mask."""
        arrays = {n: v[index] for n, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)

    def scattered(self, scatter: float) -> Points:
        """The points with a relative standard deviation of the variance on top of sampling."""
        return replace(self, scatter=scatter)


@dataclass(frozen=True)
class Anchor:
    """Dark temporal variance at zero signal (value, sigma in DN^2) and the sigma of the black level in DN."""

    variance_dn2: float
    sigma_dn2: float
    black_sigma_dn: float


@dataclass(frozen=True, eq=False)
class Fit:
    """One weighted fit; ``coefficients`` (V0, K, c, d) as far as the model has them."""

    name: str
    coefficients: Float
    covariance: Float
    chi2: float
    dof: int
    residuals: Float

    @property
    def gain(self) -> float:
        """K in DN/e-."""
        return float(self.coefficients[1])


@dataclass(frozen=True, eq=False)
class CurveFit:
    """Averaged photon-transfer fit; ``weights`` by model name add to one, ``joint`` is the covariance of intercept and gain."""

    gain: float
    gain_sigma: float
    intercept: float
    intercept_sigma: float
    quadratic: float
    quadratic_sigma: float
    chi2: float
    dof: int
    weights: Mapping[str, float]
    fits: Mapping[str, Fit] = field(default_factory=dict)
    joint: float = 0.0


def fit_curve(
    points: Points,
    anchor: Anchor | None,
    *,
    full_scale_dn: float = 0.0,
    response: Response | None = None,
    weights: Mapping[str, float] | None = None,
) -> CurveFit:
    """Fit all models that the number of levels allows, and average them.

    Parameters
    ----------
    points : Points
        Levels below saturation.
    anchor : Anchor or None
        Dark variance; without it the intercept is free.
    full_scale_dn : float
        White less black: a series of low levels cannot bend as a whole range may.  0: the highest level.
    response : Response, optional
        Enables the straightened models.
    weights : mapping, optional
        Model weights of an earlier fit, used as they are (no choice from these data).
    """
    wanted = None if weights is None else {n for n, w in weights.items() if w > 1e-4}
    fits = {f.name: f for f in _candidates(points, anchor, response, wanted)}
    members = _members(fits, max(full_scale_dn, float(points.mean_dn.max())))
    if weights is None:
        best = min(score for _, score in members.values())
        raw = {n: math.exp(-(score - best) / 2) for n, (_, score) in members.items()}
    else:
        raw = {n: weights.get(n, 0.0) for n in members}
        if not sum(raw.values()) > 0:
            raw = {n: float(n == "line") for n in members}
    total = sum(raw.values())
    share = {n: w / total for n, w in raw.items()}

    def average(column: int) -> tuple[float, float]:
        there = {n: f for n, (f, _) in members.items() if f.coefficients.size > column}
        values = {n: float(there[n].coefficients[column]) if n in there else 0.0 for n in members}
        variances = {n: float(there[n].covariance[column, column]) if n in there else 0.0 for n in members}
        mean = sum(share[n] * values[n] for n in members)
        spread = sum(share[n] * (variances[n] + (values[n] - mean) ** 2) for n in members)
        return mean, SIGMA_FACTOR * math.sqrt(spread) if len(members) > 1 else math.sqrt(spread)

    (intercept, intercept_sigma), (gain, gain_sigma), (quadratic, quadratic_sigma) = average(0), average(1), average(2)
    top = members[max(share, key=lambda n: share[n])][0]
    joint = sum(share[n] * float(f.covariance[0, 1]) for n, (f, _) in members.items())
    numbers = (gain, gain_sigma, intercept, intercept_sigma, quadratic, quadratic_sigma)
    return CurveFit(*numbers, top.chi2, top.dof, share, fits, joint)


def _members(fits: Mapping[str, Fit], top_dn: float) -> dict[str, tuple[Fit, float]]:
    """What is averaged: fits with a prior on c where they have one, and minus twice the logarithm of their evidence."""
    out: dict[str, tuple[Fit, float]] = {}
    for name, fit in fits.items():
        free = fits.get(FREE.get(name, name), fit)
        if free.coefficients.size < 3:
            out[name] = (fit, fit.chi2)
            continue
        electrons = top_dn / max(free.gain, 1e-9)
        wide = max(WIDE_BEND / electrons, SMALL_BEND_PER_E)
        out[name] = _with_prior(fit, free, SMALL_BEND_PER_E if name in FREE else wide)
    if "cubic" in out:
        out["cubic"] = (fits["cubic"], out["cubic"][1] + CUBIC_PENALTY)
    return out


def _with_prior(fit: Fit, free: Fit, width: float) -> tuple[Fit, float]:
    """``free`` under c ~ N(0, width^2), with the residuals of ``fit``, and -2 ln of the evidence."""
    bend, along = float(free.coefficients[2]), free.covariance[:, 2]
    total = float(along[2]) + width**2
    coefficients = free.coefficients - along * (bend / total)
    covariance = free.covariance - np.outer(along, along) / total
    score = free.chi2 + bend**2 / total + math.log(total / max(float(along[2]), 1e-300))
    return Fit(fit.name, coefficients, covariance, fit.chi2, fit.dof, fit.residuals), score


def _candidates(points: Points, anchor: Anchor | None, response: Response | None, wanted: set[str] | None) -> list[Fit]:
    """The fits that the number of levels allows, of the ``wanted`` names if given (a line if none of those can be made)."""

    def asked(name: str) -> bool:
        return wanted is None or name in wanted or any(FREE.get(w) == name for w in wanted)

    m, spread = points.mean_dn, points.spread_dn2
    square, cube = m**2 + spread, m**3 + 3 * m * spread
    levels = m.size
    out = [_fit("line", [m], points, anchor)] if asked("line") else []
    if asked("quadratic") and levels >= 3 + (anchor is None):
        out.append(_fit("quadratic", [m, square], points, anchor))
    if asked("cubic") and levels >= 6:
        out.append(_fit("cubic", [m, square, cube], points, anchor))
    if response is not None:
        if asked("straight"):
            out.append(_straightened("straight", points, anchor, response, 0))
        if asked("straight2") and levels >= 4:
            out.append(_straightened("straight2", points, anchor, response, 1))
    return out or [_fit("line", [m], points, anchor)]


def _straightened(name: str, points: Points, anchor: Anchor | None, response: Response, terms: int) -> Fit:
    def fit(model: Response) -> Fit:
        linear = model.linear(points.mean_dn)
        columns = [linear * model.slope(linear) ** 2, linear**2][: 1 + terms]
        return _fit(name, columns, points, anchor)

    best = fit(response)
    jacobian = []
    for index in range(2):
        step = 1e-3
        moved = fit(response.shifted(index, step))
        jacobian.append((moved.coefficients - best.coefficients) / step)
    j = np.stack(jacobian, axis=1)
    covariance = best.covariance + j @ response.covariance @ j.T
    return Fit(name, best.coefficients, covariance, best.chi2, best.dof, best.residuals)


def _fit(name: str, columns: list[Float], points: Points, anchor: Anchor | None) -> Fit:
    """Weighted least squares, weights from the model's own variance, iterated."""
    design = np.column_stack([np.ones_like(columns[0]), *columns])
    target = points.variance_dn2
    rows, values = design, target
    if anchor is not None:
        rows, values = np.vstack([design, np.eye(design.shape[1])[0]]), np.append(target, anchor.variance_dn2)
    model = np.maximum(target, 0.05)
    coefficients = np.zeros(design.shape[1])
    tiny = 1e-13 * np.eye(coefficients.size)
    for _ in range(5):
        slope = max(float(coefficients[1]), 0.0)
        errors = np.sqrt(point_variance(points, model, slope))
        if anchor is not None:
            errors = np.append(errors, max(math.hypot(anchor.sigma_dn2, slope * anchor.black_sigma_dn), 1e-12))
        scaled = rows / errors[:, None]
        scale = np.sqrt((scaled**2).sum(axis=0))
        scaled /= scale
        inverse = np.linalg.inv(scaled.T @ scaled + tiny)
        coefficients = inverse @ (scaled.T @ (values / errors)) / scale
        model = np.maximum(design @ coefficients, 0.02 * target + 1e-6)
    residual = (values - rows @ coefficients) / errors
    covariance = inverse / np.outer(scale, scale)
    return Fit(name, coefficients, covariance, float(residual @ residual), int(values.size - coefficients.size), residual)


def point_variance(points: Points, model: Float, slope: float) -> Float:
    """Sampling variance of V - K m at each level, (levels,), DN^4.

    2 <V^2> / dof for normal noise with the light's spread over the region; the excess of Poisson noise in V,
    in m and in their covariance cancels except for K^2 (V - K m) / pixels.
    """
    uneven = 1 + slope**2 * points.spread_dn2 / np.maximum(model, 1e-6) ** 2
    rest = np.clip(model - slope * points.mean_dn, 0.0, model)
    normal = 2 * model**2 * uneven / points.dof + slope**2 * rest / points.pixels
    sampled = np.where(np.isfinite(points.sampled_dn4), points.sampled_dn4, normal)
    return np.asarray(sampled + (points.scatter * model) ** 2)


def is_poor(fit: CurveFit) -> bool:
    """Whether chi2 is more than four sd above its degrees of freedom."""
    return fit.chi2 > fit.dof + 4 * math.sqrt(2 * max(fit.dof, 1))


def bend_coefficient(fit: CurveFit, *, straightened: bool) -> Quantity:
    """Coefficient c of the quadratic fit, or of the straightened one where the response is known; never averaged."""
    best = fit.fits.get("straight2" if straightened else "quadratic", fit.fits.get("quadratic"))
    if best is None:
        return Quantity(fit.quadratic, fit.quadratic_sigma)
    return Quantity(float(best.coefficients[2]), math.sqrt(float(best.covariance[2, 2])))
