"""Flats and darks: means, temporal and fixed variances, neighbor covariance, per color plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_view
from isetval.core.metric import Block, Differences, Metric
from isetval.core.quantity import Quantity
from isetval.measure.conditions import VALUES_ALONE, metric, shot_conditions, window_label
from isetval.measure.noise.code_counts import code_counts
from isetval.measure.noise.frame_scatter import LEAST_FRAMES, frame_scatter, level_variance
from isetval.measure.noise.statistics import PlaneStatistics, dark_statistics, flat_statistics, frame_drift, tilt_power

Float = NDArray[np.float64]
ROLES = ("dark", "flat")
DRAWS = {"dark": 12, "flat": 4}
"""Specimens over which differences of a rare pattern are averaged: a few hot pixels scatter by 1/sqrt(draws); a dark costs a
tenth of a flat."""
PLATEAU_SIGMA_DN = 0.3  # a clipped plane has no noise of its own: rounding
MOST_ALIKE = 0.99  # correlation that is stated at most: beyond it one row's rounding would decide a difference
SATURATED = 0.5  # of the pixels clipped: what is left is no distribution
TOUCHED = 1e-3  # of the pixels clipped: beyond it the variance is biased by more than its sigma
QUANTITIES = {
    "mean_dn": ("mean", "DN"),
    "trimmed_temporal_variance_dn2": ("temporal_variance", "DN^2"),
    "row_temporal_variance_dn2": ("row_noise_variance", "DN^2"),
    "fixed_pixel_variance_dn2": ("fixed_pixel_variance", "DN^2"),
    "fixed_row_variance_dn2": ("fixed_row_variance", "DN^2"),
    "fixed_column_variance_dn2": ("fixed_column_variance", "DN^2"),
    "gradient_row_dn": ("gradient", "DN"),
    "gradient_column_dn": ("gradient", "DN"),
}
FRAME_SCATTER = "frame_scatter"
GIVES = ("mean", "temporal_variance", "row_noise_variance", "fixed_pixel_variance", "fixed_row_variance", "fixed_column_variance")
COUNTS = {
    "outlier_fraction": ("outliers", 0.85),
    "noisy_pixel_fraction": ("noisy_pixels", 0.5),
    "struck_pixel_fraction": ("struck_pixels", 0.0),
}
"""Counts of pixels, and the share of their variance that all counts of a window have in common: a hot
pixel that stands out at 0.5 s does so at 2 s too (nested Poisson counts: correlation sqrt(n1 / n2)) and is
noisy as well; noisy pixels are partly chance; pixels that a particle struck are others in each frame."""


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Statistics of all frames of one dark or flat shot; nothing is chosen from the data.

    Values alone, without error bars, where ``choices`` ask ``for_differences``.
    """
    values_alone = bool(choices.get(VALUES_ALONE))
    captures = tuple(captures)  # a long series decodes a file at every access
    statistics = (dark_statistics if shot.role == "dark" else flat_statistics)(captures, codes=False)
    conditions = shot_conditions(shot, captures[0].sensor)
    planes = [plane for plane in statistics if plane != "mosaic"]
    shares = {plane: _clipped(captures, plane) for plane in planes}
    whole = max(shares.values()) <= TOUCHED
    rows: list[Metric] = []
    links: list[tuple[str, list[int], list[int]]] = []
    shared: dict[str, list[tuple[int, float]]] = {}
    for plane, plane_statistics in statistics.items():
        if plane == "mosaic":
            rows += _neighbors(shot, conditions, plane_statistics) if whole else []
            continue
        names = list(plane_statistics)
        lines = _lines_of(shot, captures[0], plane)
        here, there = [], []
        clipped = shares[plane]
        if clipped > SATURATED:
            level = plane_statistics["mean_dn"].value
            rows.append(
                metric(conditions, "plateau", level, PLATEAU_SIGMA_DN, "DN", channel=plane, family=f"{shot.role}_plateau")
            )
            continue
        for key, (name, unit) in QUANTITIES.items():
            quantity = plane_statistics[key]
            if clipped > TOUCHED and name != "mean":
                continue
            if not (math.isfinite(quantity.value) and math.isfinite(quantity.sigma)):
                continue
            here.append(len(rows))
            there.append(names.index(key))
            for label, part in () if values_alone else _specimen_loadings(shot, lines, plane_statistics, key).items():
                shared.setdefault(label, []).append((len(rows), part))
            region = key.removeprefix("gradient_").removesuffix("_dn") if name == "gradient" else ""
            rows.append(
                metric(
                    conditions,
                    name,
                    quantity.value,
                    quantity.sigma,
                    unit,
                    channel=plane,
                    region=region,
                    family=f"{shot.role}_{name}",
                )
            )
        links.append((plane, here, there))
        if clipped <= TOUCHED:
            rows += _drift(shot, conditions, plane_statistics)
            for row, common in _counts(shot, conditions, plane, plane_statistics):
                shared.setdefault(f"{shot.role}:defects:{plane}:{window_label(shot)}", []).append((len(rows), common))
                rows.append(row)
    if whole and shot.role == "flat":
        rows += _scatter_of_frames(shot, conditions, [statistics[plane] for plane in planes], values_alone)
    if whole:
        for row, of_specimen in _pattern_neighbors(shot, conditions, [statistics[plane] for plane in planes]):
            shared.setdefault(f"{shot.role}:pattern:{row.region}:{window_label(shot)}", []).append((len(rows), of_specimen))
            rows.append(row)
    differences = Differences(draws=DRAWS[shot.role])
    if values_alone:
        return Block(tuple(rows), differences=differences)
    correlation = np.eye(len(rows))
    for plane, here, there in links:
        correlation[np.ix_(here, here)] = statistics[plane].correlation[np.ix_(there, there)]
    _share_row_noise(correlation, rows, captures[0], statistics)
    columns = {label: _column(entries, len(rows)) for label, entries in shared.items()}
    return Block(tuple(rows), correlation, columns, differences=differences)


