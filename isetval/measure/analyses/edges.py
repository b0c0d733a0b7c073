"""Slanted edges: SFR at fixed frequencies, levels of both sides, lateral colour, per colour."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median_low
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.core.metric import Block, Differences, Metric
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.edge import SfrResult, sfr_batch

ROLES = ("edge",)
FREQUENCY_CY_PX = np.arange(0.05, 0.5001, 0.05)  # up to Nyquist, a tenth of it apart
ROUGHNESS = 0.1
"""Share of the variance that is taken as independent between frequencies.

The sampling covariance itself is right: over 300 captures of one edge (same choices) the scatter is .76 to 1.07 times the
stated one along every eigenvector, down to 1e-8 of the largest eigenvalue, for four edges (SNR 22 to 60, green, red,
monochrome), .33 to 1.04 for a fifth, very soft one.  But ten frequencies hold four to six numbers only: along the other
directions sigma is .0001 to .1 of a row's, and any error of a prediction, of no importance for a single row, would
decide.  A tenth keeps such directions from carrying weight and costs little power: the significance of blur, defocus,
aperture, crosstalk, cut-off and glare is at most 13 % higher (and up to 4 % lower) with .001.  Whitened residuals of a
true model have a mean square of .37 to .57 over the ten rows therefore (a tenth of the trace of stated^-1 sampling), not
1: their sigmas are not too wide, the rows hold fewer numbers than they are.
"""
WIDTH_STEPS = 15  # of 2 % each: splines a third too wide or narrow follow an ESF as well as those that fit it
SHADED = 10.0  # times the amplitude of shading: one step of the grid of amplitudes
# Frames without noise have a sigma of 0 or nearly: these keep weights finite and lie far below anything that is seen
LEAST_SIGMA_MTF, LEAST_SIGMA_DN, LEAST_SIGMA_PX = 1e-7, 1e-4, 1e-5
Float = NDArray[np.float64]


@dataclass(frozen=True)
class _Place:
    """A point of an edge in the middle of its region, the direction of its normal, and the sigma along that."""

    row_px: float
    col_px: float
    normal_deg: float
    sigma_px: float


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """SFR and levels of an edge, mean over the frames.

    Raises
    ------
    MeasurementError
        If the edge is refused in every colour, with the reasons.
    """
    (found,) = analyze_many(shot, [captures], choices)
    if isinstance(found, InputError):
        raise found
    return found


def analyze_many(shot: Shot, many: Sequence[Sequence[Capture]], choices: Mapping[str, Any]) -> list[Block | InputError]:
    """`analyze` of several sets of captures; with ``choices`` all regions of a colour are fitted in one stack."""
    channels = _channels(shot, many[0][0])
    results = {channel: _results(shot, many, channel, choices.get(channel)) for channel in channels}
    return [_block(shot, captures[0], {c: results[c][i] for c in channels}, choices) for i, captures in enumerate(many)]


def _channels(shot: Shot, capture: Capture) -> tuple[str, ...]:
    return ("MONO",) if capture.sensor.cfa == "MONO" else ((shot.channel,) if shot.channel else ("R", "G", "B"))


def holds(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> bool:
    """Whether choices made on another capture of the shot suit these.

    They do where the first frame's ESFs are of about the same width and most colours see an edge that is no more bent and
    no more shaded (noise alone adds an order to one of three now and then).
    """
    first = _first_choices(shot, captures[0])
    if set(first) != set(choices):
        return False
    pairs = [(own, choices[channel]) for channel, own in first.items()]
    like = [own["order"] <= other["order"] and own["light"] <= SHADED * other["light"] for own, other in pairs]
    return all(abs(own["width_index"] - other["width_index"]) <= WIDTH_STEPS for own, other in pairs) and 2 * sum(like) > len(
        like
    )


def agreed(shot: Shot, many: Sequence[Sequence[Capture]]) -> dict[str, Mapping[str, Any]]:
    """Choices that suit most captures of a shot, of those that several sets of them make, by colour.

    Medians, but of shading the most that any was found to need: by its noise one capture needs a hundred times less than the
    others, and what is chosen for it would not hold for them.
    """
    firsts = [_first_choices(shot, captures[0]) for captures in many]
    return {channel: _middle([made[channel] for made in firsts if channel in made]) for channel in firsts[0]}


def _middle(many: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {key: (max if key == "light" else median_low)([made[key] for made in many]) for key in many[0]}


def _first_choices(shot: Shot, capture: Capture) -> dict[str, Mapping[str, Any]]:
    results = {channel: _results(shot, [[capture]], channel, None)[0][0] for channel in _channels(shot, capture)}
    return {channel: result.choices for channel, result in results.items() if result.accepted}


def _results(
    shot: Shot, many: Sequence[Sequence[Capture]], channel: str, known: Mapping[str, Any] | None
) -> list[list[SfrResult]]:
    """Results of the frames of each set; of the first frame alone where it is refused and nothing is known."""
    roi, plane, method = getattr(shot.target, "roi", None), "G" if channel == "MONO" else channel, shot.method or "default"

    def measured(captures: Sequence[Capture], made: Mapping[str, Any] | None) -> list[SfrResult]:
        found: list[SfrResult] = sfr_batch(captures, [roi] * len(captures), plane, method=method, choices=made)
        return found

    if known:
        every = iter(measured([capture for captures in many for capture in captures], known))
        return [[next(every) for _ in captures] for captures in many]
    out = []
    for captures in many:  # the first frame makes the choices for the others
        first = measured(captures[:1], None)
        rest = captures[1:] if first[0].accepted else ()
        out.append([*first, *measured(rest, first[0].choices)] if rest else first)
    return out


def _block(
    shot: Shot, capture: Capture, results: Mapping[str, Sequence[SfrResult]], choices: Mapping[str, Any]
) -> Block | InputError:
    conditions = shot_conditions(shot, capture.sensor) | {"orientation": getattr(shot.target, "orientation", "")}
    made: dict[str, Any] = {}
    rows: list[Metric] = []
    blocks: list[Float] = []
    places: dict[str, _Place] = {}
    reasons: list[str] = []
    for channel, every in results.items():
        if not every[0].accepted:
            reasons.append(f"{channel}: {', '.join(every[0].messages.values()) or ', '.join(every[0].flags)}")
            continue
        made[channel] = choices.get(channel) or dict(every[0].choices)
        new, correlation, places[channel] = _channel(conditions, channel, [r for r in every if r.accepted])
        rows += new
        blocks.append(correlation)
    if not rows:
        return MeasurementError(f"no edge can be measured ({'; '.join(reasons)})")
    shifts, between = _lateral_color(conditions, places)
    correlation = block_diagonal([*blocks, between])
    return Block((*rows, *shifts), correlation, choices=made, differences=Differences(one_frame=True, noise_free=True))


def _channel(conditions: dict[str, Any], channel: str, results: Sequence[SfrResult]) -> tuple[list[Metric], Float, _Place]:
    n = len(results)
    mtf = np.mean([r.mtf_at(FREQUENCY_CY_PX) for r in results], axis=0)
    covariance = np.mean([_covariance(r) for r in results], axis=0) / n
    sigma = np.sqrt(np.maximum(np.diag(covariance), LEAST_SIGMA_MTF**2))
    rows = [
        metric(conditions, "mtf", value, s, "1", channel=channel, frequency_cy_px=round(float(f), 4))
        for f, value, s in zip(FREQUENCY_CY_PX, mtf, sigma, strict=True)
    ]
    k = len(rows)
    levels, between = _levels(conditions, channel, results)
    rows += levels
    if all(math.isfinite(r.mtf50_cy_px) for r in results):
        # derived from the same curve: for people, and its sigma holds what is common to all frames
        value, own = float(np.mean([r.mtf50_cy_px for r in results])), float(np.mean([r.mtf50_sigma for r in results]))
        rows.append(metric(conditions, "mtf50", value, own, "cy/px", channel=channel, family="summary_mtf50", summary=True))
    correlation = np.eye(len(rows))
    correlation[:k, :k] = (1 - ROUGHNESS) * covariance / np.outer(sigma, sigma)
    correlation[k : k + len(levels), k : k + len(levels)] = between
    np.fill_diagonal(correlation, 1.0)
    row, col = np.mean([(r.edge_row_px, r.edge_col_px) for r in results], axis=0).tolist()
    place = _Place(row, col, results[0].normal_deg, math.sqrt(np.mean([r.edge_sigma_px**2 for r in results]) / n))
    return rows, correlation, place


def _levels(conditions: dict[str, Any], channel: str, results: Sequence[SfrResult]) -> tuple[list[Metric], Float]:
    """Dark and bright level with their correlation; none of the published procedures, which state no sigma of theirs."""
    if results[0].method != "default":
        return [], np.zeros((0, 0))
    covariance = np.mean([r.level_covariance_dn(kind="sampling") for r in results], axis=0) / len(results)
    sigma = np.maximum(np.sqrt(np.diag(covariance)), LEAST_SIGMA_DN)
    values = np.mean([(r.dark_dn, r.bright_dn) for r in results], axis=0)
    rows = [
        metric(conditions, f"edge_{name}_level", value, s, "DN", channel=channel)
        for name, value, s in zip(("dark", "bright"), values.tolist(), sigma.tolist(), strict=True)
    ]
    return rows, np.asarray(covariance / np.outer(sigma, sigma))


def _covariance(result: SfrResult) -> Float:
    """Sampling covariance of the SFR; of the published procedures, which give sigmas alone, a diagonal one."""
    if result.method == "default":
        return np.asarray(result.mtf_covariance(FREQUENCY_CY_PX, kind="sampling"))
    return np.asarray(np.diag(np.interp(FREQUENCY_CY_PX, result.frequency_cy_px, result.mtf_sigma) ** 2))


def _lateral_color(conditions: dict[str, Any], places: Mapping[str, _Place]) -> tuple[list[Metric], Float]:
    """Shift of the red and blue edge against the green one, in px, with their correlation; the pose of the chart cancels.

    Both are projected on the green edge's normal: projected on its own each, their error would turn with the distance from
    the region's corner (40 px times .001).
    """
    if "G" not in places or not math.isfinite(places["G"].sigma_px):
        return [], np.zeros((0, 0))
    green = places["G"]
    normal = math.radians(green.normal_deg)
    rows = []
    for channel in ("R", "B"):
        other = places.get(channel)
        if other is not None and math.isfinite(other.sigma_px):
            shift = (other.col_px - green.col_px) * math.cos(normal) + (other.row_px - green.row_px) * math.sin(normal)
            sigma = max(math.hypot(other.sigma_px, green.sigma_px), LEAST_SIGMA_PX)
            rows.append(metric(conditions, "lateral_color", shift, sigma, "px", channel=channel))
    # the green edge is common to both
    sigmas = np.array([row.sigma for row in rows])
    between = green.sigma_px**2 / np.outer(sigmas, sigmas)
    np.fill_diagonal(between, 1.0)
    return rows, between


def block_diagonal(blocks: Sequence[Float]) -> Float:
    """One matrix (n, n) with the given ones along its diagonal."""
    n = sum(len(b) for b in blocks)
    out = np.zeros((n, n))
    row = 0
    for block in blocks:
        out[row : row + len(block), row : row + len(block)] = block
        row += len(block)
    return out
