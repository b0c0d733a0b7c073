"""The black level of a file: the hidden margin where it is plausible and contradicts the tag, else the tag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.sensor import Black
from isetval.files.dng.levels import Area, Levels
from isetval.files.picture_file import Remark, refusal

BlackChoice = Literal["auto", "tag", "optical"]


THINNEST_MARGIN_PX = 16  # thinner ones are all guard, dummy pixels and crosstalk
# left out at the frame's rim (dummy columns; the Canon 550D has 20), beside the light (crosstalk) and at either end
OUTER_GUARD_PX, INNER_GUARD_PX, END_GUARD_PX = 20, 12, 4
FEWEST_PIXELS = 1000  # a mean to 3 % of the noise
LARGEST_SHARE_OF_RANGE = 0.01  # black tags err by tenths of a percent, read noise lies below 1 % at any usable ISO
LARGEST_CORRELATION = 0.3  # dark pixels are independent; bilinear interpolation alone makes .5
LARGEST_DRIFT_SIGMAS = 0.5  # a drift that large is light or a gradient and not one level
DIFFERS_SIGMAS = 3.0  # chance of a false alarm .003 ...
DIFFERS_SIGMAS_OF_FOUR = 4.0  # ... and of the same order for the worst of four places
NORMAL_MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution


@dataclass(frozen=True)
class OpticalBlack:
    """Dark pixels of the margin.

    ``mean_dn`` and ``sigma_dn`` (standard error, from the scatter of row means, so that banding
    counts) are 2x2 from the ActiveArea's first pixel; ``noise_dn`` is the pixel standard deviation
    from the median absolute deviation; ``area`` is (row0, row1, col0, col1) in the stored frame;
    ``difference_dn`` is the mean over the places minus that of the tag, ``differs`` whether noise
    does not explain it; ``drift_dn`` is how far the mean moves from one half of the margin's width to
    the other, which bounds how well it stands for the picture; ``doubts`` says why the margin is not
    believed (empty = plausible).
    """

    mean_dn: Black
    sigma_dn: Black
    noise_dn: float
    pixels: int
    area: Area
    difference_dn: float
    difference_sigma_dn: float
    differs: bool
    drift_dn: float
    doubts: tuple[str, ...]


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
    parts = _places(frame, area, active)
    middles = [float(np.median(p)) for p in parts]
    noise_dn = float(np.mean([NORMAL_MAD * np.median(np.abs(p - m)) for p, m in zip(parts, middles, strict=True)]))
    # hot pixels are not the black level: pulled in to six sigma
    held = [np.clip(p, m - 6 * noise_dn, m + 6 * noise_dn) for p, m in zip(parts, middles, strict=True)]
    lines = [p.mean(axis=1) for p in held]
    means = np.array([line.mean() for line in lines])
    errors = np.array([_standard_error(line) for line in lines])
    # the two places of a row share its banding, so rows are averaged before their scatter is taken
    of_all = float(np.hypot(_standard_error((lines[0] + lines[1]) / 2), _standard_error((lines[2] + lines[3]) / 2)) / 2)
    excess = means - np.ravel(black_dn)
    differs = abs(excess.mean()) > DIFFERS_SIGMAS * of_all or bool(np.any(np.abs(excess) > DIFFERS_SIGMAS_OF_FOUR * errors))
    drifts = [_drift(p) for p in held]
    centered = [np.clip(p - m, -4 * noise_dn, 4 * noise_dn) for p, m in zip(parts, middles, strict=True)]
    zero = max(float(np.mean(p == 0)) for p in parts)
    doubts = _doubts(centered, drifts, zero, noise_dn, (float(excess.mean()), white_dn - float(np.mean(black_dn))))
    return OpticalBlack(
        _nest(means),
        _nest(errors),
        noise_dn,
        sum(p.size for p in parts),
        area,
        float(excess.mean()),
        of_all,
        bool(differs),
        float(np.mean(drifts)),
        tuple(doubts),
    )


def choose_black(
    path: object, levels: Levels, margin: OpticalBlack | None, choice: BlackChoice = "auto"
) -> tuple[Black, str, tuple[Remark, ...]]:
    """The black level of a file: the one place where it is decided.

    "auto" takes the margin where it is plausible and differs from the tag by more than noise explains, else
    the tag; "tag" the tag; "optical" the margin.

    Returns
    -------
    black_dn : 2x2
        From the ActiveArea's first pixel.
    used : str
        ``"tag"`` or ``"optical_black"``.
    remarks : tuple of Remark
        How far tag and margin lie apart, where that matters.

    Raises
    ------
    InputError
        For "optical" where there is no plausible margin, and a choice that does not exist.
    """
    if choice not in get_args(BlackChoice):
        raise InputError(f"black is {choice!r}; it needs one of {', '.join(get_args(BlackChoice))}")
    if choice == "optical" and (margin is None or margin.doubts):
        reason = (
            "no hidden margin" if margin is None else f"a hidden margin that is not optical black: {'; '.join(margin.doubts)}"
        )
        raise refusal(path, reason, "plausible optical black", "use the black level of the tag")
    if margin is None:
        return levels.black_dn, "tag", ()
    tag_dn = float(np.mean(levels.black_dn))
    if margin.doubts:
        words = f"the hidden margin is not taken for optical black ({'; '.join(margin.doubts)})"
        words += f"; the tag's black level of {tag_dn:g} DN is used"
        return levels.black_dn, "tag", (Remark("margin_not_black", words),)
    optical_dn = float(np.mean(margin.mean_dn))
    apart = f"BlackLevel tag {tag_dn:g} DN, optical black {optical_dn:.2f} +- {margin.difference_sigma_dn:.2f} DN"
    apart += f" (it drifts by {margin.drift_dn:+.1f} DN across the margin)"
    if choice == "optical" or (choice == "auto" and margin.differs):
        words = f"{apart}: the tag is {_high_or_low(-margin.difference_dn)}; the optical black is used"
        return margin.mean_dn, "optical_black", (Remark("black_tag_differs", words),)
    if margin.differs:
        return levels.black_dn, "tag", (Remark("black_tag_differs", f"{apart}; the tag is used, as asked"),)
    return levels.black_dn, "tag", ()


def _high_or_low(excess_dn: float) -> str:
    return f"{abs(excess_dn):.2f} DN too {'high' if excess_dn > 0 else 'low'}"


def _places(frame: NDArray[np.uint16], area: Area, active: Area) -> list[NDArray[np.float64]]:
    """Pixels of the four places of the pattern, counted from the ActiveArea's first pixel, with equal numbers of rows."""
    row0, row1, col0, col1 = area
    row1 -= (row1 - row0) % 2
    return [
        frame[row0 + (active[0] + row - row0) % 2 : row1 : 2, col0 + (active[1] + col - col0) % 2 : col1 : 2].astype(float)
        for row in (0, 1)
        for col in (0, 1)
    ]


