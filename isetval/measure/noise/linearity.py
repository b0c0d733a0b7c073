"""Response of the mean: digital numbers against exposure, which is a time under steady light or a stated number of photons.

    m = L (1 + a x + b x^2),  L = s (t - t0),  x = L / L_top

The offset t0 is where the light, or the exposure, begins: a lamp that comes on late, a shutter that closes late, charge that
is collected during transfer.  It is looked for in the means and taken only where they demand it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.quantity import Quantity

Float = NDArray[np.float64]
LEAST_LEVELS = 5  # two powers, a scale and an offset leave one to check them by
CLEAR_SD = 4.0  # a bend of the response that stands out by less changes K by less than its own sigma
OFFSET_SD = 5.0  # an offset moves the low levels most, where little else tells of it: asked for more than a bend
OFFSET_GAIN = 16.0  # by which its criterion must win: four sd again, in units of chi2
OFFSET_SCATTER = 0.02  # relative: means that scatter more about the fit were not taken under one steady light
LIT_SHARE = 2e-3  # of the highest mean: levels below may lie before the light began
LEAST_SLOPE = 0.2  # of a response against its start: flatter is saturation, and the inverse is not defined
Polynomial = tuple[float, list[int], Float, Float, float]
TERMS: tuple[tuple[int, ...], ...] = ((), (1,), (2,), (1, 2))


@dataclass(frozen=True, eq=False)
class Response:
    """m = L (1 + a x + b x^2), x = L / scale: mean signal against linear signal, from exposures."""

    a: float
    b: float
    scale_dn: float
    covariance: Float
    scatter: float
    levels: int

    def linear(self, mean: Float) -> Float:
        """L for a mean, by Newton's method."""
        out = np.array(mean, dtype=float)
        for _ in range(8):
            x = out / self.scale_dn
            value = out * (1 + self.a * x + self.b * x**2)
            out = out - (value - mean) / np.maximum(self.slope(out), 0.05)
        return out

    def slope(self, linear: Float) -> Float:
        """Dm / dL."""
        x = linear / self.scale_dn
        return np.asarray(1 + 2 * self.a * x + 3 * self.b * x**2)

    def shifted(self, index: int, step: float) -> Response:
        """The response with one coefficient moved."""
        a, b = self.a + step * (index == 0), self.b + step * (index == 1)
        return Response(a, b, self.scale_dn, self.covariance, self.scatter, self.levels)

    def can_be_inverted(self) -> bool:
        """Whether the mean rises with the light over the whole range, so that it says how much light there was."""
        x = np.linspace(0.0, 1.05, 43)  # 5 % beyond the highest level: where Newton's steps may look
        return bool(np.min(1 + 2 * self.a * x + 3 * self.b * x**2) > LEAST_SLOPE)


@dataclass(frozen=True, eq=False)
class MeanResponse:
    """What exposures say of the means: ``basis`` in words, exposures of the levels less ``offset``, and the bend if any.

    ``basis`` is ``"exposure times"``, ``"photon numbers"``, or ``"none"``: variance against mean alone.
    """

    basis: str
    exposure: Float
    offset: Quantity
    response: Response | None

    @property
    def known(self) -> bool:
        """Whether the means were checked against exposures: straight if ``response`` is None."""
        return self.basis != "none"

    def rate(self, mean_dn: Float) -> Float:
        """DN per unit of exposure where there is any."""
        return np.asarray(mean_dn[self.exposure > 0] / self.exposure[self.exposure > 0])


NO_RESPONSE = MeanResponse("none", np.empty(0), Quantity(math.nan, math.nan, "s"), None)


