"""Sharpness over the field, through focus and over distance; lateral colour from edge positions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, field_mm
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.measure.edge.edge_finding import find_edges
from isetval.measure.edge.measure_regions import sfr, sfr_batch
from isetval.measure.edge.sfr_result import SfrResult

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.floating[Any]]

PARALLEL_DEG = 30.0  # a third of the right angle each: meridional, oblique, sagittal; cos^2 30 = 3/4 of the wanted direction
CENTER_SHARE = 0.05  # of the half diagonal: astigmatism grows as the square of the field, .0025 of the corner's


@dataclass(frozen=True)
class FieldPoint:
    """One edge in the field.

    ``direction``: ``meridional`` when the edge's normal (the direction of the frequencies) points within
    30 degrees of the radius, ``sagittal`` within 30 degrees of the tangent, ``center`` near the axis,
    ``oblique`` otherwise.  ``x_mm``, ``y_mm`` from the sensor's middle; MTF50 in cycles/pixel.
    """

    x_mm: float
    y_mm: float
    radius_mm: float
    direction: str
    mtf50_cy_px: float
    mtf50_sigma: float
    result: SfrResult = field(repr=False)


@dataclass(frozen=True, repr=False)
class LensProfile(Drawn):
    """MTF50 over the field: the points, and what was refused."""

    points: tuple[FieldPoint, ...]
    refused: tuple[SfrResult, ...]
    half_diagonal_mm: float
    channel: str

    def headline(self) -> str:
        """How many edges, and the range of their MTF50."""
        found = [p.mtf50_cy_px for p in self.points]
        span = f", MTF50 {min(found):.3f} to {max(found):.3f} cy/px" if found else ""
        return f"channel {self.channel}: {len(self.points)} edges, {len(self.refused)} refused{span}"

    def to_frame(self) -> pd.DataFrame:
        """One row an edge: name, channel, x_mm, y_mm, radius_mm, direction, value, sigma, unit."""
        import pandas as pd

        rows = [
            ("mtf50", self.channel, p.x_mm, p.y_mm, p.radius_mm, p.direction, p.mtf50_cy_px, p.mtf50_sigma, "cy/px")
            for p in self.points
        ]
        names = ["name", "channel", "x_mm", "y_mm", "radius_mm", "direction", "value", "sigma", "unit"]
        return pd.DataFrame(rows, columns=names)

    def curve(self, direction: str, radius_mm: ArrayLike, *, order: int = 2) -> tuple[Float, Float]:
        """Even polynomial 1, r^2, r^4 ... in the field radius through the points of one direction.

        Parameters
        ----------
        direction : str
            ``meridional`` or ``sagittal``; points at the centre count for both.
        radius_mm : array (n,)
        order : int
            Number of powers of r^2 beside the constant; lowered to what the points allow.

        Returns
        -------
        mtf50_cy_px, sigma : arrays (n,)
            Sigma is scaled by the scatter of the points where it exceeds their own.

        Raises
        ------
        MeasurementError
            Without a point of that direction.
        """
        chosen = [p for p in self.points if p.direction in (direction, "center")]
        if not any(p.direction == direction for p in chosen):
            raise MeasurementError(f"no {direction} edge was accepted; add slanted edges whose normal is {direction}")
        radius = np.array([p.radius_mm for p in chosen])
        value = np.array([p.mtf50_cy_px for p in chosen])
        sigma = np.array([p.mtf50_sigma for p in chosen])
        terms = max(1, min(order + 1, len(np.unique(np.round(radius / self.half_diagonal_mm, 2))) - 1))
        design = (radius[:, None] / self.half_diagonal_mm) ** (2 * np.arange(terms))
        weighted = design / sigma[:, None]
        covariance = np.linalg.inv(weighted.T @ weighted)
        c = covariance @ (weighted.T @ (value / sigma))
        chi2 = float(np.sum(((value - design @ c) / sigma) ** 2)) / max(len(value) - terms, 1)
        at = (np.atleast_1d(np.asarray(radius_mm, dtype=float))[:, None] / self.half_diagonal_mm) ** (2 * np.arange(terms))
        spread = np.sqrt(np.einsum("ij,jk,ik->i", at, covariance, at) * max(1.0, chi2))
        return np.asarray(at @ c), np.asarray(spread)


def lens_profile(
    captures: Capture | Sequence[Capture], rois: Sequence[Sequence[RoiLike]] | Sequence[RoiLike] | None = None, channel: str = "G"
) -> LensProfile:
    """MTF50 against field height, meridional and sagittal.

    Parameters
    ----------
    captures : Capture or sequence
        Full frames, or crops that know their place on the sensor.
    rois : None, regions of the one capture, or one list of regions per capture
        None: ``find_edges`` looks for them.
    channel : str

    Raises
    ------
    InputError
        When the numbers of captures and region lists differ, or no capture is given.
    """
    many = [captures] if isinstance(captures, Capture) else list(captures)
    if not many:
        raise InputError("lens_profile got no capture; give at least one")
    lists = _region_lists(many, rois, channel, single=isinstance(captures, Capture))
    points: list[FieldPoint] = []
    refused: list[SfrResult] = []
    for capture, regions in zip(many, lists, strict=True):
        for result in sfr_batch(capture, regions, channel):
            if result.flags or not np.isfinite(result.mtf50_cy_px):
                refused.append(result)
            else:
                points.append(_field_point(capture, result))
    points.sort(key=lambda p: p.radius_mm)
    return LensProfile(tuple(points), tuple(refused), many[0].sensor.half_diagonal_mm, channel)


def _region_lists(many: list[Capture], rois: Any, channel: str, *, single: bool) -> list[list[RoiLike]]:
    if rois is None:
        return [list(find_edges(capture, channel)) for capture in many]
    given = [rois] if single else list(rois)
    if len(given) != len(many):
        raise InputError(f"{len(many)} captures and {len(given)} lists of regions; give one list of regions per capture")
    return [list(part) for part in given]


def _field_point(capture: Capture, result: SfrResult) -> FieldPoint:
    row = result.edge_row_px + capture.window[0]
    col = result.edge_col_px + capture.window[1]
    x, y = (float(v) for v in field_mm(capture.sensor, row, col))
    radius = float(np.hypot(x, y))
    direction = "center"
    if radius > CENTER_SHARE * capture.sensor.half_diagonal_mm:
        normal = np.radians(result.normal_deg)
        cosine = abs(x * np.cos(normal) + y * np.sin(normal)) / radius
        turn = float(np.degrees(np.arccos(min(cosine, 1.0))))
        direction = "meridional" if turn <= PARALLEL_DEG else "sagittal" if turn >= 90 - PARALLEL_DEG else "oblique"
    return FieldPoint(x, y, radius, direction, result.mtf50_cy_px, result.mtf50_sigma, result)


@dataclass(frozen=True, repr=False)
class FocusCurve(Drawn):
    """SFR at one frequency against focus for one channel, with the best focus (NaN when not enclosed)."""

    channel: str
    focus: Float
    mtf: Float
    sigma: Float
    best_focus: float
    best_focus_sigma: float
    best_mtf: float

    def headline(self) -> str:
        """The best focus."""
        return f"channel {self.channel}: best focus {self.best_focus:.5g} +- {self.best_focus_sigma:.2g}, SFR {self.best_mtf:.3f}"

    def to_frame(self) -> pd.DataFrame:
        """One row a focus setting: name, channel, focus (unit as given), value, sigma, unit."""
        import pandas as pd

        rows = [
            ("mtf", self.channel, float(f), float(v), float(s), "1")
            for f, v, s in zip(self.focus, self.mtf, self.sigma, strict=True)
        ]
        return pd.DataFrame(rows, columns=["name", "channel", "focus", "value", "sigma", "unit"])


def through_focus(
    captures: Sequence[Capture],
    focus: ArrayLike,
    roi: RoiLike | None = None,
    *,
    channels: Iterable[str] = ("R", "G", "B"),
    frequency_cy_px: float = 0.2,
) -> dict[str, FocusCurve]:
    """Through-focus curves and the best focus of every channel.

    The best focus is the top of a parabola through log SFR at the five points about the maximum,
    weighted by their sigma.

    Parameters
    ----------
    captures, focus : n captures and the n focus settings, any unit
    roi : RoiLike or None
    channels : names of channels; one entry ``MONO`` for one-channel captures
    frequency_cy_px : float

    Raises
    ------
    InputError
        When the numbers differ or are below 3.
    """
    place = np.asarray(focus, dtype=float)
    if len(captures) != len(place) or len(place) < 3:
        raise InputError(f"{len(captures)} captures and {len(place)} focus settings; give one for each, at least 3")
    names = ("MONO",) if captures[0].sensor.cfa == "MONO" else tuple(channels)
    out = {}
    for channel in names:
        results = sfr_batch(captures, [roi] * len(captures), channel)
        value = np.array([r.mtf_at([frequency_cy_px])[0] if not r.flags else np.nan for r in results])
        sigma = np.array([r.mtf_covariance([frequency_cy_px])[0, 0] ** 0.5 if not r.flags else np.nan for r in results])
        out[channel] = FocusCurve(channel, place, value, sigma, *_parabola_top(place, value, sigma))
    return out


def _parabola_top(place: Float, value: Float, sigma: Float) -> tuple[float, float, float]:
    """Place, sigma and height of the maximum."""
    nothing = (float("nan"),) * 3
    good = np.flatnonzero(np.isfinite(value) & (value > 0))
    if len(good) < 3:
        return nothing
    order = good[np.argsort(place[good])]
    top = int(np.argmax(value[order]))
    near = order[max(0, top - 2) : top + 3]
    if top == 0 or top == len(order) - 1 or len(near) < 3:
        return nothing
    middle, half = place[order[top]], float(np.ptp(place[near])) / 2
    t = (place[near] - middle) / half
    weight = value[near] / np.maximum(sigma[near], 1e-9)
    design = np.stack([np.ones_like(t), t, t**2], axis=1) * weight[:, None]
    covariance = np.linalg.inv(design.T @ design)
    a, b, c = covariance @ (design.T @ (np.log(value[near]) * weight))
    if c >= 0:
        return nothing
    gradient = np.array([0.0, -1 / (2 * c), b / (2 * c * c)])
    spread = float(np.sqrt(gradient @ covariance @ gradient)) * half
    return float(middle - b / (2 * c) * half), spread, float(np.exp(a - b * b / (4 * c)))


@dataclass(frozen=True)
class EdgeShift:
    """Shift of a channel's edge against the reference along the normal, from dark to bright, px of the sensor grid."""

    channel: str
    shift_px: float
    sigma_px: float
    row_px: float
    col_px: float


