"""Overshoot and SFR that no sharpening explains: lines, gaps and double edges that look like one edge.

Light adds up: behind a lens the ESF rises everywhere and the SFR stays below 1.  What goes beyond was sharpened.  An
unsharp mask of amount a, e + a (e - g * e) with a kernel g of unit area that is nowhere negative, takes a sharp edge
beyond its levels by at most a/2 of the step, alike on both sides, and multiplies the SFR by at most 1 + a (1 - G(f)).
A line of width w and height h beside a step S adds h times the difference of two edges: its line spread integrates to
0, the SFR grows like |S + 2 i h sin(pi f w)| / S without bound as S falls, and the ESF goes out on one side only.
Two edges w apart multiply the SFR by |cos(pi f w)|, which comes back to 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import spectrum
from isetval.measure.edge.alternating_fit import FittedEdges
from isetval.measure.edge.esf_fit import EsfFit, solve_lower
from isetval.measure.edge.esf_prior import level_columns, level_places
from isetval.measure.edge.spline_bins import knots, spline_matrix

Float = NDArray[np.floating[Any]]

# Amounts are stated as 0.5 to 1.5 in ordinary use and up to about 2 (manuals of Hugo and EBImageExtra; Adobe's scale ends at 5)
MAX_AMOUNT = 2.0
MAX_OVERSHOOT = MAX_AMOUNT / 2  # of the step: half of the amount, for a sharp edge and a wide kernel
MAX_SFR = 1 + MAX_AMOUNT  # where the kernel passes nothing
# Below this the sides are not compared: unsharpened edges of a real frame (16 in the Canon's) go out by .07 at most
ONE_SIDED_FROM = 0.15
# Sharpened edges have .36 or more (4 blurs, 3 amounts, 3 radii, linear and encoded), lines .1 or less
ONE_SIDED_RATIO = 0.2
LEAST_ROOM = 0.05  # dark level in steps (20 : 1): an undershoot cut off at zero below it is too small to be seen in the ESF
ENCODING = 1 / 2.2  # exponent of rendered images: sharpened there, the sides are alike there
# Largest return of a blur's MTF from its zero: disc .132, straight motion .217, vibration -min J0 = .403
MAX_RETURN = 0.403
FALLEN = 0.2  # the SFR must have fallen below this before its return counts
SIGMAS = 3.0  # of the noise of these numbers on top of the bounds


@dataclass(frozen=True, eq=False)
class Excursions:
    """How far the ESFs go beyond the dark (``under``) and the bright level (``over``), in steps, and where, in widths.

    Arrays (regions,).
    """

    under: Float
    over: Float
    under_at: Float
    over_at: Float


def excursions(fitted: FittedEdges) -> Excursions:
    """Largest excursions of the ESFs within the regions, without the shading."""
    fits, (z, splines) = fitted.fits, _esf_grid()
    level = fits.coefficients[:, level_places()] @ splines.T
    level -= fits.dark[:, None]
    level /= fits.step[:, None]
    low, high = (part[:, None] / fits.width_px[:, None] for part in fitted.reach_px)
    level[(z < low) | (z > high)] = 0.5
    lowest, highest = level.argmin(axis=1), level.argmax(axis=1)
    rows = np.arange(len(level))
    return Excursions(-level[rows, lowest], level[rows, highest] - 1, z[lowest], z[highest])


@lru_cache(maxsize=1)
def _esf_grid() -> tuple[Float, Float]:
    """Four points in every knot interval, in units of the width, and the model's level columns there."""
    z = knots()
    points = (z[:-1, None] + np.diff(z)[:, None] * np.arange(4) / 4).ravel()
    return points, spline_matrix(points) @ level_columns()


