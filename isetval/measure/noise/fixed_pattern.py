"""Row, column and pixel parts of a fixed pattern, signed, after removal of a smooth surface.

Two-way analysis of variance of the mean image of F frames (EMVA 1288 release 4.0, section on non-uniformity,
does the same with plain moments): with mean squares of rows, columns and the rest,

    sigma_row^2 = (MS_row - MS_rest) / w,  sigma_col^2 = (MS_col - MS_rest) / h,  sigma_pix^2 = MS_rest - V / F

The surface is a product of discrete orthogonal polynomials of limited total degree; what it takes is
counted in the degrees of freedom, so white noise gives unbiased parts whatever the degree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.quantity import Quantity
from isetval.measure.noise.moments import BLOCK_PIXELS, CENTER, Moments

Float = NDArray[np.float64]
NO_ROW_NOISE = Quantity(0.0, 0.0, "DN^2")
MAX_OUTLIER_SHARE = 0.2  # more are structure, and nothing is left out


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """Fixed pattern of a plane; variances in DN^2, signed, with total sigma in ``sigma`` and ``shared``.

    ``shared`` is the part of the uncertainty that comes from the specimen (another sensor of the same
    kind would have drawn another pattern); ``sigma`` is what temporal noise adds.  ``neighbours`` are covariances of the
    pixel part with the next pixel of the plane in its row and in its column: 0 for pixels that differ each by itself.
    """

    total: Quantity
    row: Quantity
    column: Quantity
    pixel: Quantity
    outliers: int
    valid: int
    excess_kurtosis: float
    surface: NDArray[Any]
    correlation: Float
    neighbours: tuple[Quantity, Quantity]


@lru_cache(maxsize=64)
def orthogonal_polynomials(count: int, degree: int) -> Float:
    """Orthonormal polynomials on ``count`` equidistant points, (count, degree + 1)."""
    x = np.linspace(-1, 1, count) if count > 1 else np.zeros(1)
    basis = np.polynomial.legendre.legvander(x, min(degree, max(count - 1, 0)))
    q, r = np.linalg.qr(basis)
    out = q * np.sign(np.diag(r))
    out.flags.writeable = False
    return np.asarray(out)


def fit_surface(image: NDArray[Any], degree: int) -> NDArray[Any]:
    """Least-squares polynomial surface of total degree ``degree``, (rows, cols), of the image's type."""
    rows, cols = image.shape
    py, px = orthogonal_polynomials(rows, degree), orthogonal_polynomials(cols, degree)
    kind = image.dtype if image.dtype in (np.float32, np.float64) else np.dtype(np.float64)
    py, px = py.astype(kind), px.astype(kind)
    keep = np.add.outer(np.arange(py.shape[1]), np.arange(px.shape[1])) <= degree
    return np.asarray((py @ ((py.T @ image @ px) * keep.astype(kind))) @ px.T)