def color_shift(
    capture: Capture, roi: RoiLike | None = None, *, reference: str = "G", channels: Iterable[str] = ("R", "B")
) -> dict[str, EdgeShift]:
    """Lateral colour: where the edge lies in each channel against the reference.

    Raises
    ------
    MeasurementError
        When the edge is refused in a channel.
    """
    base = _accepted(capture, roi, reference)
    normal = np.radians(base.normal_deg)
    out = {}
    for channel in channels:
        other = _accepted(capture, roi, channel)
        # both lines are compared at the same place along the edge
        row, col = other.edge_row_px - base.edge_row_px, other.edge_col_px - base.edge_col_px
        shift = row * np.sin(normal) + col * np.cos(normal)
        sigma = float(np.hypot(base.edge_sigma_px, other.edge_sigma_px))
        out[channel] = EdgeShift(channel, float(shift), sigma, base.edge_row_px, base.edge_col_px)
    return out


def _accepted(capture: Capture, roi: RoiLike | None, channel: str) -> SfrResult:
    result = sfr(capture, roi, channel)
    if result.flags:
        raise MeasurementError(f"roi {result.roi}, channel {channel}: {result.messages[result.flags[0]]}")
    return result


@dataclass(frozen=True)
class DepthOfField:
    """Distances between which the SFR stays above ``level`` times its best; NaN where the data do not reach."""

    near: float
    near_sigma: float
    far: float
    far_sigma: float
    best: float
    level: float