def unexplained(fitted: FittedEdges, i: int, seen: Excursions, curve: Float) -> dict[str, str]:
    """Codes ``overshoot`` and ``two_edges`` with sentences where region ``i`` shows what no sharpening explains.

    ``curve`` is its SFR at the default frequencies.
    """
    frequency = spectrum.default_frequency()
    frequency, curve = frequency[frequency <= 0.5], curve[frequency <= 0.5]
    under, over = float(seen.under[i]), float(seen.over[i])
    top, found = int(np.argmax(curve)), []
    if max(under, over) > ONE_SIDED_FROM:
        found.append(_beyond(under, over, fitted.fits.one(i), at=(float(seen.under_at[i]), float(seen.over_at[i]))))
    if curve[top] > MAX_SFR and curve[top] > MAX_SFR + SIGMAS * _sfr_sigma(fitted.fits.one(i), frequency[top]):
        found.append(f"the SFR reaches {curve[top]:.2f} at {frequency[top]:.2f} cy/px (sharpening explains up to {MAX_SFR:g})")
    words = "; ".join(part for part in found if part)
    flags = (
        {"overshoot": words + "; a line or a gap, or sharpened beyond use: choose a region with a single edge"} if words else {}
    )
    back = _return(fitted, i, frequency, curve, sharpened=2 * max(over, under, 0.0))
    return flags | ({"two_edges": back} if back else {})


def _level_sigma(fit: EsfFit, rows: Float) -> Float:
    """Standard deviations, DN, of linear functions of the level columns."""
    full = np.zeros((len(rows), len(fit.coefficients)))
    full[:, level_places()] = rows
    half = solve_lower(fit.lower, (full * fit.mode_root).T)
    return np.asarray(np.sqrt((half * half).sum(axis=0)))


def _sfr_sigma(fit: EsfFit, frequency: float) -> float:
    gradient = spectrum.mtf_gradient(fit, np.array([frequency]))
    return float(np.sqrt(spectrum.gradient_variance(fit, gradient)[0]))


def _beyond(under: float, over: float, fit: EsfFit, *, at: tuple[float, float]) -> str | None:
    """Words for an excursion that is too large, or on one side only; ``at`` are the places of both in widths."""
    bright_side = over >= under
    large, small = (over, under) if bright_side else (under, over)
    sigmas = _level_sigma(fit, spline_matrix(np.array(at)) @ level_columns()) / abs(fit.step)
    sigma, other = sigmas[::-1] if bright_side else sigmas
    where = "above the bright level" if bright_side else "below the dark level"
    encoded = _encoded(under, over, fit)
    amount = min(large, max(encoded))
    if amount > MAX_OVERSHOOT + SIGMAS * sigma:
        return f"the ESF goes {100 * large:.0f} % of the step {where} (sharpening explains up to {100 * MAX_OVERSHOOT:.0f} %)"
    room = fit.dark / fit.step if bright_side else np.inf  # an undershoot ends at zero
    least = min(ONE_SIDED_RATIO * large, room / 2)
    alike = min(encoded) > ONE_SIDED_RATIO * max(encoded)
    if room > LEAST_ROOM and large > ONE_SIDED_FROM + SIGMAS * sigma and small + SIGMAS * other < least and not alike:
        return (
            f"the ESF goes {100 * large:.0f} % of the step {where} and {100 * max(small, 0.0):.0f} % beyond the other one "
            f"(sharpening acts on both sides: at least {100 * least:.0f} %)"
        )
    return None


def _encoded(under: float, over: float, fit: EsfFit) -> tuple[float, float]:
    """Excursions below and above in steps of the encoded levels."""
    levels = fit.dark + fit.step * np.array([-under, 0.0, 1.0, 1.0 + over])
    lowest, dark, bright, highest = np.maximum(levels, 0.0) ** ENCODING
    step = max(float(bright - dark), 1e-12)
    return float(dark - lowest) / step, float(highest - bright) / step


def _return(fitted: FittedEdges, i: int, frequency: Float, curve: Float, *, sharpened: float) -> str | None:
    """Words for an SFR that comes back from near zero higher than a blur's does; ``sharpened``: amount the ESF shows."""
    fallen = int(np.argmax(curve < FALLEN))
    if curve[fallen] >= FALLEN:
        return None
    top = fallen + int(np.argmax(curve[fallen:]))
    allowed = MAX_RETURN * (1 + sharpened)
    if curve[top] <= allowed or curve[top] <= allowed + SIGMAS * _sfr_sigma(fitted.fits.one(i), frequency[top]):
        return None
    return (
        f"the SFR falls below {FALLEN:g} and comes back to {curve[top]:.2f} at {frequency[top]:.2f} cy/px (a blur explains "
        f"{allowed:.2f}): two edges side by side or a double image; choose a region with a single edge"
    )