def robust_sd(values: NDArray[Any], limit: int = 20000) -> float:
    """1.4826 times the median absolute deviation, of at most ``limit`` evenly spread values."""
    flat = values.ravel()
    flat = flat[:: max(1, flat.size // limit)]
    return float(1.4826 * np.median(np.abs(flat - np.median(flat))))


def decompose(
    moments: Moments,
    degree: int,
    *,
    relative: bool,
    row_temporal: Quantity = NO_ROW_NOISE,
    left_out: NDArray[np.bool_] | None = None,
) -> FixedPattern:
    """Split the fixed pattern of the mean of some frames.

    Parameters
    ----------
    moments : Moments
        Mean image, and the temporal variance whose residue in the mean image is taken off.
    degree : int
        Total degree of the surface taken out; 0 takes only the mean.
    relative : bool
        Divide by the surface (light; photo-response pattern) or subtract it (dark).
    row_temporal : Quantity
        Temporal variance of row means beyond pixel noise, DN^2; its residue is removed from the row part, whose sigma
        contains that of the residue.
    left_out : bool array (rows, cols), optional
        Pixels that no variance is taken of; those of them that stand out count as outliers all the same.
    """
    average = moments.average
    flat = _flatten(average, moments.pixel_variance, degree, relative)
    limit = moments.outlier_limit(0.0)
    if flat.highest > limit:  # else no spread of the others makes it an outlier
        limit = moments.outlier_limit(robust_sd(flat.residual))
    bad = np.abs(flat.residual) > limit if flat.highest > limit else np.zeros((1, 1), bool)
    outliers = int(bad.sum())
    bad = bad if left_out is None else bad | left_out
    count = int(bad.sum())
    masked = 0 < count < MAX_OUTLIER_SHARE * average.size
    if masked:
        good_variance = np.where(bad, 0.0, moments.pixel_variance).astype(average.dtype, copy=False)
        flat = _flatten(np.where(bad, flat.surface, average), good_variance, degree, relative)
        flat.residual[bad] = 0.0
    residual, surface = flat.residual, flat.surface
    valid = residual.size - count * masked
    residue = flat.variance_sum / valid / moments.frames
    parts = _parts(residual, degree, valid / residual.size)
    quantities, correlation = _assemble(
        parts, moments.shape, (residue, moments.temporal.sigma / moments.frames), row_temporal.scaled(1 / moments.frames, "DN^2")
    )
    total, row, column, pixel = quantities
    middle = residual[_middle(residual.shape[0]), _middle(residual.shape[1])]
    return FixedPattern(
        total=total,
        row=row,
        column=column,
        pixel=pixel,
        outliers=outliers,
        valid=valid,
        excess_kurtosis=parts[2],
        surface=surface,
        correlation=correlation,
        neighbours=_neighbours(middle, max(parts[0][0], 0.0), max(pixel.value, 0.0)) if moments.frames > 1 else UNTOLD,
    )


UNTOLD = (Quantity(math.nan, math.nan, "DN^2"), Quantity(math.nan, math.nan, "DN^2"))
"""Of one frame: what of it is the specimen's, the same in the next picture, and what is noise, is not known."""


def _middle(count: int) -> slice:
    """At most `CENTER` places in the middle: enough for a covariance."""
    start = max(0, (count - CENTER) // 2)
    return slice(start, start + min(count, CENTER))


def _neighbours(residual: NDArray[Any], square: float, pixel: float) -> tuple[Quantity, Quantity]:
    """Covariance with the next pixel in the row and in the column, rows and columns taken out, DN^2.

    White noise of mean square ``square``, of which ``pixel`` is the specimen's, gives it a variance of square^2 / pairs; a line's
    mean, taken off both, the expectation -square / pixels of the line.
    """
    rest = residual - residual.mean(axis=1, keepdims=True)
    rest -= rest.mean(axis=0)
    rows, cols = rest.shape
    out = []
    for a, b, line in ((rest[:, :-1], rest[:, 1:], cols), (rest[:-1], rest[1:], rows)):
        own = np.sqrt(max(square**2 - pixel**2, 0.0) / a.size)
        value = float(np.einsum("ij,ij->", a, b, dtype=np.float64)) / a.size + square / line
        out.append(Quantity(value, float(own), "DN^2", float(pixel / np.sqrt(a.size))))
    return out[0], out[1]


@dataclass(frozen=True, eq=False)
class _Flat:
    """Residual of an image about its surface, DN; the largest of them; and the sum of the pixels' variances in the same scale."""

    residual: NDArray[Any]
    surface: NDArray[Any]
    highest: float
    variance_sum: float


def _blocks(rows: int, cols: int) -> list[slice]:
    """Rows that stay in the processor's cache while everything is done with them."""
    high = max(1, BLOCK_PIXELS // max(cols, 1))
    return [slice(top, top + high) for top in range(0, rows, high)]


def _flatten(image: NDArray[Any], variance: NDArray[Any], degree: int, relative: bool) -> _Flat:
    """An image divided by its surface and brought back to its level, or less its surface; its variance alike."""
    surface = fit_surface(image, degree)
    level = float(surface.mean())
    divided = relative and level > 0 and float(surface.min()) > 0.02 * level
    residual = np.empty_like(image, dtype=surface.dtype)
    highest, total = 0.0, 0.0
    for part in _blocks(*image.shape):
        own = residual[part]
        if divided:
            gain = np.divide(surface.dtype.type(level), surface[part])
            np.multiply(image[part], gain, out=own)
            own -= own.dtype.type(level)
            scaled = variance[part] * gain
            scaled *= gain
        else:
            np.subtract(image[part], surface[part], out=own)
            scaled = variance[part]
        total += float(scaled.sum(dtype=np.float64))
        highest = max(highest, float(own.max()), -float(own.min()))
    return _Flat(residual, surface, highest, total)


def _parts(residual: NDArray[Any], degree: int, share: float) -> tuple[Float, Float, float]:
    """Mean squares (rest, row, column), their degrees of freedom, and excess kurtosis of the rest."""
    rows, cols = residual.shape
    row_means, col_means = residual.mean(axis=1, dtype=np.float64), residual.mean(axis=0, dtype=np.float64)
    columns = (col_means - row_means.mean()).astype(residual.dtype)
    square = fourth = 0.0
    for part in _blocks(rows, cols):
        rest = residual[part] - row_means[part].astype(residual.dtype)[:, None]
        rest -= columns
        np.multiply(rest, rest, out=rest)
        square += float(rest.sum(dtype=np.float64))
        fourth += float(np.vdot(rest, rest))
    used_y, used_x = min(degree, rows - 1) + 1, min(degree, cols - 1) + 1
    cross = sum(1 for i in range(1, used_y) for j in range(1, used_x) if i + j <= degree)
    dof = np.array([max((rows - 1) * (cols - 1) - cross, 1) * share, max(rows - used_y, 1), max(cols - used_x, 1)])
    squares = np.array([square, cols * np.sum(row_means**2), rows * np.sum(col_means**2)])
    mean_squares = squares / dof
    mean_squares[1:] /= share
    excess = fourth / residual.size / share / mean_squares[0] ** 2 - 3 if mean_squares[0] > 0 else 0.0
    return mean_squares, dof, max(float(excess), 0.0)


@lru_cache(maxsize=64)
def _to_parts(rows: int, cols: int) -> Float:
    """Total, row, column and pixel variances, (4, 3), from the mean squares of the rest, rows and columns."""
    split = np.array([[1.0, 0, 0], [-1 / cols, 1 / cols, 0], [-1 / rows, 0, 1 / rows]])
    return np.vstack([split.sum(axis=0), split[1], split[2], split[0]])


def _assemble(
    parts: tuple[Float, Float, float], shape: tuple[int, int], removed: tuple[float, float], row_residue: Quantity
) -> tuple[list[Quantity], Float]:
    """Total, row, column and pixel variances with both parts of their sigma, and their correlation."""
    mean_squares, dof, excess = parts
    rows, cols = shape
    residue, residue_sigma = removed
    to_parts = _to_parts(rows, cols)
    values = to_parts @ mean_squares - np.array([residue + row_residue.value, row_residue.value, 0.0, residue])
    spread = 2 + np.array([excess, 0.0, 0.0])
    covariance = (to_parts * (spread * mean_squares**2 / dof)) @ to_parts.T
    covariance += residue_sigma**2 * np.outer([1, 0, 0, 1], [1, 0, 0, 1])
    covariance += row_residue.sigma**2 * np.outer([1, 1, 0, 0], [1, 1, 0, 0])
    # the specimen's share: the same mean squares without the temporal residue
    own = np.maximum(mean_squares - residue - np.array([0.0, cols * row_residue.value, 0.0]), 0.0)
    specimen = np.diag((to_parts * (spread * own**2 / dof)) @ to_parts.T)
    variance = np.maximum(np.diag(covariance), 1e-30)
    shared = np.minimum(specimen, variance)
    quantities = [
        Quantity(float(v), float(np.sqrt(total - part)), "DN^2", float(np.sqrt(part)))
        for v, total, part in zip(values, variance, shared, strict=True)
    ]
    return quantities, covariance / np.sqrt(np.outer(variance, variance))