def _share_row_noise(
    correlation: Float, rows: Sequence[Metric], capture: Capture, statistics: Mapping[str, PlaneStatistics]
) -> None:
    """Correlate, in place, what row noise gives the two planes that lie on the same mosaic rows.

    Row means of the planes go together by r = V_row / (V_row + V_pixel / cols) each: so do their means, rises and drifts, and
    their squares (variances of row means) by the product.
    """
    place = {(row.name, row.region, row.channel): i for i, row in enumerate(rows)}
    for a, b in combinations([plane for plane in statistics if plane != "mosaic"], 2):
        (first, at_a, _), (second, at_b, _) = plane_view(capture, a), plane_view(capture, b)
        if at_a[0] != at_b[0]:
            continue
        ours = [statistics[plane]["row_temporal_variance_dn2"].value for plane in (a, b)]
        common = max(sum(ours) / 2, 0.0)
        pixel = [statistics[p]["temporal_variance_dn2"].value / view.shape[1] for p, view in ((a, first), (b, second))]
        if not (common > 0 and min(pixel) > 0):
            continue
        r = min(common / math.sqrt((common + pixel[0]) * (common + pixel[1])), MOST_ALIKE)
        for name, region, value in (
            ("mean", "", r),
            ("gradient", "row", r),
            ("frame_drift", "", r),
            ("row_noise_variance", "", r * r),
        ):
            i, j = place.get((name, region, a)), place.get((name, region, b))
            if i is not None and j is not None:
                correlation[i, j] = correlation[j, i] = value


def _drift(shot: Shot, conditions: dict[str, Any], statistics: PlaneStatistics) -> list[Metric]:
    """Rise of the frames' means from the first to the last: what the mean over frames hides.  It is independent of that mean."""
    if statistics.frames < LEAST_FRAMES:
        return []
    rise = frame_drift(statistics.frame_means_dn, statistics.frame_mean_sigma_dn)
    family = f"{shot.role}_frame_drift"
    return [metric(conditions, "frame_drift", rise.value, rise.sigma, "DN", channel=statistics.plane, family=family)]


def _scatter_of_frames(
    shot: Shot, conditions: dict[str, Any], planes: Sequence[PlaneStatistics], values_alone: bool
) -> list[Metric]:
    """How far the levels of a flat's frames scatter, all planes together (`frame_scatter`); for differences the variance itself.

    Differences are means over draws: that of a variance follows what a light that flickers adds, its cube root does not.
    """
    total = np.sum([plane.frame_means_dn for plane in planes], axis=0)
    level = float(np.mean(total))
    if planes[0].frames < 2 or level <= 0:
        return []
    found = frame_scatter(total / level, sum(plane.frame_mean_sigma_dn**2 for plane in planes) / level**2)
    value = level_variance(total / level)[0] if values_alone else found.value
    return [metric(conditions, FRAME_SCATTER, value, found.sigma, "1", channel="mosaic", family=f"{shot.role}_{FRAME_SCATTER}")]


def _clipped(captures: Sequence[Capture], plane: str) -> float:
    """Share of the plane's pixels at white or at code 0."""
    white = captures[0].sensor.white_dn
    each = [code_counts(capture)[plane] for capture in captures]
    return float(np.mean([(codes.at_zero + codes.from_code(white)) / codes.pixels for codes in each]))


def _column(entries: list[tuple[int, float]], n: int) -> Any:
    out = np.zeros(n)
    for row, loading in entries:
        out[row] = loading
    return out


def _neighbors(shot: Shot, conditions: dict[str, Any], statistics: PlaneStatistics) -> list[Metric]:
    """Neighbor covariance of the temporal noise: mean over the color pairs, per direction."""
    rows = []
    for direction in ("h", "v"):
        parts = [statistics[name] for name in statistics if name.startswith(f"covariance_{direction}")]
        pooled = _mean(parts)
        if math.isfinite(pooled.value):
            family = f"{shot.role}_neighbour_covariance"
            rows.append(
                metric(conditions, "neighbour_covariance", pooled.value, pooled.sigma, "DN^2", region=direction, family=family)
            )
    return rows


