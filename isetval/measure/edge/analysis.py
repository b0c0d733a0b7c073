"""``sfr`` and ``sfr_batch``: from a capture and a region to a result with a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, check_roi
from isetval.core.errors import InputError
from isetval.measure.edge import spectrum
from isetval.measure.edge.estimate import Estimate, measure_edge
from isetval.measure.edge.locate import FirstLook, first_look
from isetval.measure.edge.result import SfrResult
from isetval.measure.edge.samples import Samples, check_channel, plane_samples
from isetval.measure.edge.smooth import FREQUENCY_STEP, EsfFit, solve_lower
from isetval.measure.edge.verdict import SHALLOW_DEG, judge, not_an_edge, too_small

Float = NDArray[np.floating[Any]]

METHODS = ("default", "iso12233:2017", "iso12233:2023", "lyu2022")
ROUNDING_VARIANCE = 1 / 12
NAN = float("nan")


def sfr(
    capture: Capture,
    roi: Roi | None = None,
    channel: str = "G",
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
) -> SfrResult:
    """Slanted-edge spatial frequency response of one region.

    Parameters
    ----------
    capture : Capture
        Raw mosaic or one-channel image, linear.
    roi : (row0, row1, col0, col1), half open, or None
        Region with one edge; None is the whole capture.
    channel : str
        ``R``, ``Gr``, ``Gb``, ``B`` or ``G`` (both greens, on the mosaic); ignored for one-channel captures.
    method : str
        ``default``; ``iso12233:2017``, ``iso12233:2023``: the published procedures; ``lyu2022``: the 2003-era
        procedure behind the paper's curves (demosaiced luminance, no slant and no derivative correction).
    choices : mapping or None
        ``choices`` of another result, to make the same data-driven choices (order of the edge, width and
        stiffness of the spline) again.

    Returns
    -------
    SfrResult
        ``flags`` names the reasons when the edge is refused; its numbers are NaN then.

    Raises
    ------
    InputError
        For a region outside the capture, an unknown channel or method.
    """
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it needs one of {', '.join(METHODS)}")
    if not isinstance(capture, Capture):
        raise InputError(f"sfr needs a Capture, not {type(capture).__name__}; see Capture.from_array")
    box = check_roi(capture, roi)
    channel = check_channel(capture, channel)
    if method != "default":
        from isetval.measure.edge.iso import compatibility_sfr

        return compatibility_sfr(capture, box, channel=channel, method=method)
    if min(box[1] - box[0], box[3] - box[2]) < 8:
        message = f"the region is {box[1] - box[0]} x {box[3] - box[2]} px; enlarge it"
        return refused(capture, box, channel=channel, flags={"roi_too_small": message})
    samples = plane_samples(capture, box, channel)
    small = too_small(samples, channel)
    if small:
        return refused(capture, box, channel=channel, flags={"roi_too_small": small})
    look = first_look(samples)
    if look is not None and abs(look.line.position(np.array([look.line.y_center_px]))[1][0]) > 1.03:
        samples = plane_samples(capture, box, channel, transposed=not samples.transposed)
        look = first_look(samples)
    nothing = not_an_edge(samples, look)
    if nothing or look is None:
        code, sentence = nothing or ("no_edge", "")
        return refused(capture, box, channel=channel, flags={code: sentence} | _saturated(samples))
    try:
        estimate = measure_edge(samples, look, floor=ROUNDING_VARIANCE, choices=choices)
    except np.linalg.LinAlgError:
        message = "no single edge explains the region; choose a region with one edge"
        return refused(capture, box, channel=channel, flags={"two_edges": message})
    return _report(capture, box, channel, samples=samples, look=look, estimate=estimate)


def sfr_batch(
    captures: Capture | Sequence[Capture],
    rois: Sequence[Roi | None],
    channel: str = "G",
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
) -> list[SfrResult]:
    """``sfr`` of many regions: of one capture, or of as many captures as regions.

    Raises
    ------
    InputError
        When the numbers of captures and regions differ.
    """
    many = [captures] * len(rois) if isinstance(captures, Capture) else list(captures)
    if len(many) != len(rois):
        raise InputError(f"{len(many)} captures and {len(rois)} regions; give one capture, or one for each region")
    return [sfr(c, r, channel, method=method, choices=choices) for c, r in zip(many, rois, strict=True)]


def _saturated(samples: Samples) -> dict[str, str]:
    share = float(samples.clipped_high.mean())
    return {"saturated": f"{100 * share:.0f} % of the region is at the white level; expose less"} if share > 0.3 else {}


def refused(capture: Capture, roi: Roi, *, channel: str, flags: Mapping[str, str], method: str = "default") -> SfrResult:
    """A result without numbers."""
    frequency = spectrum.default_frequency()
    empty = np.zeros(0)
    return SfrResult(
        frequency_cy_px=frequency,
        mtf=np.full(len(frequency), NAN),
        mtf50_cy_px=NAN,
        mtf50_sigma=NAN,
        mtf30_cy_px=NAN,
        mtf30_sigma=NAN,
        mtf10_cy_px=NAN,
        mtf10_sigma=NAN,
        mtf50p_cy_px=NAN,
        mtf50p_sigma=NAN,
        angle_deg=NAN,
        orientation="unknown",
        normal_deg=NAN,
        flags=tuple(flags),
        warnings=(),
        edge_row_px=NAN,
        edge_col_px=NAN,
        edge_sigma_px=NAN,
        sagitta_px=NAN,
        curvature_per_px=NAN,
        polynomial=empty,
        roughness_px=NAN,
        dark_dn=NAN,
        bright_dn=NAN,
        dark_sigma_dn=NAN,
        bright_sigma_dn=NAN,
        noise_dark_dn=NAN,
        noise_bright_dn=NAN,
        channel=channel,
        roi=roi,
        pixel_um=capture.sensor.pixel_um,
        method=method,
        settings=_settings(capture, method),
        choices={},
        messages=dict(flags),
    )


def _settings(capture: Capture, method: str) -> dict[str, Any]:
    return {
        "method": method,
        "cfa": capture.sensor.cfa,
        "window": list(capture.window),
        "frequency_step_cy_px": FREQUENCY_STEP,
    }


def _report(capture: Capture, roi: Roi, channel: str, *, samples: Samples, look: FirstLook, estimate: Estimate) -> SfrResult:
    fit, line = estimate.fit, estimate.geometry.line
    slope = line.middle()[1]
    angle = folded_angle(float(np.degrees(np.arctan(slope))))
    length = 2 * line.y_half_px * float(np.hypot(1, slope))
    verdict = judge(samples, look, estimate, channel=channel, angle_deg=angle, length_px=length)
    inflation = _inflation(estimate, angle)
    frequency = spectrum.default_frequency()
    curve = spectrum.mtf_of(fit, frequency)
    numbers = _numbers(fit, frequency, curve=curve, inflation=inflation)
    warnings = dict(verdict.warnings)
    if not verdict.flags and np.isnan(numbers["mtf50_cy_px"]):
        warnings["mtf50_not_reached"] = f"the SFR stays above one half up to {frequency[-1]:g} cy/px"
    if verdict.flags:
        curve, numbers = np.full(len(curve), NAN), dict.fromkeys(numbers, NAN)
    return SfrResult(
        frequency_cy_px=frequency,
        mtf=curve,
        **numbers,
        **_place(estimate, transposed=samples.transposed),
        **_levels(estimate),
        flags=tuple(verdict.flags),
        warnings=tuple(warnings),
        channel=channel,
        roi=roi,
        pixel_um=capture.sensor.pixel_um,
        method="default",
        settings=_settings(capture, "default"),
        choices=estimate.choices,
        inflation=inflation,
        fit=fit,
        reach_px=(float(estimate.distance_px.min()), float(estimate.distance_px.max())),
        messages=verdict.flags | warnings,
    )


def _numbers(fit: EsfFit, frequency: Float, *, curve: Float, inflation: float) -> dict[str, Any]:
    """Crossings of 50, 30, 10 % and of half the peak, with sigma."""
    levels = np.array([0.5, 0.3, 0.1, 0.5 * float(curve.max())])
    found = spectrum.crossings(fit, frequency, curve=curve, levels=levels)
    out = {}
    for name, crossing in zip(("mtf50", "mtf30", "mtf10", "mtf50p"), found, strict=True):
        out[f"{name}_cy_px"], out[f"{name}_sigma"] = crossing.value, crossing.sigma * inflation
    return out


def _place(estimate: Estimate, *, transposed: bool) -> dict[str, Any]:
    """Where the edge lies and how it runs."""
    line = estimate.geometry.line
    x, slope = line.middle()
    normal = normal_direction(slope, line.sign, transposed=transposed)
    row, col = (x, line.y_center_px) if transposed else (line.y_center_px, x)
    _, _, bend = line.position(np.array([line.y_center_px]))
    return {
        "angle_deg": folded_angle(normal),
        "orientation": "horizontal" if transposed != (abs(slope) > 1) else "vertical",
        "normal_deg": normal,
        "edge_row_px": row,
        "edge_col_px": col,
        "edge_sigma_px": estimate.edge_sigma_px,
        "sagitta_px": _sagitta(estimate),
        "curvature_per_px": float(bend[0] / (1 + slope**2) ** 1.5),
        "polynomial": line.coefficients,
        "roughness_px": estimate.roughness_px,
    }


def _levels(estimate: Estimate) -> dict[str, Any]:
    """Levels and noise of both sides."""
    dark_sigma, bright_sigma = level_sigma(estimate.fit)
    return {
        "dark_dn": estimate.fit.dark,
        "bright_dn": estimate.fit.dark + estimate.fit.step,
        "dark_sigma_dn": dark_sigma,
        "bright_sigma_dn": bright_sigma,
        "noise_dark_dn": float(np.sqrt(estimate.noise.dark)),
        "noise_bright_dn": float(np.sqrt(estimate.noise.bright)),
    }


def normal_direction(slope: float, sign: float, *, transposed: bool) -> float:
    """Direction from dark to bright in degrees, 0 = larger columns, 90 = larger rows; ``slope`` is dx/dy."""
    along_x, along_y = sign, -sign * slope
    if transposed:
        along_x, along_y = along_y, along_x
    return float(np.degrees(np.arctan2(along_y, along_x)) % 360)


def folded_angle(normal_deg: float) -> float:
    """Angle from the nearer pixel axis, -45 to 45; positive turns larger columns towards larger rows."""
    return float((normal_deg + 45) % 90 - 45)


def level_sigma(fit: EsfFit) -> tuple[float, float]:
    """Standard deviations of the dark and the bright level, DN."""
    pick = np.zeros((2, len(fit.coefficients)))
    pick[0, 0] = pick[1, 0] = pick[1, 1] = 1.0
    half = solve_lower(fit.lower, (pick * fit.mode_root).T)
    dark, bright = np.sqrt((half * half).sum(axis=0))
    return float(dark), float(bright)


def _inflation(estimate: Estimate, angle_deg: float) -> float:
    """Factor on sigma: misfit beyond the noise, and shallow angles (few independent phases)."""
    misfit = max(1.0, estimate.fit.chi2 / max(estimate.fit.cells - 12, 1)) ** 0.5
    return float(misfit * max(1.0, SHALLOW_DEG / max(abs(angle_deg), 0.1)))


def _sagitta(estimate: Estimate) -> float:
    """Bow of the fitted polynomial over its length, px along the normal."""
    line = estimate.geometry.line
    if line.order < 2:
        return 0.0
    y = line.y_center_px + line.y_half_px * np.linspace(-1, 1, 41)
    x, _, _ = line.position(y)
    chord = x[0] + (x[-1] - x[0]) * np.linspace(0, 1, 41)
    bow = (x - chord) / np.hypot(1, (x[-1] - x[0]) / (y[-1] - y[0]))
    return float(bow[np.argmax(np.abs(bow))])
