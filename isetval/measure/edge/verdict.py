"""Reason codes: why an edge is refused, or accepted with a warning.

Refused (``flags``): ``roi_too_small``, ``no_edge``, ``low_contrast`` (step below 5 sigma of its
noise), ``saturated``, ``clipped_black``, ``angle_near_0``, ``angle_near_45``, ``angle_near_90``, ``phase_gaps``
(pixels see too few positions of the edge), ``edge_near_border``, ``too_blurred``, ``two_edges`` (more
than one transition, a corner or a pattern).  Warned: ``shallow_angle`` (below 3 degrees),
``short_edge`` (below 35, 70, 140 rows for one channel, greens, red or blue), ``clipped_black``,
``strong_shading``, ``mtf50_not_reached`` (the SFR stays above one half up to 2 cy/px).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.found import Estimates
from isetval.measure.edge.locate import FirstLooks, Transitions, is_sharp, pixel_noise, transitions
from isetval.measure.edge.samples import Samples
from isetval.measure.edge.shading import gain_of
from isetval.measure.edge.stack import Stack

Float = NDArray[np.floating[Any]]

MIN_SIDE_PX = {"MONO": 24, "G": 28, "Gr": 40, "Gb": 40, "R": 40, "B": 40}
GOOD_LENGTH_PX = {"MONO": 35, "G": 70, "Gr": 140, "Gb": 140, "R": 140, "B": 140}
MIN_STEP_SIGMA = 5.0
MIN_ANGLE_DEG = 0.75
SHALLOW_DEG = 3.0
MAX_CLIPPED = 0.08
MAX_CRUSHED = 0.5
SECOND_EDGE = 0.12
MISFIT = 0.07
ROUNDING = 1 / 12


@dataclass(frozen=True)
class Verdict:
    """Codes with the sentence that explains each."""

    flags: dict[str, str]
    warnings: dict[str, str]


def too_small(samples: Samples, channel: str) -> str | None:
    """Sentence if the region is too small for the channel."""
    height = samples.row_step_px * samples.values.shape[0]
    width = samples.step_px * samples.values.shape[1]
    need = MIN_SIDE_PX[channel]
    if min(height, width) >= need:
        return None
    return f"the region is {height:g} x {width:g} px; channel {channel} needs at least {need} px a side: enlarge it"


@dataclass(frozen=True, eq=False)
class Prospects:
    """What speaks against an edge before it is fitted: code and sentence of every region, or None; noise of a sample, DN."""

    reasons: list[tuple[str, str] | None]
    noise_dn: Float


def prospects(stack: Stack, looks: FirstLooks, width_px: Float) -> Prospects:
    """Whether the rows of every region agree on one edge."""
    noise, rough = pixel_noise(stack)
    seen = transitions(stack, dark=looks.dark, bright=looks.bright, noise=np.maximum(noise, rough))
    return Prospects([_not_an_edge(stack, looks, seen, width_px, i) for i in range(len(stack))], noise)


def _not_an_edge(stack: Stack, looks: FirstLooks, seen: Transitions, width_px: Float, i: int) -> tuple[str, str] | None:
    """Code and sentence if the rows do not agree on one edge."""
    several, against = float(seen.several[i]), float(seen.against[i])
    if seen.clear[i] and (several > 0.2 or against > 0.2):
        return "two_edges", (
            f"{100 * several:.0f} % of the rows cross between dark and bright more than once"
            + (" and others in opposite directions" if against > 0.2 else "")
            + "; choose a region with a single edge"
        )
    if not looks.found[i]:
        return "no_edge", "no row of the region crosses from dark to bright; place the region on an edge"
    reach = stack.step_px * stack.values.shape[2]
    rows, used = len(stack.y_px), int(looks.rows_used[i].sum())
    if used < max(8, 0.2 * rows) or looks.scatter_px[i] > 0.12 * reach:
        return "no_edge", (
            f"{used} of {rows} rows cross and scatter by {looks.scatter_px[i]:.1f} px about the best curve; "
            "place the region on one edge"
        )
    if width_px[i] > 0.12 * reach:
        if is_sharp(stack.values[i], float(looks.bright[i] - looks.dark[i])):
            return (
                "two_edges",
                "the rows change abruptly more than once or at different places; choose a region with a single edge",
            )
        return (
            "no_edge",
            f"the level changes smoothly over a quarter of the {reach:g} px or more: no edge, or too blurred for the region",
        )
    return None


def misfit(found: Estimates, i: int, *, seen_dn: float, noise_dn: float) -> str | None:
    """Sentence if one edge does not explain region ``i`` at all (``seen_dn``: step at first look)."""
    step, scatter = float(found.fits.step[i]), float(found.scatter_dn[i])
    noise = max(noise_dn, float(np.sqrt(ROUNDING)))
    if 0.4 * seen_dn < step < 2.5 * seen_dn and scatter < max(4 * noise, MISFIT * step):
        return None
    return (
        f"values at equal distance from the best edge scatter by {scatter:.3g} DN (noise {noise:.2g} DN, step "
        f"{seen_dn:.4g} DN): a corner, a pattern or several edges; choose a region with a single edge"
    )


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen before the fit: steps and noise, DN, (regions,)."""

    step_dn: Float
    noise_dn: Float


def judge(found: Estimates, seen: Seen, channels: list[str]) -> list[Verdict]:
    """All codes for the fitted edges."""
    plateaus = plateau_residuals(found)
    return [_judge(found, i, seen, channel, plateaus) for i, channel in enumerate(channels)]