def depth_of_field(
    results: Sequence[SfrResult] | Mapping[float, SfrResult],
    distance: ArrayLike | None = None,
    *,
    frequency_cy_px: float = 0.2,
    level: float = 0.5,
) -> DepthOfField:
    """Depth of field from edges at several distances.

    Between the edges the SFR is interpolated linearly in 1/distance; the best value is the largest measured.

    Parameters
    ----------
    results : results with ``distance``, or a mapping distance -> result
    distance : (n,), any unit
    frequency_cy_px : float
        Frequency at which sharpness is judged.
    level : float
        Share of the best SFR that still counts as sharp.

    Raises
    ------
    InputError
        When the numbers differ or fewer than 3 edges were accepted.
    """
    pairs = (
        list(results.items())
        if isinstance(results, Mapping)
        else list(zip(np.asarray(distance, dtype=float).tolist(), results, strict=True))
    )
    good = sorted(((float(d), r) for d, r in pairs if not r.flags), key=lambda pair: pair[0])
    if len(good) < 3:
        raise InputError(f"{len(good)} accepted edges; depth of field needs at least 3 distances")
    place = np.array([1 / d for d, _ in good])
    value = np.array([r.mtf_at([frequency_cy_px])[0] for _, r in good])
    sigma = np.array([r.mtf_covariance([frequency_cy_px])[0, 0] ** 0.5 for _, r in good])
    top = int(np.argmax(value))
    near, near_sigma = _fall(place[: top + 1][::-1], value[: top + 1][::-1], sigma[: top + 1][::-1], level * value[top])
    far, far_sigma = _fall(place[top:], value[top:], sigma[top:], level * value[top])
    return DepthOfField(near, near_sigma, far, far_sigma, good[top][0], level)


def _fall(place: Float, value: Float, sigma: Float, level: float) -> tuple[float, float]:
    """Distance at which ``value`` first falls to ``level``, starting from the best point."""
    below = np.flatnonzero(value < level)
    if not len(below):
        return float("nan"), float("nan")
    i = int(below[0])
    rise = value[i - 1] - value[i]
    part = (value[i - 1] - level) / rise
    x = place[i - 1] + part * (place[i] - place[i - 1])
    spread = abs(place[i] - place[i - 1]) * np.hypot((1 - part) * sigma[i - 1], part * sigma[i]) / rise
    return float(1 / x), float(spread / x**2)
