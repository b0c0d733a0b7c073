"""Illumination common to both sides of the edge, and the noise left when it is removed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.geometry import EdgeLines, PerRegion, RowPolynomials, Stack, along_rows, clip, distances

Float = NDArray[np.floating[Any]]

LIMITS = np.array([0.9, 0.5, 0.5])  # of g0, g1, g2: keep the illumination above 0 in one Gauss-Newton step from a bad line


@dataclass(frozen=True, eq=False)
class SideNoise(PerRegion):
    """Variance of a sample on the dark and on the bright side, DN^2, (regions,)."""

    dark: Float
    bright: Float

    def at(self, level: Float) -> Float:
        """Variance at ``level`` (regions, ...): 0 for the dark side's, 1 for the bright side's; linear in between."""
        shape = (-1,) + (1,) * (level.ndim - 1)
        out = clip(level, 0.0, 1.0)
        out *= (self.bright - self.dark).reshape(shape)
        out += self.dark.reshape(shape)
        return np.asarray(out)


@dataclass(frozen=True, eq=False)
class Frame:
    """Coordinates along (l) and across (d) the edges' middle tangents: l = along0 + along1 u, d = across0 + across1 u.

    ``u`` is the distance along a row from the edge's middle; the terms are (regions, rows) and (regions, 1);
    ``start`` (regions, rows) is u of each row's first sample.
    """

    along0: Float
    along1: Float
    across0: Float
    across1: Float
    start: Float


def frame_of(stack: Stack, lines: EdgeLines) -> Frame:
    """Frame of every region's middle tangent."""
    x, slope = (part[:, None] for part in lines.middle)
    cosine = 1 / np.hypot(1, slope)
    rows = stack.y_px - lines.y_center_px[:, None]
    sign = lines.sign[:, None]
    return Frame(rows * cosine, slope * cosine, -sign * cosine * slope * rows, sign * cosine, stack.x0_px - x)


def illumination_terms(frame: Frame, illumination: Float, half_px: float) -> tuple[Float, Float, Float]:
    """Illumination as c0 + c1 u + c2 u^2 per row, (regions, rows) each.

    The illumination is 1 + g0 l + g1 l^2 + g2 l d + g3 d + g4 d^2 with l, d in units of ``half_px``.
    """
    g = [illumination[:, k, None] / half_px**power for k, power in enumerate((1, 2, 2, 1, 2))]
    l0, l1, d0, d1 = frame.along0, frame.along1, frame.across0, frame.across1
    c0 = 1 + l0 * (g[0] + g[1] * l0 + g[2] * d0) + d0 * (g[3] + g[4] * d0)
    c1 = g[0] * l1 + 2 * g[1] * l0 * l1 + g[2] * (l0 * d1 + l1 * d0) + g[3] * d1 + 2 * g[4] * d0 * d1
    c2 = g[1] * l1 * l1 + g[2] * l1 * d1 + g[4] * d1 * d1
    return c0, c1, c2


def illumination_at(stack: Stack, lines: EdgeLines, illumination: Float, half_px: float) -> Float:
    """Illumination at every sample, (regions, rows, n)."""
    frame = frame_of(stack, lines)
    c0, c1, c2 = illumination_terms(frame, illumination, half_px)
    s = frame.start
    return along_rows(stack, c0 + s * (c1 + c2 * s), c1 + 2 * c2 * s, c2)


@dataclass(frozen=True, eq=False)
class AlongFit(PerRegion):
    """Illumination coefficients (regions, 5), noise of both sides, and what the coefficients' noise does to the levels.

    ``level_covariance`` (regions, 2, 2): relative covariance of the dark and the bright level, as the illumination is
    divided out.
    """

    illumination: Float
    noise: SideNoise
    level_covariance: Float

    def where(self, new: NDArray[np.bool_], before: AlongFit) -> AlongFit:
        """Take the regions of ``new`` (regions,) from here, the others from ``before``."""
        noise = SideNoise(
            np.where(new, self.noise.dark, before.noise.dark), np.where(new, self.noise.bright, before.noise.bright)
        )
        return AlongFit(
            np.where(new[:, None], self.illumination, before.illumination),
            noise,
            np.where(new[:, None, None], self.level_covariance, before.level_covariance),
        )


