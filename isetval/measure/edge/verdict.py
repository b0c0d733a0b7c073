"""Reason codes: why an edge is refused, or accepted with a warning.

Refused (``flags``): ``roi_too_small``, ``no_edge``, ``low_contrast`` (step below 5 sigma of its
noise), ``saturated``, ``clipped_black``, ``angle_near_0``, ``angle_near_45``, ``angle_near_90``, ``phase_gaps``
(pixels see too few positions of the edge), ``edge_near_border``, ``too_blurred``, ``two_edges`` (more
than one transition, a corner or a pattern), ``overshoot`` (beyond what sharpening explains: a line or a gap).
Warned: ``shallow_angle`` (below 3 degrees), ``short_edge`` (below 35, 70, 140 rows for one channel, greens, red
or blue), ``clipped_black``, ``clipped_white`` (the tail of the noise), ``strong_shading``, ``mtf50_not_reached`` (the
SFR stays above one half up to 2 cy/px).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.alternating_fit import FittedEdges
from isetval.measure.edge.clipped_tails import LEAST_CLIPPED, MAX_CLIPPED, clipped_share, has_clipped_patch
from isetval.measure.edge.illumination import illumination_at
from isetval.measure.edge.overshoot import Excursions, excursions, unexplained

Float = NDArray[np.floating[Any]]

# Advice of the author of MTF Mapper: 35 px of a gray edge, 70 in green, 140 in red and blue
GOOD_LENGTH_PX = {"MONO": 35, "G": 70, "Gr": 140, "Gb": 140, "R": 140, "B": 140}
MIN_STEP_SIGMA = 5.0  # of a sample's noise; sigma of MTF50 is 6 % there in 100 x 100 px
MIN_ANGLE_DEG = 0.75  # an edge of 76 px crosses one pixel: fewer phases are seen below
SHALLOW_DEG = 3.0  # users of other tools report doubtful numbers below; sigma is widened by 3 degrees / angle
MAX_CUT = 0.08  # of the dark side at raw zero: the tail of a normal beyond 1.4 sigma, which moves its mean by .04 sigma
MAX_CRUSHED = 0.5  # of the dark side at raw zero: the median is cut, the level unknown
SECOND_EDGE = 0.12  # of the step, in patches of the plateaus: a choice, between noise (6 sigma is demanded too) and a second edge
MISFIT = 0.07  # of the step, scatter at equal distance (or 4 sigma of noise): real edges show their noise, corners 10 to 24 %
ROUNDING = 1 / 12  # DN^2, of a uniform error of one code


@dataclass(frozen=True)
class Verdict:
    """Codes with the sentence that explains each."""

    flags: dict[str, str]
    warnings: dict[str, str]


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen before the fit: steps and noise, DN, (regions,)."""

    step_dn: Float
    noise_dn: Float


@dataclass(frozen=True, eq=False)
class Beside:
    """What may lie beside the edges: residuals of the plateaus, excursions of the ESFs, SFRs (regions, frequencies)."""

    plateaus: Plateaus
    excursions: Excursions
    curves: Float


def judge(fitted: FittedEdges, seen: Seen, channels: list[str], curves: Float) -> list[Verdict]:
    """All codes for the fitted edges; ``curves`` (regions, frequencies) are their SFRs at the default frequencies."""
    beside = Beside(plateau_residuals(fitted), excursions(fitted), curves)
    return [_judge(fitted, i, seen, channel, beside) for i, channel in enumerate(channels)]


