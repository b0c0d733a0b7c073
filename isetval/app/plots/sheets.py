"""Sheets of a measurement: what the estimators found, each with its figure, its few numbers and its curves."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.app.plots import color, dark_series, edges, noise, shading
from isetval.app.plots.panels import legible
from isetval.app.words import with_sigma
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.quantity import Quantity
from isetval.core.scene import ChartTarget
from isetval.measure import chart, dark, emva1288, find_edges, photon_transfer, relative_illumination, sfr
from isetval.measure.noise.emva import EmvaRow, saturated
from isetval.measure.noise.transfer_result import PlaneTransfer

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isetval.core.sensor import RoiLike
    from isetval.measure.edge.sfr_result import SfrResult

Rows = Sequence[tuple[str, ...]]
Photons = Sequence[float | None] | None
ISO = "iso12233:2023"
PLACES = (("center", 0.0), ("part way", 0.7), ("corner", 1.0))
"""Where edges are shown in full: shares of half the diagonal, as ISO 12233 and lens tests divide the field."""
QUOTED = ("K", "sigma_d", "mu_e.sat", "DR", "SNR_max", "LE_min", "LE_max", "PRNU1288", "DSNU1288", "mu_c", "eta")


@dataclass(frozen=True, eq=False)
class Sheet:
    """One page of a measurement: title, table (first row the header), remarks, figure, curves for the JSON, EMVA 1288 table."""

    title: str
    table: Rows
    remarks: Sequence[str]
    figure: Figure
    curves: Mapping[str, Any] = field(default_factory=dict)
    emva: Sequence[EmvaRow] = ()


def edge_sheets(capture: Capture, name: str, *, channel: str = "G") -> list[Sheet]:
    """All regions found in a frame, and the edges nearest to center, part way and corner in full."""
    found = find_edges(capture, channel)
    results = [sfr(capture, roi, channel) for roi in found]
    reasons = Counter(edge.reason for edge in found.rejected)
    frame = Sheet(
        f"{name}: regions",
        (),
        [f"refused: {', '.join(f'{count} {reason}' for reason, count in reasons.most_common())}"] if reasons else [],
        edges.found_edges_figure(capture, found, results),
        {"rejected": [{"roi": list(edge.roi), "reason": edge.reason, "message": edge.message} for edge in found.rejected]},
    )
    accepted = [r for r in results if r.accepted]
    return [frame, sfr_sheet(capture, accepted, name)] if accepted else [frame]


def sfr_sheet(capture: Capture, results: Sequence[SfrResult], name: str) -> Sheet:
    """MTF50 over the field, SFR at three places, one edge profile; both MTF50, the default's and ISO 12233's."""
    from matplotlib.figure import Figure

    rows, cols = capture.mosaic.shape
    middle = ((rows - 1) / 2, (cols - 1) / 2)
    share = [np.hypot(r.edge_row_px - middle[0], r.edge_col_px - middle[1]) / np.hypot(*middle) for r in results]
    chosen = {place: results[int(np.argmin([abs(s - at) for s in share]))] for place, at in PLACES}
    chosen = {place: r for i, (place, r) in enumerate(chosen.items()) if r not in list(chosen.values())[:i]}
    if len(results) == 1:
        chosen, figure = {"this one": results[0]}, edges.sfr_figure(capture, results[0])
    else:
        figure = Figure(figsize=(13, 4), layout="constrained")
        field_axis, curve, profile = figure.subplots(1, 3)
        edges.plot_mtf50(results, field_axis, center_px=middle)
        edges.plot_sfr(chosen, curve)
        first = next(iter(chosen))
        edges.plot_edge_profile(chosen[first], profile)
        profile.set_title(f"edge at {first}", fontsize="medium")
    table: list[tuple[str, ...]] = [("edge", "region", "angle", "MTF50 (cy/px)", f"MTF50, {ISO} (cy/px)", "MTF10 (cy/px)")]
    for place, r in chosen.items():
        iso = sfr(capture, r.roi, r.channel, method=ISO)
        table.append(
            (
                place,
                ",".join(map(str, r.roi)),
                f"{r.angle_deg:.1f}°",
                with_sigma(r.mtf50_cy_px, r.mtf50_sigma, sign="±"),
                with_sigma(iso.mtf50_cy_px, iso.mtf50_sigma, sign="±") if iso.accepted else ", ".join(iso.flags),
                with_sigma(r.mtf10_cy_px, r.mtf10_sigma, sign="±"),
            )
        )
    return Sheet(
        f"{name}: sharpness, channel {results[0].channel}", table, (), figure, {"edges": [_edge_curves(r) for r in results]}
    )


def _edge_curves(r: SfrResult) -> dict[str, Any]:
    names = ("frequency_cy_px", "mtf", "mtf_sigma", "distance_px", "esf", "lsf")
    return {"roi": list(r.roi), "mtf50_cy_px": r.mtf50_cy_px, "mtf50_sigma": r.mtf50_sigma} | {
        n: plain(getattr(r, n)) for n in names
    }


def chart_sheet(capture: Capture, name: str) -> Sheet:
    """The chart where it was found, means and noise of its patches, its colour error.

    Raises
    ------
    MeasurementError
        Where there is no chart.
    """
    from matplotlib.figure import Figure

    from isetval.files.target_search import chart_in

    target = chart_in(capture).targets[0]
    assert isinstance(target, ChartTarget)
    boxes = [patch.box for patch in target.patches]
    result = chart(capture, boxes=boxes, names=[patch.name for patch in target.patches])
    figure = Figure(figsize=(14, 4.4), layout="constrained")
    frame, means, variances = figure.subplots(1, 3)
    _draw_boxes(capture, boxes, frame)
    color.plot_chart(result, means)
    color.plot_noise_line(result, variances)
    table: list[tuple[str, ...]] = [("patch", *(f"{plane} (DN)" for plane in result.planes))]
    for i, patch in enumerate(result.names):
        cells = (with_sigma(m, s, sign="±") for m, s in zip(result.mean_dn[i], result.sigma_dn[i], strict=True))
        table.append((f"{i + 1} {patch}", *cells))
    remarks = list(result.warnings)
    try:
        remarks.append(result.color_error().headline())
    except InputError as error:
        remarks.append(f"no colour error: {error}")
    curves = {"patches": list(result.names), "mean_dn": plain(result.mean_dn), "sigma_dn": plain(result.sigma_dn)}
    return Sheet(f"{name}: chart", table, remarks, figure, curves)


def _draw_boxes(capture: Capture, boxes: Sequence[RoiLike], axis: Axes) -> None:
    """The part of the frame that holds the boxes, and the boxes that are measured, numbered."""
    from matplotlib.patches import Rectangle

    edges.plot_frame(capture, axis)
    for number, (row0, row1, col0, col1) in enumerate(boxes, 1):
        axis.add_patch(Rectangle((col0 - 0.5, row0 - 0.5), col1 - col0, row1 - row0, fill=False, edgecolor="tab:green"))
        place = (col0 + col1) / 2, (row0 + row1) / 2
        axis.text(*place, str(number), color="tab:green", fontsize=8, ha="center", va="center", path_effects=legible())
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    margin = 0.15 * max(high[1] - low[0], high[3] - low[2])
    axis.set(xlim=(low[2] - margin, high[3] + margin), ylim=(high[1] + margin, low[0] - margin))


def transfer_sheet(
    flats: Sequence[Capture], darks: Sequence[Capture], name: str, *, method: str = "default", photons: Photons = None
) -> Sheet:
    """Photon transfer of a series with the table that people ask for; ``photons`` per pixel of each flat, where stated."""
    result = photon_transfer(flats, dark=darks or None, method=method, photons_per_pixel=photons)
    timed = all(transfer.linearity_from != "none" for transfer in result.values())
    quoted = [symbol for symbol in QUOTED if timed or not symbol.startswith("LE_")]  # of one light at several times only
    table_rows = emva1288(flats, dark=darks or None, photons_per_pixel=photons).rows if method == "default" else ()
    rows = [row for row in table_rows if row.symbol in quoted and np.isfinite(row.value)]
    planes = list(result)
    table: list[tuple[str, ...]] = [("quantity", *planes)]
    for symbol in dict.fromkeys(row.symbol for row in rows):
        own = {row.plane: row for row in rows if row.symbol == symbol}
        head = next(iter(own.values()))
        cells = (
            _bound(symbol, result[p]) + with_sigma(own[p].value, own[p].sigma, own[p].unit, sign="±") if p in own else ""
            for p in planes
        )
        table.append((f"{head.name} ({symbol})", *cells))
    remarks = _flag_words({plane: transfer.flags for plane, transfer in result.items()})
    curves = {
        plane: [
            {
                "time_s": level.time_s,
                "mean_dn": level.mean_dn,
                "variance_dn2": level.variance_dn2,
                "variance_sigma_dn2": level.variance_sigma_dn2,
                "used": level.used,
                "reason": level.reason,
            }
            for level in transfer.levels
        ]
        for plane, transfer in result.items()
    }
    figure = noise.transfer_figure(result)
    return Sheet(f"{name}: photon transfer", table, remarks, figure, {"photon_transfer": plain(curves)}, table_rows)


def _bound(symbol: str, transfer: PlaneTransfer) -> str:
    return "at least " if symbol in ("mu_e.sat", "DR", "SNR_max") and not saturated(transfer) else ""


def _flag_words(flags: Mapping[str, Sequence[str]]) -> list[str]:
    """What is doubted of which planes."""
    planes: dict[str, list[str]] = {}
    for plane, own in flags.items():
        for flag in own:
            planes.setdefault(flag, []).append(plane)
    return [f"{flag.replace('_', ' ')}: {', '.join(of)}" for flag, of in planes.items()]


def dark_sheet(darks: Sequence[Capture], name: str) -> Sheet:
    """Mean and noise of dark frames over exposure time; of one time, codes and lines of the first frame."""
    from matplotlib.figure import Figure

    result = dark(darks)
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    if len(next(iter(result.values())).levels) > 1:
        dark_series.plot_dark_mean(result, left)
        dark_series.plot_dark_noise(result, right)
    else:
        dark_series.plot_dark_codes(darks[0], left)
        dark_series.plot_dark_lines(darks[0], right)
    quantities = [key for key, value in vars(next(iter(result.values()))).items() if isinstance(value, Quantity)]
    table: list[tuple[str, ...]] = [("quantity", *result)]
    for key in quantities:
        own = [getattr(d, key) for d in result.values()]
        if any(np.isfinite(q.value) for q in own):
            table.append((_spoken(key), *map(_quantity_words, own)))
    counts = (f"{d.hot_pixels}, {d.noisy_pixels}, {d.struck_pixels}" for d in result.values())
    table.append(("hot, noisy, struck pixels", *counts))
    remarks = _flag_words({plane: d.flags for plane, d in result.items()})
    curves = {
        plane: [{"time_s": t, "mean_dn": v.black_dn.value, "read_variance_dn2": v.read_variance.value} for t, v in d.levels]
        for plane, d in result.items()
    }
    return Sheet(f"{name}: dark frames", table, remarks, figure, {"dark": plain(curves)})


def _spoken(field_name: str) -> str:
    """``dark_current_dn_per_s`` without its unit, which stands with the value."""
    return re.sub(r"_(dn2?|e)(_per_s)?$", "", field_name).replace("_", " ")


def _quantity_words(quantity: Quantity) -> str:
    if math.isfinite(quantity.total_sigma):
        return with_sigma(quantity.value, quantity.total_sigma, quantity.unit, sign="±")
    return f"{quantity.value:.3g} {quantity.unit} (no error bar)"


def illumination_sheet(flats: Sequence[Capture], darks: Sequence[Capture], name: str) -> Sheet:
    """Relative illumination: curves, colour shading, residual map, and what is left in the corner."""
    result = relative_illumination(flats, dark=darks or None)
    table: list[tuple[str, ...]] = [("relative illumination", *result.planes)]
    reach = min(float(plane.ring_radius_mm[-1]) for plane in result.planes.values())
    for share in (0.5, 0.75, 1.0):
        cells = []
        for plane in result.planes.values():
            value, sigma = plane.at(np.array([share * reach]))
            cells.append(with_sigma(float(value[0]), float(sigma[0]), sign="±"))
        table.append((f"at {share * reach:.2f} mm", *cells))
    curves = {
        plane: {"radius_mm": plain(p.radius_mm), "curve": plain(p.curve), "sigma": plain(p.sigma)}
        for plane, p in result.planes.items()
    }
    figure = shading.falloff_figure(result)
    return Sheet(f"{name}: relative illumination", table, list(result.warnings), figure, {"relative_illumination": curves})
