"""Reason codes: why an edge is refused, or accepted with a warning.

Refused (``flags``): ``roi_too_small``, ``no_edge``, ``low_contrast`` (step below 5 sigma of its
noise), ``saturated``, ``angle_near_0``, ``angle_near_45``, ``angle_near_90``, ``phase_gaps``
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

from isetval.measure.edge.estimate import Estimate, first_width
from isetval.measure.edge.locate import FirstLook, pixel_noise, transitions, two_levels
from isetval.measure.edge.refine import gain_of
from isetval.measure.edge.samples import Samples

Float = NDArray[np.floating[Any]]

MIN_SIDE_PX = {"MONO": 24, "G": 28, "Gr": 40, "Gb": 40, "R": 40, "B": 40}
GOOD_LENGTH_PX = {"MONO": 35, "G": 70, "Gr": 140, "Gb": 140, "R": 140, "B": 140}
MIN_STEP_SIGMA = 5.0
MIN_ANGLE_DEG = 0.75
SHALLOW_DEG = 3.0
MAX_CLIPPED = 0.08
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


def not_an_edge(samples: Samples, look: FirstLook | None) -> tuple[str, str] | None:
    """Code and sentence if the rows do not agree on one edge."""
    dark, bright = (look.dark, look.bright) if look is not None else two_levels(samples.values)
    noise = pixel_noise(samples.values)
    rough = 0.63 * float(np.mean(np.abs(samples.values[::3, 1:] - samples.values[::3, :-1])))
    seen = transitions(samples.values, dark=dark, bright=bright, noise=max(noise, rough))
    if seen.clear and (seen.several > 0.2 or seen.against > 0.2):
        return "two_edges", (
            f"{100 * seen.several:.0f} % of the rows cross between dark and bright more than once"
            + (" and others in opposite directions" if seen.against > 0.2 else "")
            + "; choose a region with a single edge"
        )
    if look is None:
        return "no_edge", "no row of the region crosses from dark to bright; place the region on an edge"
    reach = samples.step_px * samples.values.shape[1]
    rows = int(look.rows_used.sum())
    if rows < max(8, 0.2 * len(look.rows_used)) or look.scatter_px > 0.12 * reach:
        return "no_edge", (
            f"{rows} of {len(look.rows_used)} rows cross and scatter by {look.scatter_px:.1f} px about the best curve; "
            "place the region on one edge"
        )
    if first_width(samples, look.line, look) > 0.12 * reach:
        if _is_sharp(samples.values, bright - dark):
            return (
                "two_edges",
                "the rows change abruptly more than once or at different places; choose a region with a single edge",
            )
        return (
            "no_edge",
            f"the level changes smoothly over a quarter of the {reach:g} px or more: no edge, or too blurred for the region",
        )
    return None


def _is_sharp(values: Float, step: float) -> bool:
    """Whether a quarter of the rows change by a third of the step within three samples."""
    walk = np.cumsum(values[::2], axis=1)
    mean = (walk[:, 3:] - walk[:, :-3]) / 3
    steepest = np.abs(mean[:, 3:] - mean[:, :-3]).max(axis=1)
    return float(np.quantile(steepest, 0.75)) > step / 3


def misfit(samples: Samples, look: FirstLook, estimate: Estimate) -> str | None:
    """Sentence if one edge does not explain the region at all."""
    step, seen = estimate.fit.step, look.bright - look.dark
    noise = max(pixel_noise(samples.values), float(np.sqrt(ROUNDING)))
    scatter = float(np.sqrt(estimate.binned.scatter.sum() / estimate.binned.number.sum()))
    if 0.4 * seen < step < 2.5 * seen and scatter < max(4 * noise, MISFIT * step):
        return None
    return (
        f"values at equal distance from the best edge scatter by {scatter:.3g} DN (noise {noise:.2g} DN, step {seen:.4g} DN): "
        "a corner, a pattern or several edges; choose a region with a single edge"
    )


def judge(samples: Samples, look: FirstLook, estimate: Estimate, *, channel: str, angle_deg: float, length_px: float) -> Verdict:
    """All codes for a fitted edge."""
    flags: dict[str, str] = {}
    warnings: dict[str, str] = {}
    distance = estimate.distance_px
    wrong = misfit(samples, look, estimate)
    if wrong:
        return Verdict({"two_edges": wrong}, {})
    _contrast(flags, estimate)
    _angle(flags, warnings, samples, distance, angle_deg)
    _clipping(flags, warnings, samples, estimate, distance)
    _sides(flags, estimate, distance)
    if "edge_near_border" not in flags and "too_blurred" not in flags:
        _single(flags, samples, estimate, distance)
    if length_px < GOOD_LENGTH_PX[channel]:
        warnings["short_edge"] = (
            f"the edge is {length_px:.0f} px long; channel {channel} is reliable from {GOOD_LENGTH_PX[channel]} px"
        )
    slope = float(np.hypot(estimate.geometry.gain[0], estimate.geometry.gain[3]))
    if slope > 0.3:
        warnings["strong_shading"] = f"illumination changes by {200 * slope:.0f} % over the region"
    return Verdict(flags, warnings)


def _contrast(flags: dict[str, str], estimate: Estimate) -> None:
    noise = np.sqrt((estimate.noise.dark + estimate.noise.bright) / 2)
    if estimate.fit.step < MIN_STEP_SIGMA * noise:
        flags["low_contrast"] = (
            f"the step of {estimate.fit.step:.4g} DN is {estimate.fit.step / noise:.1f} sigma of the noise ({noise:.3g} DN); "
            f"it needs {MIN_STEP_SIGMA:g}: more light, more contrast or the mean of several frames"
        )


def _angle(flags: dict[str, str], warnings: dict[str, str], samples: Samples, distance: Float, angle_deg: float) -> None:
    angle = abs(angle_deg)
    name = "angle_near_90" if samples.transposed else "angle_near_0"
    near = np.sort(distance[np.abs(distance) < 2.5 * samples.step_px].ravel())
    gap = float(np.max(np.diff(near))) if len(near) > 1 else np.inf
    limit = 0.62 if samples.step_px == 1 else 1.0
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


def _clipping(flags: dict[str, str], warnings: dict[str, str], samples: Samples, estimate: Estimate, distance: Float) -> None:
    bright = distance > 2 * estimate.fit.width_px
    share = float(np.mean(samples.clipped_high[bright])) if bright.any() else 0.0
    if share > MAX_CLIPPED or (share > 0 and _clipped_patch(samples.clipped_high)):
        flags["saturated"] = f"{100 * share:.1f} % of the bright side is at the white level; expose less"
    dark = distance < -2 * estimate.fit.width_px
    low = float(np.mean(samples.clipped_low[dark])) if dark.any() else 0.0
    if low > MAX_CLIPPED and estimate.noise.dark > (0.01 * estimate.fit.step) ** 2:
        warnings["clipped_black"] = f"{100 * low:.0f} % of the dark side is at raw zero; its noise is cut and its mean biased up"


def _clipped_patch(clipped: NDArray[np.bool_]) -> bool:
    """Whether some patch of 8 x 8 samples is clipped for the most part: no tail of the noise but a level cut off."""
    rows, cols = (n // 8 for n in clipped.shape)
    patches = clipped[: 8 * rows, : 8 * cols].reshape(rows, 8, cols, 8).sum(axis=(1, 3))
    return bool(patches.max() > 40)


def _sides(flags: dict[str, str], estimate: Estimate, distance: Float) -> None:
    width = estimate.fit.width_px
    reach = min(-float(distance.min()), float(distance.max()))
    if width > 0.15 * (float(distance.max()) - float(distance.min())):
        flags["too_blurred"] = f"the edge's width (sigma {width:.1f} px) fills the region; enlarge the region"
    elif reach < max(3.0, 3 * width):
        flags["edge_near_border"] = (
            f"one side of the edge reaches {reach:.1f} px; it needs {max(3.0, 3 * width):.1f}: move the region"
        )


def _single(flags: dict[str, str], samples: Samples, estimate: Estimate, distance: Float) -> None:
    """Second transitions: plateaus that are not flat, or blocks that disagree with the fit (every other row is looked at)."""
    fit = estimate.fit
    samples, distance = samples.every(2), distance[((len(distance) - 1) % 2) // 2 :: 2]
    level = samples.values / gain_of(samples, estimate.geometry, distance)
    far = np.abs(distance) > max(6 * fit.width_px, 4.0)
    place = distance * (1 / estimate.geometry.half_px)
    expected = np.where(distance > 0, fit.dark + fit.step, fit.dark)
    expected *= 1 + place * (fit.coefficients[2] + fit.coefficients[3] * place)
    rest = np.where(far, level - expected, 0.0)
    rows, cols = (max(1, n // 8) for n in rest.shape)
    kr, kc = rest.shape[0] // rows, rest.shape[1] // cols
    cut = (slice(0, kr * rows), slice(0, kc * cols))
    shape = (kr, rows, kc, cols)
    number = far[cut].reshape(shape).sum(axis=(1, 3))
    total = rest[cut].reshape(shape).sum(axis=(1, 3))
    use = number >= max(4, rows * cols // 3)
    if not use.any():
        return
    worst = np.abs(total[use] / number[use])
    noise = np.sqrt(max(estimate.noise.dark, estimate.noise.bright) / number[use])
    bad = worst > np.maximum(SECOND_EDGE * fit.step, 6 * noise)
    if bad.sum() >= 2 or (bad.any() and worst.max() > 3 * SECOND_EDGE * fit.step):
        flags["two_edges"] = (
            f"{int(bad.sum())} of {int(use.sum())} parts of the plateaus differ by up to "
            f"{100 * worst.max() / fit.step:.0f} % of the step; "
            "choose a region with a single edge"
        )