def _pattern_neighbors(shot: Shot, conditions: dict[str, Any], planes: Sequence[PlaneStatistics]) -> list[tuple[Metric, float]]:
    """Neighbor covariance of the fixed pattern, mean over the planes, per direction, with the specimen's part of its sigma.

    0 where pixels differ each by itself: marks of the wafer, polish or a cover glass have a size, and show here only.
    """
    rows = []
    for direction in ("h", "v"):
        pooled = _mean([part[f"fixed_covariance_{direction}_dn2"] for part in planes])
        if math.isfinite(pooled.value) and pooled.total_sigma > 0:
            name, family = "fixed_neighbour_covariance", f"{shot.role}_fixed_neighbour_covariance"
            rows.append(
                (metric(conditions, name, pooled.value, pooled.sigma, "DN^2", region=direction, family=family), pooled.shared)
            )
    return rows


def _mean(parts: Sequence[Quantity]) -> Quantity:
    n = max(len(parts), 1)
    sigma, shared = (math.sqrt(sum(getattr(part, key) ** 2 for part in parts)) / n for key in ("sigma", "shared"))
    return Quantity(sum(part.value for part in parts) / n if parts else math.nan, sigma, "DN^2", shared)


def _counts(shot: Shot, conditions: dict[str, Any], plane: str, statistics: PlaneStatistics) -> list[tuple[Metric, float]]:
    """Numbers of outlying, of noisy and of struck pixels with the shared part of sigma.

    Given as ``2 sqrt(n + 3/8)``: near-Gaussian with a total sigma of 1 (Anscombe).
    """
    rows = []
    for key, (name, common) in COUNTS.items():
        fraction = statistics[key].value
        if math.isfinite(fraction):
            root = 2 * math.sqrt(fraction * statistics.pixels + 0.375)
            own, family = math.sqrt(1 - common), f"{shot.role}_{name}"
            row = metric(conditions, name, root, own, "2 sqrt(count + 3/8)", channel=plane, family=family, count=True)
            rows.append((row, math.sqrt(common)))
    return rows


@dataclass(frozen=True)
class _Lines:
    """Where the rows and columns of a plane lie on the sensor, in words, and their numbers."""

    row: str
    rows: int
    column: str
    columns: int


def _lines_of(shot: Shot, capture: Capture, plane: str) -> _Lines:
    view, (row, col), _ = plane_view(capture, plane)
    row0, col0, height, width = shot.window or (0, 0, *capture.mosaic.shape)
    return _Lines(f"{(row0 + row) % 2}:{row0},{height}", view.shape[0], f"{(col0 + col) % 2}:{col0},{width}", view.shape[1])


def _specimen_loadings(shot: Shot, place: _Lines, statistics: PlaneStatistics, key: str) -> dict[str, float]:
    """Labels of the random numbers in a quantity of one plane, and how much of its sigma each makes.

    Pixels belong to their plane and, dark or lit, to another pattern (offsets, gains).  A row's offset is the
    same in both planes that lie on it, in darks and in flats, at every exposure; likewise a column's.  Only the
    lines' variances tie flats to darks: of a flat's mean and rise the light makes more than any line.
    """
    quantity = statistics[key]
    if not quantity.shared > 0:
        return {}
    name = key.removesuffix("_dn2").removesuffix("_dn")
    kind = name if name.startswith("fixed") else f"{shot.role} {name}"
    lines = {
        f"row:{kind}:{place.row}": _of_lines(key, "row", statistics, place.rows),
        f"column:{kind}:{place.column}": _of_lines(key, "column", statistics, place.columns),
    }
    whole = math.hypot(*lines.values())
    shrink = min(1.0, quantity.shared / whole) if whole > 0 else 1.0
    out = {label: shrink * part for label, part in lines.items() if part > 0}
    own = math.sqrt(max(quantity.shared**2 - (shrink * whole) ** 2, 0.0))
    return out | {f"{shot.role}:{name}:{statistics.plane}:{window_label(shot)}": own} if own > 0 else out


def _of_lines(key: str, line: str, statistics: PlaneStatistics, count: int) -> float:
    """Standard deviation that ``count`` fixed rows (or columns) of a plane give to a quantity, over specimens."""
    variance = max(0.0, statistics[f"fixed_{line}_variance_dn2"].value)
    if key == "mean_dn":
        return math.sqrt(variance / count)
    if key == f"gradient_{line}_dn":
        return math.sqrt(variance / tilt_power(count))
    if key == f"fixed_{line}_variance_dn2":
        return variance * math.sqrt(2 / max(count - 3, 1))
    return 0.0