def _judge(found: Estimates, i: int, seen: Seen, channel: str, plateaus: Plateaus) -> Verdict:
    flags: dict[str, str] = {}
    warnings: dict[str, str] = {}
    wrong = misfit(found, i, seen_dn=float(seen.step_dn[i]), noise_dn=float(seen.noise_dn[i]))
    if wrong:
        return Verdict({"two_edges": wrong}, {})
    slope = float(found.slope[i])
    _contrast(flags, found, i)
    _angle(flags, warnings, found, i)
    _clipping(flags, warnings, found, i)
    _sides(flags, found, i)
    if "edge_near_border" not in flags and "too_blurred" not in flags:
        _single(flags, found, i, plateaus)
    length = 2 * float(found.lines.y_half_px[i]) * float(np.hypot(1, slope))
    if length < GOOD_LENGTH_PX[channel]:
        warnings["short_edge"] = (
            f"the edge is {length:.0f} px long; channel {channel} is reliable from {GOOD_LENGTH_PX[channel]} px"
        )
    change = float(np.hypot(found.gain[i, 0], found.gain[i, 3]))
    if change > 0.3:
        warnings["strong_shading"] = f"illumination changes by {200 * change:.0f} % over the region"
    return Verdict(flags, warnings)


def _contrast(flags: dict[str, str], found: Estimates, i: int) -> None:
    step = float(found.fits.step[i])
    noise = float(np.sqrt((found.noise.dark[i] + found.noise.bright[i]) / 2))
    if step < MIN_STEP_SIGMA * noise:
        flags["low_contrast"] = (
            f"the step of {step:.4g} DN is {step / noise:.1f} sigma of the noise ({noise:.3g} DN); "
            f"it needs {MIN_STEP_SIGMA:g}: more light, more contrast or the mean of several frames"
        )


def _angle(flags: dict[str, str], warnings: dict[str, str], found: Estimates, i: int) -> None:
    angle, step_px = float(found.angle_deg[i]), found.stack.step_px
    name = "angle_near_90" if found.stack.members[i].transposed else "angle_near_0"
    near = found.near_px[i]
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


def _clipping(flags: dict[str, str], warnings: dict[str, str], found: Estimates, i: int) -> None:
    samples, distance, width = found.stack.members[i], found.distance_px[i], float(found.fits.width_px[i])
    if not (samples.clipped_high.any() or samples.clipped_low.any()):
        return
    bright = distance > 2 * width
    share = float(np.mean(samples.clipped_high[bright])) if bright.any() else 0.0
    if share > MAX_CLIPPED or (share > 0 and _clipped_patch(samples.clipped_high)):
        flags["saturated"] = f"{100 * share:.1f} % of the bright side is at the white level; expose less"
    dark = distance < -2 * width
    low = float(np.mean(samples.clipped_low[dark])) if dark.any() else 0.0
    if low > MAX_CRUSHED and samples.black_dn > 0:
        flags["clipped_black"] = (
            f"{100 * low:.0f} % of the dark side is at raw zero, {samples.black_dn:g} DN below black: its level is unknown; "
            "do not subtract black twice"
        )
    elif low > MAX_CLIPPED:
        warnings["clipped_black"] = f"{100 * low:.0f} % of the dark side is at raw zero; its noise is cut and its mean biased up"


def _clipped_patch(clipped: NDArray[np.bool_]) -> bool:
    """Whether some patch of 8 x 8 samples is clipped for the most part: no tail of the noise but a level cut off."""
    rows, cols = (n // 8 for n in clipped.shape)
    patches = clipped[: 8 * rows, : 8 * cols].reshape(rows, 8, cols, 8).sum(axis=(1, 3))
    return bool(patches.max() > 40)


def _sides(flags: dict[str, str], found: Estimates, i: int) -> None:
    width = float(found.fits.width_px[i])
    low, high = (float(part[i]) for part in found.reach_px)
    reach = min(-low, high)
    if width > 0.15 * (high - low):
        flags["too_blurred"] = f"the edge's width (sigma {width:.1f} px) fills the region; enlarge the region"
    elif reach < max(3.0, 3 * width):
        flags["edge_near_border"] = (
            f"one side of the edge reaches {reach:.1f} px; it needs {max(3.0, 3 * width):.1f}: move the region"
        )


@dataclass(frozen=True, eq=False)
class Plateaus:
    """Mean deviation from the fit in patches of the plateaus, DN, and the samples in each, (regions, patches)."""

    deviation_dn: Float
    number: Float
    least: float


def plateau_residuals(found: Estimates) -> Plateaus:
    """Deviations of patches (an eighth of the region each way; every other row is looked at) away from the edges."""
    fits, b = found.fits, len(found)
    some = found.stack.every(2)
    distance = found.distance_px[:, found.stack.start(2) :: 2]
    rest = gain_of(some, found.lines, found.gain, found.half_px)
    np.divide(some.values, rest, out=rest)
    far = np.abs(distance) > np.maximum(6 * fits.width_px, 4.0)[:, None, None]
    place = distance * (1 / found.half_px)
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


def _single(flags: dict[str, str], found: Estimates, i: int, plateaus: Plateaus) -> None:
    """Second transitions: plateaus that are not flat, or patches that disagree with the fit."""
    use = plateaus.number[i] >= plateaus.least
    if not use.any():
        return
    step, number = float(found.fits.step[i]), plateaus.number[i][use]
    worst = np.abs(plateaus.deviation_dn[i][use])
    noise = np.sqrt(max(found.noise.dark[i], found.noise.bright[i]) / number)
    bad = worst > np.maximum(SECOND_EDGE * step, 6 * noise)
    if bad.sum() >= 2 or (bad.any() and worst.max() > 3 * SECOND_EDGE * step):
        flags["two_edges"] = (
            f"{int(bad.sum())} of {int(use.sum())} parts of the plateaus differ by up to "
            f"{100 * worst.max() / step:.0f} % of the step; "
            "choose a region with a single edge"
        )