def _judge(fitted: FittedEdges, i: int, seen: Seen, channel: str, beside: Beside) -> Verdict:
    flags: dict[str, str] = {}
    warnings: dict[str, str] = {}
    wrong = misfit(fitted, i, seen_dn=float(seen.step_dn[i]), noise_dn=float(seen.noise_dn[i]))
    if wrong:
        return Verdict({"two_edges": wrong}, {})
    slope = float(fitted.slope[i])
    _contrast(flags, fitted, i)
    _angle(flags, warnings, fitted, i)
    _clipping(flags, warnings, fitted, i)
    _sides(flags, fitted, i)
    if "edge_near_border" not in flags and "too_blurred" not in flags:
        _single(flags, fitted, i, beside.plateaus)
        flags |= unexplained(fitted, i, beside.excursions, beside.curves[i]) | flags
    length = 2 * float(fitted.lines.y_half_px[i]) * float(np.hypot(1, slope))
    if length < GOOD_LENGTH_PX[channel]:
        warnings["short_edge"] = (
            f"the edge is {length:.0f} px long; channel {channel} is reliable from {GOOD_LENGTH_PX[channel]} px"
        )
    change = float(np.hypot(fitted.illumination[i, 0], fitted.illumination[i, 3]))
    if change > 0.3:
        warnings["strong_shading"] = f"illumination changes by {200 * change:.0f} % over the region"
    return Verdict(flags, warnings)


def misfit(fitted: FittedEdges, i: int, *, seen_dn: float, noise_dn: float) -> str | None:
    """Sentence if one edge does not explain region ``i`` at all (``seen_dn``: step at first look)."""
    step, scatter = float(fitted.fits.step[i]), float(fitted.scatter_dn[i])
    noise = max(noise_dn, float(np.sqrt(ROUNDING)))
    if 0.4 * seen_dn < step < 2.5 * seen_dn and scatter < max(4 * noise, MISFIT * step):
        return None
    return (
        f"values at equal distance from the best edge scatter by {scatter:.3g} DN (noise {noise:.2g} DN, step "
        f"{seen_dn:.4g} DN): a corner, a pattern or several edges; choose a region with a single edge"
    )


def _contrast(flags: dict[str, str], fitted: FittedEdges, i: int) -> None:
    step = float(fitted.fits.step[i])
    noise = float(np.sqrt((fitted.noise.dark[i] + fitted.noise.bright[i]) / 2))
    if step < MIN_STEP_SIGMA * noise:
        flags["low_contrast"] = (
            f"the step of {step:.4g} DN is {step / noise:.1f} sigma of the noise ({noise:.3g} DN); "
            f"it needs {MIN_STEP_SIGMA:g}: more light, more contrast or the mean of several frames"
        )


def _angle(flags: dict[str, str], warnings: dict[str, str], fitted: FittedEdges, i: int) -> None:
    angle, step_px = float(fitted.angle_deg[i]), fitted.stack.step_px
    name = "angle_near_90" if fitted.stack.members[i].transposed else "angle_near_0"
    near = fitted.near_px[i]
    near = np.sort(near[np.abs(near) < 2.5 * step_px])
    gap = float(np.max(np.diff(near))) if len(near) > 1 else np.inf
    limit = 0.62 if step_px == 1 else 1.0
    advice = "turn the target to between 2 and 43 degrees"
    if angle < MIN_ANGLE_DEG or (gap > limit and angle < 10):
        flags[name] = (
            f"the edge is {angle:.2f} degrees from a pixel axis, gaps between sampled positions reach {gap:.2f} px; {advice}"
        )
    elif angle > 45 - MIN_ANGLE_DEG or (gap > limit and angle > 40):
        flags["angle_near_45"] = (
            f"the edge is {angle:.2f} degrees from a pixel axis: positions repeat every {gap:.2f} px; {advice}"
        )
    elif gap > limit:
        flags["phase_gaps"] = (
            f"at {angle:.2f} degrees the pixels of this channel leave gaps of {gap:.2f} px; turn the target a little"
        )
    elif angle < SHALLOW_DEG:
        warnings["shallow_angle"] = (
            f"the edge is {angle:.2f} degrees from a pixel axis; the interval is widened below {SHALLOW_DEG:g}"
        )


