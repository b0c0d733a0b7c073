"""From fitted edges to results: numbers, places, levels, verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.sensor import RoiLike
from isetval.measure.edge import spectrum
from isetval.measure.edge.alternating_fit import FittedEdges
from isetval.measure.edge.clipped_tails import clipped_share, lost_information
from isetval.measure.edge.esf_fit import EsfFit
from isetval.measure.edge.geometry import EdgeLines, origin_of
from isetval.measure.edge.samples import Oecf
from isetval.measure.edge.sfr_result import SfrResult, level_covariance
from isetval.measure.edge.spectrum import FREQUENCY_STEP
from isetval.measure.edge.verdict import SHALLOW_DEG, Seen, Verdict, judge

Float = NDArray[np.floating[Any]]


NAN = float("nan")
LEVELS = (0.5, 0.3, 0.1)  # of MTF50, MTF30, MTF10


@dataclass(frozen=True)
class Request:
    """What was asked for: a region of a capture in one channel."""

    capture: Capture
    roi: RoiLike
    channel: str
    oecf: Oecf = None


def results_of_fit(requests: Sequence[Request], fitted: FittedEdges, seen: Seen) -> list[SfrResult]:
    """Results of regions that were fitted together."""
    frequency = spectrum.default_frequency()
    curves = spectrum.default_curves(fitted.fits)
    top = 0.5 * curves.max(axis=1, keepdims=True)
    levels = np.concatenate([np.broadcast_to(LEVELS, (len(fitted), 3)), top], axis=1)
    crossings = spectrum.crossings(fitted.fits, frequency, curves=curves, levels=levels)
    verdicts = judge(fitted, seen, [request.channel for request in requests], curves)
    misfit = np.sqrt(np.maximum(fitted.fits.chi2 / np.maximum(fitted.fits.cells - 12, 1), 1.0))
    # sigma grows with misfit beyond the noise, and at shallow angles (few independent phases)
    inflation = misfit * np.maximum(SHALLOW_DEG / np.maximum(fitted.angle_deg, 0.1), 1.0)
    # restored tails lower the scatter and hold no information: both by the same share
    inflation /= 1 - np.array([lost_information(clipped_share(fitted, i)) for i in range(len(fitted))])
    sigma = crossings.sigma * inflation[:, None]
    out = []
    for i, (request, verdict) in enumerate(zip(requests, verdicts, strict=True)):
        numbers = _numbers(crossings.value[i], sigma[i])
        out.append(_result(request, fitted, i, verdict=verdict, curve=curves[i], numbers=numbers, inflation=float(inflation[i])))
    return out


def _numbers(value: Float, sigma: Float) -> dict[str, Any]:
    """Crossings of 50, 30, 10 % and of half the peak, with sigma."""
    out: dict[str, Any] = {}
    for name, v, s in zip(("mtf50", "mtf30", "mtf10", "mtf50p"), value.tolist(), sigma.tolist(), strict=True):
        out[f"{name}_cy_px"], out[f"{name}_sigma"] = v, s
    return out


def _result(
    request: Request,
    fitted: FittedEdges,
    i: int,
    *,
    verdict: Verdict,
    curve: Float,
    numbers: dict[str, Any],
    inflation: float,
) -> SfrResult:
    fit, frequency = fitted.fits.one(i), spectrum.default_frequency()
    warnings = dict(verdict.warnings)
    if not verdict.flags and np.isnan(numbers["mtf50_cy_px"]):
        warnings["mtf50_not_reached"] = f"the SFR stays above one half up to {frequency[-1]:g} cy/px"
    if verdict.flags:
        curve, numbers = np.full(len(curve), NAN), dict.fromkeys(numbers, NAN)
    return SfrResult(
        frequency_cy_px=frequency,
        mtf=curve,
        **numbers,
        **_place(fitted, i),
        **_levels(fitted, i, fit),
        flags=tuple(verdict.flags),
        warnings=tuple(warnings),
        channel=request.channel,
        roi=request.roi,
        pixel_um=request.capture.sensor.pixel_um,
        method="default",
        settings=_settings(request.capture, "default", request.oecf),
        choices=fitted.choices(i),
        inflation=inflation,
        fit=fit,
        illumination_covariance=fitted.level_covariance[i],
        reach_px=(float(fitted.reach_px[0][i]), float(fitted.reach_px[1][i])),
        messages=verdict.flags | warnings,
    )


def _place(fitted: FittedEdges, i: int) -> dict[str, Any]:
    """Where the edge lies and how it runs."""
    samples = fitted.stack.members[i]
    x0, y0 = origin_of(samples)
    x, slope = float(fitted.lines.middle[0][i]), float(fitted.slope[i])
    normal = normal_direction(slope, float(fitted.lines.sign[i]), transposed=samples.transposed)
    along, across = float(fitted.lines.y_center_px[i]) + y0, x + x0
    row, col = (across, along) if samples.transposed else (along, across)
    order = int(fitted.lines.order[i])
    polynomial = fitted.lines.coefficients[i, : order + 1].copy()
    polynomial[0] += x0
    sagitta, bend = _bow(fitted.lines.pick(np.array([i]))) if order > 1 else (0.0, 0.0)
    return {
        "angle_deg": folded_angle(normal),
        "orientation": "horizontal" if samples.transposed != (abs(slope) > 1) else "vertical",
        "normal_deg": normal,
        "edge_row_px": row,
        "edge_col_px": col,
        "edge_sigma_px": float(fitted.edge_sigma_px[i]),
        "sagitta_px": sagitta,
        "curvature_per_px": bend / (1 + slope**2) ** 1.5,
        "polynomial": polynomial,
        "roughness_px": float(fitted.roughness_px[i]),
    }


def _bow(line: EdgeLines) -> tuple[float, float]:
    """Bow of one line over its length, px along the normal, and d2x/dy2 at its middle, 1/px."""
    y = line.y_half_px[0] * np.linspace(-1, 1, 41)
    x, _, bend = (part if part is None else part[0] for part in line.at_rows(line.polynomials(line.y_center_px[0] + y)))
    assert x is not None
    assert bend is not None
    chord = x[0] + (x[-1] - x[0]) * np.linspace(0, 1, 41)
    bow = (x - chord) / np.hypot(1, (x[-1] - x[0]) / (y[-1] - y[0]))
    return float(bow[np.argmax(np.abs(bow))]), float(bend[20])


def _levels(fitted: FittedEdges, i: int, fit: EsfFit) -> dict[str, Any]:
    """Levels and noise of both sides."""
    dark_sigma, bright_sigma = np.sqrt(np.diag(level_covariance(fit, fitted.level_covariance[i], kind="posterior"))).tolist()
    return {
        "dark_dn": fit.dark,
        "bright_dn": fit.dark + fit.step,
        "dark_sigma_dn": dark_sigma,
        "bright_sigma_dn": bright_sigma,
        "noise_dark_dn": float(np.sqrt(fitted.noise.dark[i])),
        "noise_bright_dn": float(np.sqrt(fitted.noise.bright[i])),
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


def refused(capture: Capture, roi: RoiLike, *, channel: str, flags: Mapping[str, str], method: str = "default") -> SfrResult:
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


def _settings(capture: Capture, method: str, oecf: Oecf = None) -> dict[str, Any]:
    return {
        "oecf": oecf if oecf is None or isinstance(oecf, str) else np.asarray(oecf, dtype=float).tolist(),
        "method": method,
        "cfa": capture.sensor.cfa,
        "window": list(capture.window),
        "frequency_step_cy_px": FREQUENCY_STEP,
    }
