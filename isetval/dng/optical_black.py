"""Optical black read from the hidden margin of a frame, where a margin exists and looks like darkness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.sensor import Black
from isetval.dng.levels import Area

THINNEST_MARGIN_PX = 16
OUTER_GUARD_PX, INNER_GUARD_PX, END_GUARD_PX = 20, 12, 4
FEWEST_PIXELS = 1000
LARGEST_SHARE_OF_RANGE = 0.01
LARGEST_CORRELATION = 0.3
LARGEST_DRIFT_SIGMAS = 0.5
DIFFERS_SIGMAS = 3.0
NORMAL_MAD = 1.4826


@dataclass(frozen=True)
class OpticalBlack:
    """Dark pixels of the margin.

    ``mean_dn`` and ``sigma_dn`` (standard error, from the scatter of row means, so that banding
    counts) are 2x2 from the ActiveArea's first pixel; ``noise_dn`` is the pixel standard deviation
    from the median absolute deviation; ``area`` is (row0, row1, col0, col1) in the stored frame;
    ``doubts`` says why the margin is not believed (empty = plausible).
    """

    mean_dn: Black
    sigma_dn: Black
    noise_dn: float
    pixels: int
    area: Area
    difference_dn: float
    difference_sigma_dn: float
    doubts: tuple[str, ...]

    @property
    def differs(self) -> bool:
        """Whether it differs from the tag by more than its own standard error explains."""
        pairs = [
            (m, s) for means, sigmas in zip(self.mean_dn, self.sigma_dn, strict=True) for m, s in zip(means, sigmas, strict=True)
        ]
        spread = max(m for m, _ in pairs) - min(m for m, _ in pairs)
        return abs(self.difference_dn) > DIFFERS_SIGMAS * self.difference_sigma_dn or spread > 2 * DIFFERS_SIGMAS * max(
            s for _, s in pairs
        )


def optical_black(frame: NDArray[np.uint16], active: Area, *, black_dn: Black, white_dn: float) -> OpticalBlack | None:
    """Mean dark level of the widest hidden margin, or None if the frame has no margin of 16 pixels.

    The margin is trimmed: up to 20 pixels at the frame's rim (dummy columns), up to 12 beside the
    light (crosstalk), 4 at either end.

    Parameters
    ----------
    frame : uint16 array (rows, cols)
        Whole stored frame in DN.
    active : (top, left, bottom, right)
        ActiveArea, half open.
    black_dn : 2x2
        BlackLevel tag in DN, from the ActiveArea's first pixel.
    white_dn : float
    """
    area = _widest_margin(frame.shape, active)
    if area is None:
        return None
    row0, row1, col0, col1 = area
    means, errors = np.empty((2, 2)), np.empty((2, 2))
    parts = []
    for row in (0, 1):
        for col in (0, 1):
            # the place of the pattern, counted from the ActiveArea's first pixel
            part = frame[row0 + (active[0] + row - row0) % 2 : row1 : 2, col0 + (active[1] + col - col0) % 2 : col1 : 2].astype(
                float
            )
            lines = part.mean(axis=1)
            means[row, col], errors[row, col] = lines.mean(), lines.std(ddof=1) / np.sqrt(len(lines))
            parts.append(part)
    difference_dn = float(means.mean() - np.mean(black_dn))
    noise_dn = float(np.mean([NORMAL_MAD * np.median(np.abs(p - np.median(p))) for p in parts]))
    return OpticalBlack(
        _nest(means),
        _nest(errors),
        noise_dn,
        sum(p.size for p in parts),
        area,
        difference_dn,
        # the planes share the banding of their rows, so their errors are not averaged down
        float(np.sqrt((errors**2).mean())),
        tuple(_doubts(parts, noise_dn, difference_dn, white_dn - float(np.mean(black_dn)))),
    )


def _nest(table: NDArray[np.float64]) -> Black:
    (a, b), (c, d) = table.tolist()
    return ((a, b), (c, d))


def _widest_margin(shape: tuple[int, ...], active: Area) -> Area | None:
    """Trimmed (row0, row1, col0, col1) of the side margin with most pixels; rows above and below only if there is no other."""
    top, left, bottom, right = active
    rows, cols = shape
    sides = [_trim((top, bottom, 0, left), False), _trim((top, bottom, right, cols), True)]
    ends = [_trim((0, top, left, right), False, across=True), _trim((bottom, rows, left, right), True, across=True)]
    for group in (sides, ends):
        found = [area for area in group if area is not None]
        if found:
            return max(found, key=lambda a: (a[1] - a[0]) * (a[3] - a[2]))
    return None


def _trim(area: Area, light_first: bool, *, across: bool = False) -> Area | None:
    row0, row1, col0, col1 = area
    first, last, start, stop = (col0, col1, row0, row1) if across else (row0, row1, col0, col1)
    width = stop - start
    if width < THINNEST_MARGIN_PX or last - first < 4 * END_GUARD_PX:
        return None
    outer, inner = min(OUTER_GUARD_PX, width // 4), min(INNER_GUARD_PX, width // 4)
    before, after = (inner, outer) if light_first else (outer, inner)
    first, last, start, stop = first + END_GUARD_PX, last - END_GUARD_PX, start + before, stop - after
    return (start, stop, first, last) if across else (first, last, start, stop)


def _doubts(parts: list[NDArray[np.float64]], noise_dn: float, difference_dn: float, span_dn: float) -> list[str]:
    doubts = []
    pixels = min(p.size for p in parts)
    if pixels < FEWEST_PIXELS:
        return [f"it has only {pixels} pixels a colour plane, {FEWEST_PIXELS} are needed"]
    if noise_dn == 0:
        return ["it carries no noise, so it is a filled border"]
    if abs(difference_dn) > LARGEST_SHARE_OF_RANGE * span_dn:
        doubts.append(f"it lies {difference_dn:+.1f} DN from the tag, more than {LARGEST_SHARE_OF_RANGE:.0%} of the range")
    if noise_dn > LARGEST_SHARE_OF_RANGE * span_dn:
        doubts.append(f"its noise of {noise_dn:.1f} DN is more than {LARGEST_SHARE_OF_RANGE:.0%} of the range")
    zero = max(float(np.mean(p == 0)) for p in parts)
    if zero > 0.001:
        doubts.append(f"{zero:.1%} of it is clipped at 0")
    clipped = [np.clip(p - np.median(p), -4 * noise_dn, 4 * noise_dn) for p in parts]
    correlation = max(_neighbour_correlation(p) for p in clipped)
    if correlation > LARGEST_CORRELATION:
        doubts.append(f"neighbours correlate by {correlation:.2f}, so it holds a picture and not noise")
    drift = max(abs(float(p[:, : p.shape[1] // 2].mean() - p[:, p.shape[1] // 2 :].mean())) for p in clipped)
    if drift > LARGEST_DRIFT_SIGMAS * noise_dn:
        doubts.append(f"its mean drifts by {drift:.1f} DN from one side to the other")
    return doubts


def _neighbour_correlation(centred: NDArray[np.float64]) -> float:
    deviation = centred - centred.mean()
    variance = float((deviation**2).mean())
    if variance == 0:
        return 1.0
    return max(float((deviation[:, 1:] * deviation[:, :-1]).mean()), float((deviation[1:] * deviation[:-1]).mean())) / variance