def _clipping(flags: dict[str, str], warnings: dict[str, str], fitted: FittedEdges, i: int) -> None:
    samples, distance, width = fitted.stack.members[i], fitted.distance_px[i], float(fitted.fits.width_px[i])
    if not (samples.clipped_high.any() or samples.clipped_low.any()):
        return
    share = clipped_share(fitted, i)
    if share > MAX_CLIPPED or (share > 0 and has_clipped_patch(samples.clipped_high)):
        flags["saturated"] = f"{100 * share:.1f} % of the bright side is at the white level; expose less"
    elif share > LEAST_CLIPPED:
        warnings["clipped_white"] = (
            f"{100 * share:.1f} % of the bright side is at white, the tail of its noise: estimated from the rest"
        )
    dark = distance < -2 * width
    low = float(np.mean(samples.clipped_low[dark])) if dark.any() else 0.0
    if low > MAX_CRUSHED and samples.black_dn > 0:
        flags["clipped_black"] = (
            f"{100 * low:.0f} % of the dark side is at raw zero, {samples.black_dn:g} DN below black: its level is unknown; "
            "do not subtract black twice"
        )
    elif low > MAX_CUT:
        warnings["clipped_black"] = f"{100 * low:.0f} % of the dark side is at raw zero; its noise is cut and its mean biased up"


def _sides(flags: dict[str, str], fitted: FittedEdges, i: int) -> None:
    width = float(fitted.fits.width_px[i])
    low, high = (float(part[i]) for part in fitted.reach_px)
    reach = min(-low, high)
    if width > 0.15 * (high - low):
        flags["too_blurred"] = f"the edge's width (sigma {width:.1f} px) fills the region; enlarge the region"
    elif reach < max(3.0, 3 * width):
        flags["edge_near_border"] = (
            f"one side of the edge reaches {reach:.1f} px; it needs {max(3.0, 3 * width):.1f}: move the region"
        )


def _single(flags: dict[str, str], fitted: FittedEdges, i: int, plateaus: Plateaus) -> None:
    """Second transitions: plateaus that are not flat, or patches that disagree with the fit."""
    use = plateaus.number[i] >= plateaus.least
    if not use.any():
        return
    step, number = float(fitted.fits.step[i]), plateaus.number[i][use]
    worst = np.abs(plateaus.deviation_dn[i][use])
    noise = np.sqrt(max(fitted.noise.dark[i], fitted.noise.bright[i]) / number)
    bad = worst > np.maximum(SECOND_EDGE * step, 6 * noise)
    if bad.sum() >= 2 or (bad.any() and worst.max() > 3 * SECOND_EDGE * step):
        flags["two_edges"] = (
            f"{int(bad.sum())} of {int(use.sum())} parts of the plateaus differ by up to "
            f"{100 * worst.max() / step:.0f} % of the step; "
            "choose a region with a single edge"
        )


@dataclass(frozen=True, eq=False)
class Plateaus:
    """Mean deviation from the fit in patches of the plateaus, DN, and the samples in each, (regions, patches)."""

    deviation_dn: Float
    number: Float
    least: float


def plateau_residuals(fitted: FittedEdges) -> Plateaus:
    """Deviations of patches (an eighth of the region each way; every other row is looked at) away from the edges."""
    fits, b = fitted.fits, len(fitted)
    some = fitted.stack.every(2)
    distance = fitted.distance_px[:, fitted.stack.start(2) :: 2]
    rest = illumination_at(some, fitted.lines, fitted.illumination, fitted.half_px)
    np.divide(some.values, rest, out=rest)
    far = np.abs(distance) > np.maximum(6 * fits.width_px, 4.0)[:, None, None]
    place = distance * (1 / fitted.half_px)
    expected = np.where(distance > 0, (fits.dark + fits.step)[:, None, None], fits.dark[:, None, None])
    first, second = (fits.shading[:, k, None, None] for k in (0, 1))
    light = second * place
    light += first
    light *= place
    light += 1
    expected *= light
    rest -= expected
    rest *= far
    rows, cols = (max(1, n // 8) for n in rest.shape[1:])
    kr, kc = rest.shape[1] // rows, rest.shape[2] // cols
    cut = (slice(None), slice(0, kr * rows), slice(0, kc * cols))
    shape = (b, kr, rows, kc * cols)
    columns = np.repeat(np.eye(kc), cols, axis=0)
    number = (far[cut].reshape(shape).sum(axis=2) @ columns).reshape(b, -1)
    total = (rest[cut].reshape(shape).sum(axis=2) @ columns).reshape(b, -1)
    return Plateaus(total / np.maximum(number, 1), number, max(4, rows * cols // 3))
