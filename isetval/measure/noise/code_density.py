"""Widths of a converter's codes from how often each occurs in a flat: the code-density test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.quantity import Quantity

Float = NDArray[np.float64]
INSIDE = 0.998  # of the pixels: codes beyond are rare, and a level's far tails are no smooth curve
LEAST_CODES = 27  # three for each coefficient of the least spline
LEAST_COUNTS = 2000  # of a code on average: its width to 2 %, where converters err by a tenth
KNOT_CODES = 16  # between knots: what is wider belongs to the level's own distribution
REPEAT = 16  # codes after which a pattern of the last stages of a converter repeats (4 bits; shorter periods are part of it)
STEPS = 50  # of the scoring: a bound on cost, it ends after six


@dataclass(frozen=True)
class CodeWidths:
    """Variance of the codes' relative widths, of all and of the part that repeats every `REPEAT` codes; unit 1."""

    variance: Quantity
    repeated: Quantity


def code_widths(counts: NDArray[np.integer]) -> CodeWidths | None:
    """How unequal the codes' widths are; None where too few codes are hit, or too seldom.

    Parameters
    ----------
    counts : (codes,)
        How often each code occurs, of frames of one even level.

    Notes
    -----
    A level's distribution is smooth where noise spans several codes: the counts of code c are Poisson numbers of mean
    ``w(c) exp(s(c))``, s a cubic spline with a knot every 16 codes.  ``variance`` is the mean square of count over spline less 1,
    with the Poisson part taken out; ``repeated`` the same of the means over codes that are equal modulo 16.
    Source: IEEE Std 1241 (histogram test of differential non-linearity); scoring as for any generalised linear model.
    """
    total = int(counts.sum())
    if total < LEAST_CODES * LEAST_COUNTS:
        return None
    share = np.cumsum(counts) / total
    first, last = np.searchsorted(share, [(1 - INSIDE) / 2, (1 + INSIDE) / 2])
    seen = counts[first : last + 1].astype(float)
    if seen.size < LEAST_CODES or seen.mean() < LEAST_COUNTS:
        return None
    smooth, free = _smooth(seen)
    weight = smooth**2 * free
    excess = (seen - smooth) ** 2 - smooth * free
    value = float(excess.sum() / weight.sum())
    sigma = float(np.sqrt(2 * np.sum((smooth * free) ** 2)) / weight.sum())
    places = (first + np.arange(seen.size)) % REPEAT
    mean = np.bincount(places, smooth, REPEAT)
    off = (np.bincount(places, seen - smooth, REPEAT) / np.maximum(mean, 1)) ** 2 - np.bincount(places, smooth * free, REPEAT) / (
        np.maximum(mean, 1) ** 2
    )
    error = np.sqrt(2.0) * np.bincount(places, smooth * free, REPEAT) / np.maximum(mean, 1) ** 2
    return CodeWidths(Quantity(value, sigma, "1"), Quantity(float(off.mean()), float(np.sqrt(np.sum(error**2)) / REPEAT), "1"))


def _smooth(seen: Float) -> tuple[Float, Float]:
    """The spline's counts and each code's share of freedom, 1 less its leverage, (codes,) each."""
    basis = _basis(seen.size)
    b = np.linalg.lstsq(basis, np.log(seen + 0.5), rcond=None)[0]
    for _ in range(STEPS):
        mean = np.exp(basis @ b)
        step = np.linalg.solve((basis.T * mean) @ basis, basis.T @ (seen - mean))
        b = b + np.clip(step, -1, 1)
        if np.abs(step).max() < 1e-6:
            break
    mean = np.exp(basis @ b)
    inverse = np.linalg.inv((basis.T * mean) @ basis)
    return mean, 1 - mean * np.einsum("ci,ij,cj->c", basis, inverse, basis)


def _basis(codes: int) -> Float:
    """Cubic B-splines (codes, coefficients) over the codes."""
    from scipy.interpolate import BSpline

    knots = np.linspace(0, codes - 1, max(codes // KNOT_CODES, 4) + 1)
    padded = np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])
    return np.asarray(BSpline.design_matrix(np.arange(codes, dtype=float), padded, 3).toarray())