def fit_along(
    stack: Stack, lines: EdgeLines, p: RowPolynomials, *, illumination: Float, half_px: float, width_px: Float
) -> AlongFit:
    """Illumination along the edge (g0, g1, g2), from how the values change along it at equal distance.

    Regressing the deviations from the mean at each distance leaves the ESF out altogether; one Gauss-Newton
    step from the present illumination.  The residuals give the noise of both sides.
    """
    b, size = len(stack), stack.values[0].size
    distance = distances(stack, lines, p)
    frame = frame_of(stack, lines)
    along = frame.along0[:, :, None] + frame.along1[:, :, None] * (frame.start[:, :, None] + stack.columns)
    far = np.abs(distance) > (2.5 * width_px)[:, None, None]
    enough = far.reshape(b, -1).sum(axis=1) >= 50
    present = illumination_at(stack, lines, illumination, half_px)
    cell = distance * (1 / np.maximum(width_px, 2.0))[:, None, None]
    reach = int(np.abs(cell).max()) + 2
    cell += reach
    bins = 2 * reach
    # no cell holds both sides
    place = (cell.astype(np.intp) + (np.arange(b) * bins)[:, None, None]).ravel()
    use = far.ravel().astype(float)
    number = np.maximum(np.bincount(place, use, b * bins), 1.0)

    def smoothed(part: Float) -> Float:
        return np.asarray((np.bincount(place, part.ravel() * use, b * bins) / number)[place].reshape(b, size))

    unit = 1 / half_px
    place_along, place_across = along.reshape(b, size) * unit, distance.reshape(b, size) * unit
    esf = smoothed(stack.values / present)
    design = np.empty((b, 3, size))
    for k, raw in enumerate((place_along, place_along**2, place_along * place_across)):
        np.subtract(raw, smoothed(raw), out=design[:, k])
    weight = far.reshape(b, size).astype(float)
    design *= (esf * weight)[:, None, :]
    rest = stack.values.reshape(b, size) - esf * present.reshape(b, size)
    rest *= weight
    matrix = design @ design.swapaxes(1, 2)
    trace = np.trace(matrix, axis1=1, axis2=2)
    matrix += (1e-9 * trace + 1e-300)[:, None, None] * np.eye(3)
    step = np.linalg.solve(matrix, design @ rest[:, :, None])
    rest -= (step.swapaxes(1, 2) @ design)[:, 0]
    bright = weight * (place_across > 0)
    noise = _side_noise(rest, weight, bright, enough)
    out = illumination.copy()
    out[enough, :3] = clip(illumination[:, :3] + step[:, :, 0], -LIMITS, LIMITS)[enough]
    raw = np.stack([place_along, place_along**2, place_along * place_across], axis=1)
    covariance = _level_covariance(raw, design, np.linalg.inv(matrix), bright, weight - bright, noise)
    return AlongFit(out, noise, np.where(enough[:, None, None], covariance, 0.0))


def _side_noise(rest: Float, weight: Float, bright: Float, enough: NDArray[np.bool_]) -> SideNoise:
    """Mean squares of the residuals on both sides; 1 where there are too few samples."""
    square = rest * rest
    count, both = bright.sum(axis=1), weight.sum(axis=1)
    high = np.einsum("ij,ij->i", square, bright)
    low = square.sum(axis=1) - high
    return SideNoise(np.where(enough, low / np.maximum(both - count, 1), 1.0), np.where(enough, high / np.maximum(count, 1), 1.0))


def _level_covariance(raw: Float, design: Float, inverse: Float, bright: Float, dark: Float, noise: SideNoise) -> Float:
    """A C A': C is the coefficients' covariance from the noise of both sides, A (2, 3) the means of the terms on each side."""
    sides = np.stack([dark, bright], axis=1)
    means = sides @ raw.swapaxes(1, 2) / np.maximum(sides.sum(axis=2), 1.0)[:, :, None]
    variance = noise.dark[:, None] * dark + noise.bright[:, None] * bright
    half = inverse @ ((design * variance[:, None]) @ design.swapaxes(1, 2)) @ inverse
    return np.asarray(means @ half @ means.swapaxes(1, 2))