def _drift(held: NDArray[np.float64]) -> float:
    """Mean of the right half minus that of the left one in DN; hot pixels have been pulled in."""
    middle = held.shape[1] // 2
    return float(held[:, middle:].mean() - held[:, :middle].mean())


def _standard_error(line: NDArray[np.float64]) -> float:
    return float(line.std(ddof=1) / np.sqrt(len(line)))


def _nest(table: NDArray[np.float64]) -> Black:
    a, b, c, d = table.tolist()
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


def _doubts(
    centered: list[NDArray[np.float64]], drifts: list[float], zero: float, noise_dn: float, level: tuple[float, float]
) -> list[str]:
    """Why a margin is no optical black; ``level`` is its distance from the tag and the range of the codes, DN."""
    difference_dn, span_dn = level
    doubts = []
    pixels = min(p.size for p in centered)
    if pixels < FEWEST_PIXELS:
        return [f"it has only {pixels} pixels a color plane, {FEWEST_PIXELS} are needed"]
    if noise_dn == 0:
        return ["it carries no noise, so it is a filled border"]
    if abs(difference_dn) > LARGEST_SHARE_OF_RANGE * span_dn:
        doubts.append(f"it lies {difference_dn:+.1f} DN from the tag, more than {LARGEST_SHARE_OF_RANGE:.0%} of the range")
    if noise_dn > LARGEST_SHARE_OF_RANGE * span_dn:
        doubts.append(f"its noise of {noise_dn:.1f} DN is more than {LARGEST_SHARE_OF_RANGE:.0%} of the range")
    if zero > 0.001:
        doubts.append(f"{zero:.1%} of it is clipped at 0")
    correlation = max(_neighbor_correlation(p) for p in centered)
    if correlation > LARGEST_CORRELATION:
        doubts.append(f"neighbors correlate by {correlation:.2f}, so it holds a picture and not noise")
    drift = max(map(abs, drifts))
    if drift > LARGEST_DRIFT_SIGMAS * noise_dn:
        doubts.append(f"its mean drifts by {drift:.1f} DN from one side to the other")
    return doubts


def _neighbor_correlation(centered: NDArray[np.float64]) -> float:
    deviation = centered - centered.mean()
    variance = float((deviation**2).mean())
    if variance == 0:
        return 1.0
    return max(float((deviation[:, 1:] * deviation[:, :-1]).mean()), float((deviation[1:] * deviation[:-1]).mean())) / variance