def mean_response(
    mean_dn: Float,
    sigma_dn: Float,
    *,
    time_s: Sequence[float | None],
    photons: Sequence[float | None],
    black_sigma_dn: float = 0.0,
) -> MeanResponse:
    """Response of the levels' means to their stated photon numbers, else to their exposure times, else none.

    Parameters
    ----------
    mean_dn, sigma_dn : array (levels,)
        Means above black and their sigma.
    time_s, photons : sequence (levels,)
        Exposure times and photons per pixel; None where unknown: such levels say nothing of the response.
    black_sigma_dn : float
        Sigma of the black level: an offset must stand out of it.
    """
    for basis, unit, stated in (("photon numbers", "photons", photons), ("exposure times", "s", time_s)):
        known = [value for value in stated if value is not None]
        if len(set(known)) != len(known) or len(known) < LEAST_LEVELS:
            continue
        exposure = np.array([math.nan if value is None else value for value in stated], dtype=float)
        offset = exposure_offset(exposure, mean_dn, sigma_dn, black_sigma_dn)
        left = exposure - (offset.value if offset is not None else 0.0)
        lit = left > 0
        if int(lit.sum()) < LEAST_LEVELS:
            continue
        response = fit_response(left[lit], mean_dn[lit], sigma_dn[lit])
        if response is None or response.can_be_inverted():
            found = Quantity(0.0, 0.0) if offset is None else offset
            return MeanResponse(basis, left, Quantity(found.value, found.sigma, unit), response)
    return NO_RESPONSE


def exposure_offset(exposure: Float, mean_dn: Float, sigma_dn: Float, black_sigma_dn: float = 0.0) -> Quantity | None:
    """Exposure at which the means begin to rise, in units of ``exposure``; None where zero will do.

    The means of lit levels are fitted by powers of the exposure up to the third, with and without an intercept, errors from
    sampling and from the scatter of the light; the corrected Akaike criterion chooses.
    """
    lit = (mean_dn > np.maximum(OFFSET_SD * sigma_dn, LIT_SHARE * mean_dn.max())) & (exposure > 0)
    time, mean, sigma = exposure[lit], mean_dn[lit], sigma_dn[lit]
    if np.unique(time).size < LEAST_LEVELS:
        return None
    top = float(time.max())
    relative = np.hypot(sigma / mean, _scatter_floor(mean / time, sigma / mean))
    fits = {start: _best_powers(time / top, mean, relative, start) for start in (0, 1)}
    if fits[0] is None or fits[1] is None:
        return None
    score, powers, theta, covariance, scatter = fits[0]
    intercept, slope = float(theta[0]), float(theta[1])
    doubt = math.hypot(math.sqrt(float(covariance[0, 0])), black_sigma_dn)
    better = fits[1][0] - score > OFFSET_GAIN and abs(intercept) > OFFSET_SD * doubt
    if not better or scatter > OFFSET_SCATTER or not slope > 0:
        return None
    polynomial = np.polynomial.Polynomial(np.bincount(powers, theta))  # of x = exposure over the longest
    start = -intercept / slope
    for _ in range(8):
        start -= float(polynomial(start)) / float(polynomial.deriv()(start))
    if not start < float(np.sort(time)[1]) / top:
        return None
    return Quantity(start * top, doubt / slope * top)


def _best_powers(x: Float, mean: Float, relative: Float, start: int) -> Polynomial | None:
    """Criterion, powers, coefficients, covariance and relative scatter of the best polynomial that begins at power ``start``."""
    best: Polynomial | None = None
    for extra in TERMS:
        powers = [*range(start, 2), *(p + 1 for p in extra)]
        n, k = x.size, len(powers) + 1
        if n - k - 1 < 1:
            continue
        design = np.column_stack([x**p for p in powers]) / (mean * relative)[:, None]
        theta, *_ = np.linalg.lstsq(design, 1 / relative, rcond=None)
        rest = 1 / relative - design @ theta
        square = max(float(rest @ rest), 1e-30)
        score = n * math.log(square / n) + 2 * k * n / (n - k - 1)
        if best is None or score < best[0]:
            wider = max(square / (n - len(powers)), 1.0)
            covariance = np.asarray(np.linalg.pinv(design.T @ design, hermitian=True) * wider, dtype=np.float64)
            best = (
                score,
                powers,
                np.asarray(theta, dtype=np.float64),
                covariance,
                float(np.sqrt(np.mean((rest * relative) ** 2))),
            )
    return best


