"""What an edge spread function may look like before it is measured.

The prior is a Gaussian one on the shape in units of its own width.  Its mean and covariance are
those of an ensemble of blurs built from physics (pixel aperture, diffraction, defocus, Gaussian
diffusion, motion, spherical aberration, veiling glare) with wide ranges; on top of it comes a
generic smooth deviation, symmetric and antisymmetric, whose two amplitudes the data choose by their
marginal likelihood.  Shapes that no member of the ensemble resembles therefore get through: the
generic amplitude grows.  Both covariances are brought to diagonal form together, once.

The columns of the model come in this order: constant, mean shape, symmetric modes, shading across the edge and its
square, antisymmetric modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1, ndtri

from isetval.measure.edge import spline_bins

Float = NDArray[np.floating[Any]]
Index = NDArray[np.intp]

ENSEMBLE = 600  # blurs drawn; 300 and 1200 move MTF50 by .02 % at SNR 22 (sigma 1.3 %)
# Widths up to which ESFs of the ensemble are computed.  20 cuts Airy tails: clean edges -.007 +- .009 % instead of
# -.005 +- .011 %, with a pull of 1.65 instead of .60; 80: curved edges .005 +- .013 %, .002 % before
REACH = 40.0
LEAST = 1e-17  # of the largest term of a sum: smaller ones are below rounding, all 1200 of them together
WIDTH_STEP = 0.02  # log of neighbouring tabulated widths: transforms are kept per width; .01 and .04 move MTF50 by .04 % or less


@dataclass(frozen=True, eq=False)
class Prior:
    """Diagonal form of the prior.

    Parameters
    ----------
    mean : (splines,)
        Coefficients of the mean shape, 0 on the dark and 1 on the bright side.
    vectors : (splines, modes)
        Deviations from the mean.
    base, extra : (modes,)
        Variance of each mode: ``base + amplitude**2 * extra``.
    even : bool (modes,)
        Modes whose LSF is symmetric.
    """

    mean: Float
    vectors: Float
    base: Float
    extra: Float
    even: NDArray[np.bool_]

    def variance(self, even_amplitude: float, odd_amplitude: float) -> Float:
        """Variance of every mode for amplitudes of the generic deviation, (modes,)."""
        amplitude = np.where(self.even, even_amplitude, odd_amplitude)
        return np.asarray(self.base + amplitude**2 * self.extra)


@lru_cache(maxsize=1)
def shape_prior() -> Prior:
    """The prior, built once per process."""
    members = _coefficients(_ensemble())
    stretch = 0.06 * _halton_normal(len(members), 29)
    z = spline_bins.greville()
    mean = members.mean(axis=0)
    slope = spline_bins.spline_matrix(z, derivative=1) @ mean
    members = members + np.outer(stretch, -z * slope * np.exp(-np.abs(z) / 8))
    deviation = members - mean
    even = (deviation - deviation[:, ::-1]) / 2
    generic = 0.5 * _generic(z, 2.5) + 0.5 * _generic(z, 6.0)
    flip = generic[::-1, :]
    parts = [
        _diagonal(even.T @ even / len(even), (generic - flip - flip.T + generic[::-1, ::-1]) / 4),
        _diagonal(0.02**2 * np.outer(slope, slope), (generic + flip + flip.T + generic[::-1, ::-1]) / 4),
    ]
    return Prior(
        mean=mean,
        vectors=np.concatenate([p[0] for p in parts], axis=1),
        base=np.concatenate([p[1] for p in parts]),
        extra=np.concatenate([p[2] for p in parts]),
        even=np.repeat([True, False], [len(p[1]) for p in parts]),
    )


def _coefficients(values: Float) -> Float:
    """Spline coefficients of functions given at the Greville points, (members, splines)."""
    collocation = spline_bins.spline_matrix(spline_bins.greville())
    return np.asarray(np.linalg.solve(collocation, values.T).T)


def _ensemble() -> Float:
    """ESF of the members at the Greville points in units of their own width, (members, points)."""
    # frequencies are dense near 0, where the far tails are made
    u = (np.arange(1200) + 0.5) / 1200
    f = 3.2 * u**2
    weight = 3.2 * 2 * u / 1200
    mtf = _ensemble_mtf(f) * weight / (np.pi * f)
    coarse = np.linspace(0, 12, 241)
    core = 0.5 + mtf @ np.sin(2 * np.pi * np.outer(f, coarse))
    width = np.array([np.interp(0.75, row, coarse) if row.max() > 0.75 else 12.0 for row in core]) * 2 / 1.349
    z = spline_bins.greville()
    z = z[(z > 0) & (z < REACH)]
    out = np.empty((len(width), len(z)))
    for i, s in enumerate(width):
        seen = f[: np.flatnonzero(np.abs(mtf[i]) > LEAST * np.abs(mtf[i]).max())[-1] + 1]  # most lenses end early
        out[i] = 0.5 + mtf[i, : seen.size] @ np.sin(2 * np.pi * np.outer(seen, z * s))
    return _extend(np.clip(out, 0.4, 1.1), z)


def _draw() -> dict[str, Float]:
    """Quasi-random blur parameters, in pixels, of the ensemble."""
    u = [_halton(ENSEMBLE, base) for base in (2, 3, 5, 7, 11, 13, 17, 19, 23)]
    kind = u[0]
    return {
        "aperture": np.where(u[1] < 0.15, 0.0, 0.6 + 0.4 * u[1]),
        "angle": np.deg2rad(45 * u[8]),
        "cutoff": np.where(kind < 0.65, 0.25 * 12 ** u[2], np.inf),
        "waves": np.where(kind < 0.25, 1.2 * u[3], 0.0),
        "sigma": np.where(kind > 0.35, 0.15 + 1.6 * u[4] ** 2, 0.0),
        "disc": np.where((kind > 0.5) & (kind < 0.8), 5 * u[5] ** 2, 0.0),
        "motion": np.where(u[6] > 0.8, 15 * (u[6] - 0.8), 0.0),
        "glare": np.where(u[7] > 0.5, 0.08 * (2 * u[7] - 1) ** 2, 0.0),
        "scatter": 1.5 * 20 ** u[3],
    }


def _halton(n: int, base: int) -> Float:
    # as scipy.stats.qmc.Halton, whose import takes .4 s, more than a hundred edges do
    out = np.zeros(n)
    for i in range(n):
        f, k = 1.0, i + 1
        while k:
            f /= base
            out[i] += f * (k % base)
            k //= base
    return out


def _halton_normal(n: int, base: int) -> Float:
    return np.asarray(ndtri(_halton(n, base)))


def _ensemble_mtf(f: Float) -> Float:
    p = _draw()
    column = {name: value[:, None] for name, value in p.items()}
    out = np.exp(-2 * (np.pi * column["sigma"] * f) ** 2)
    for part in (np.cos(column["angle"]), np.sin(column["angle"])):
        out = out * np.sinc(column["aperture"] * f * part)
    out = out * np.sinc(column["motion"] * f)
    x = np.maximum(np.pi * column["disc"] * f, 1e-9)
    out = out * 2 * j1(x) / x
    lens = np.isfinite(p["cutoff"])
    out[lens] *= _otf(f / column["cutoff"][lens], p["waves"][lens])
    return np.asarray(out * (1 - column["glare"]) + column["glare"] * out * np.exp(-2 * np.pi * column["scatter"] * f))


def _otf(v: Float, waves: Float) -> Float:
    """Defocused circular pupil, (members, frequencies); Hopkins 1955 by quadrature, in closed form without defocus."""
    passed = v < 1
    blurred = passed & (waves[:, None] > 0)
    out = np.zeros_like(v)
    sharp = v[passed & ~blurred]
    out[passed & ~blurred] = 2 / np.pi * (np.arccos(sharp) - sharp * np.sqrt(1 - sharp**2))
    inside, phase = v[blurred], 8 * np.pi * np.broadcast_to(waves[:, None], v.shape)[blurred] * v[blurred]
    top, total = np.arccos(inside), np.zeros(inside.size)
    for node, weight in zip(*np.polynomial.legendre.leggauss(24), strict=True):
        theta = top * (node + 1) / 2
        total += weight * np.sin(theta) ** 2 * np.cos(phase * (np.cos(theta) - inside))
    out[blurred] = top / 2 * total * 4 / np.pi
    return out


def _extend(core: Float, z: Float) -> Float:
    """Beyond ``REACH`` widths the rest to 1 goes on as the power law of its last stretch."""
    points = spline_bins.greville()
    far = points[points >= REACH]
    ref = z > REACH / 4
    rest = np.maximum(1 - core, 0)
    level = (rest[:, ref] * z[ref]).mean(axis=1)
    tail = level[:, None] / far * (1 - (far / points[-1]) ** 2)
    right = np.concatenate([core, 1 - tail], axis=1)
    middle = np.full((len(core), 1), 0.5)
    return np.concatenate([1 - right[:, ::-1], middle, right], axis=1)


def _generic(z: Float, length: float) -> Float:
    """Covariance of a smooth deviation: amplitude falls as the tails do, correlation in knot numbers."""
    place = np.interp(z, spline_bins.knots(), np.arange(len(spline_bins.knots()), dtype=float))
    amplitude = 1 / (1 + (np.abs(z) / 1.5) ** 1.5) + 0.02 / (1 + np.abs(z) / 3)
    amplitude *= np.maximum(1 - (np.abs(z) / z[-1]) ** 2, 0)
    lag = np.abs(place[:, None] - place[None, :]) / length
    return np.asarray(np.outer(amplitude, amplitude) * np.exp(-0.5 * lag**2))


def _diagonal(base: Float, extra: Float) -> tuple[Float, Float, Float]:
    """Vectors in which both covariances are diagonal, and their variances; negligible modes dropped."""
    value, vector = np.linalg.eigh(base + extra)
    keep = value > 1e-8 * value[-1]
    root = vector[:, keep] * np.sqrt(value[keep])
    inverse = vector[:, keep] / np.sqrt(value[keep])
    share, turn = np.linalg.eigh(inverse.T @ base @ inverse)
    share = np.clip(share, 0.0, 1.0)
    return root @ turn, share, 1 - share


@lru_cache(maxsize=1)
def shape_columns() -> Float:
    """Spline coefficients of mean shape and modes, (splines, 1 + modes)."""
    prior = shape_prior()
    return np.column_stack([prior.mean, prior.vectors])


@lru_cache(maxsize=1)
def level_columns() -> Float:
    """Spline coefficients of constant, mean shape and modes, (splines, 2 + modes)."""
    columns = shape_columns()
    return np.column_stack([np.ones(len(columns)), columns])


@lru_cache(maxsize=1)
def column_places() -> tuple[Index, Index]:
    """Mean shape with the symmetric modes, and the antisymmetric modes, among the columns without the shading."""
    even = int(shape_prior().even.sum())
    return np.arange(1, 2 + even), np.arange(2 + even, 2 + len(shape_prior().even))


@lru_cache(maxsize=1)
def shape_places() -> Index:
    """Columns of mean shape and modes."""
    even = int(shape_prior().even.sum())
    return np.asarray(np.r_[1 : 2 + even, 4 + even : 4 + len(shape_prior().even)])


@lru_cache(maxsize=1)
def shape_places_by_symmetry() -> tuple[Index, Index]:
    """Columns whose line spread is symmetric (mean shape, symmetric modes), and the antisymmetric modes."""
    even, odd = column_places()
    return even, odd + 2


@lru_cache(maxsize=1)
def level_places() -> Index:
    """Columns of constant, mean shape and modes."""
    return np.asarray(np.r_[0, shape_places()])


@lru_cache(maxsize=1)
def shading_places() -> slice:
    """Columns of the shading across the edge."""
    even = int(shape_prior().even.sum())
    return slice(2 + even, 4 + even)


def width_index(width_px: float) -> int:
    """Number of the nearest tabulated width (2 % apart)."""
    return round(float(np.log(width_px)) / WIDTH_STEP)


def width_of(index: int) -> float:
    """Tabulated width in px."""
    return float(np.exp(index * WIDTH_STEP))


def tabulated(width_px: Float) -> Float:
    """Nearest tabulated widths, px."""
    return np.array([width_of(width_index(w)) for w in width_px])