def fit_response(time_s: Float, mean_dn: Float, sigma_dn: Float) -> Response | None:
    """Response curve from means at known exposures (above zero) under constant light; None where it is straight.

    m / t is fitted by a constant, a constant with x, with x^2, and with both (x = exposure over the longest); the
    corrected Akaike criterion chooses.  Lamp jitter is taken from the scatter.  Returned only where a term
    stands out at four sigma.
    """
    if np.unique(time_s).size < LEAST_LEVELS:
        return None
    rate = mean_dn / time_s
    top = float(time_s.max())
    x = time_s / top
    weight = 1 / np.hypot(sigma_dn / mean_dn, _scatter_floor(rate, sigma_dn / mean_dn)) / rate
    best: tuple[float, Float, Float, tuple[int, ...], float] | None = None
    for powers in TERMS:
        design = np.column_stack([np.ones_like(x), *(x**p for p in powers)]) * weight[:, None]
        normal = np.linalg.pinv(design.T @ design, hermitian=True)
        theta = normal @ (design.T @ (rate * weight))
        rest = rate * weight - design @ theta
        n, k = x.size, len(powers) + 2
        if n - k - 1 < 1:
            continue
        square = max(float(rest @ rest), 1e-30)
        score = n * math.log(square / n) + 2 * k * n / (n - k - 1)
        if best is None or score < best[0]:
            covariance = np.asarray(normal * max(square / (n - k + 1), 1.0), dtype=np.float64)
            best = (score, theta, covariance, powers, math.sqrt(square / (n - k + 1)))
    assert best is not None
    _, theta, covariance, chosen, scatter = best
    ratio = theta[1:] / theta[0]
    error = np.sqrt(np.diag(covariance))[1:] / theta[0]
    if not chosen or not np.any(np.abs(ratio) > CLEAR_SD * error):
        return None
    values, spread = np.zeros(2), np.zeros((2, 2))
    index = [p - 1 for p in chosen]
    values[index] = ratio
    spread[np.ix_(index, index)] = covariance[1:, 1:] / theta[0] ** 2
    return Response(float(values[0]), float(values[1]), float(theta[0] * top), spread, scatter, int(x.size))


def _scatter_floor(rate: Float, sigma: Float) -> float:
    """Relative jitter of neighboring levels beyond their sampling noise (second differences)."""
    steps = np.diff(rate, 2) / rate[1:-1]
    noise = (sigma[:-2] ** 2 + 4 * sigma[1:-1] ** 2 + sigma[2:] ** 2) / 6
    # the median of a squared normal number is .455 of its mean; (1, -2, 1) have squares that add to 6
    found = float(np.median(steps**2)) / 0.455 / 6
    return math.sqrt(max(found - float(np.median(noise)), 1e-10))


def nonlinearity(response: MeanResponse, mean_dn: Float) -> Quantity:
    """M / L - 1 at the highest mean; 0 with the scatter where the means are straight, nan where exposures are unknown."""
    if not response.known:
        return Quantity(math.nan, math.nan)
    if response.response is None:
        rate = response.rate(mean_dn)
        return Quantity(0.0, float(np.std(rate, ddof=1) / np.mean(rate)))
    bend = response.response
    top = float(bend.linear(mean_dn[-1:])[0]) / bend.scale_dn
    powers = np.array([top, top**2])
    value = float(powers @ np.array([bend.a, bend.b]))
    return Quantity(value, float(math.sqrt(max(powers @ bend.covariance @ powers, 0.0))))


def quantum_efficiency(response: MeanResponse, mean_dn: Float, gain: Quantity, photons: Sequence[float | None] = ()) -> Quantity:
    """Electrons per photon, %: rate of the straightened means over stated photons, over K; nan without photons.

    Where the means were not held against the photons (fewer than `LEAST_LEVELS`, or two levels of one number), they are taken
    to be straight; the scatter of the rates, which a bend adds to, is the error.
    """
    if response.basis == "photon numbers":
        linear = mean_dn if response.response is None else response.response.linear(mean_dn)
        stated = response.exposure
    else:
        linear, stated = mean_dn, np.array([value or 0.0 for value in photons] or np.zeros(mean_dn.size))
    lit = stated > 0
    if lit.sum() < 2:  # one rate has no scatter, and a number without sigma does not exist
        return Quantity(math.nan, math.nan, "%")
    rate = linear[lit] / stated[lit]
    value = float(np.average(rate, weights=stated[lit]))
    error = float(np.std(rate, ddof=1)) / math.sqrt(rate.size)
    return Quantity(100 * value, 100 * error, "%").over(gain, "%")
