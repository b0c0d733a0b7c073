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
from isetval.measure.conditions import VALUES_ALONE, metric, shot_conditions
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
Asked = tuple[Shot, Sequence[Capture], Mapping[str, Any]]
"""A shot, its captures, and the choices for it."""


@dataclass(frozen=True)
class _Place:
    """A point of an edge in the middle of its region, the direction of its normal, and the sigma along that."""

    row_px: float
    col_px: float
    normal_deg: float
    sigma_px: float


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """SFR and levels of an edge, mean over the frames.

    Values alone, without error bars, where ``choices`` ask ``for_differences``.

    Raises
    ------
    MeasurementError
        If the edge is refused in every colour, with the reasons.
    """
    (found,) = analyze_across([(shot, captures, choices)])
    if isinstance(found, InputError):
        raise found
    return found


def analyze_across(asked: Sequence[Asked]) -> list[Block | InputError]:
    """`analyze` of several shots; regions of all shots and colours whose grids are alike are fitted in one stack."""
    results = _results(asked)
    return [_block(*own, found) for own, found in zip(asked, results, strict=True)]


def _channels(shot: Shot, capture: Capture) -> tuple[str, ...]:
    return ("MONO",) if capture.sensor.cfa == "MONO" else ((shot.channel,) if shot.channel else ("R", "G", "B"))


def holds(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> bool:
    """Whether choices made on another capture of the shot suit these.

    They do where the first frame's ESFs are of about the same width and most colours see an edge that is no more bent and
    no more shaded (noise alone adds an order to one of three now and then).
    """
    (first,) = _first_choices(shot, captures[:1])
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
    firsts = _first_choices(shot, [captures[0] for captures in many])
    return {channel: _middle([made[channel] for made in firsts if channel in made]) for channel in firsts[0]}


def _middle(many: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {key: (max if key == "light" else median_low)([made[key] for made in many]) for key in many[0]}


def _first_choices(shot: Shot, captures: Sequence[Capture]) -> list[dict[str, Mapping[str, Any]]]:
    """What each capture chooses, by colour."""
    every = _results([(shot, [capture], {}) for capture in captures])
    return [{channel: own.choices for channel, (own,) in results.items() if own.accepted} for results in every]


@dataclass(frozen=True, eq=False)
class _Region:
    """A frame of an edge in one colour, and what is chosen for it."""

    shot: Shot
    channel: str
    capture: Capture
    choices: Mapping[str, Any] | None


def _results(asked: Sequence[Asked]) -> list[dict[str, list[SfrResult]]]:
    """Results of the frames of each shot by colour; of the first frame alone where it is refused and nothing is known."""
    each = [(i, channel) for i, (shot, captures, _) in enumerate(asked) for channel in _channels(shot, captures[0])]
    open_ = [(i, channel) for i, channel in each if not asked[i][2].get(channel)]
    # the first frame makes the choices for the others
    firsts = dict(zip(open_, _measured([_Region(asked[i][0], c, asked[i][1][0], None) for i, c in open_]), strict=True))
    more: list[tuple[int, str, _Region]] = []
    for i, channel in each:
        shot, captures, choices = asked[i]
        first = firsts.get((i, channel))
        known = choices.get(channel) if first is None else first.choices
        left = captures if first is None else captures[1:] if first.accepted else ()
        more += [(i, channel, _Region(shot, channel, capture, known)) for capture in left]
    out: list[dict[str, list[SfrResult]]] = [{} for _ in asked]
    for i, channel in each:
        out[i][channel] = [firsts[i, channel]] if (i, channel) in firsts else []
    for (i, channel, _), result in zip(more, _measured([region for *_, region in more]), strict=True):
        out[i][channel].append(result)
    return out


def _measured(regions: Sequence[_Region]) -> list[SfrResult]:
    """The edge in each region, by the method of its shot."""
    out: dict[int, SfrResult] = {}
    for method in dict.fromkeys(region.shot.method for region in regions):
        own = [i for i, region in enumerate(regions) if region.shot.method == method]
        found = sfr_batch(
            [regions[i].capture for i in own],
            [getattr(regions[i].shot.target, "roi", None) for i in own],
            ["G" if regions[i].channel == "MONO" else regions[i].channel for i in own],
            method=method or "default",
            choices=[regions[i].choices for i in own],
        )
        out |= dict(zip(own, found, strict=True))
    return [out[i] for i in range(len(regions))]


def _block(
    shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any], results: Mapping[str, Sequence[SfrResult]]
) -> Block | InputError:
    values_alone = bool(choices.get(VALUES_ALONE))
    conditions = shot_conditions(shot, captures[0].sensor) | {"orientation": getattr(shot.target, "orientation", "")}
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
        accepted = [r for r in every if r.accepted]
        new, correlation, places[channel] = (_values if values_alone else _channel)(conditions, channel, accepted)
        rows += new
        blocks.append(correlation)
    if not rows:
        return MeasurementError(f"no edge can be measured ({'; '.join(reasons)})")
    shifts, between = _lateral_color(conditions, places)
    joint = None if values_alone else block_diagonal([*blocks, between])
    return Block((*rows, *shifts), joint, choices=made, differences=Differences(one_frame=True, noise_free=True))


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
    return rows, correlation, _place(results)


def _values(conditions: dict[str, Any], channel: str, results: Sequence[SfrResult]) -> tuple[list[Metric], Float, _Place]:
    """The rows of `_channel` that simulations are compared in, without error bars."""
    mtf = np.mean([r.mtf_at(FREQUENCY_CY_PX) for r in results], axis=0)
    rows = [
        metric(conditions, "mtf", value, 0.0, "1", channel=channel, frequency_cy_px=round(float(f), 4))
        for f, value in zip(FREQUENCY_CY_PX, mtf, strict=True)
    ]
    if results[0].method == "default":
        levels = np.mean([(r.dark_dn, r.bright_dn) for r in results], axis=0).tolist()
        rows += [
            metric(conditions, f"edge_{name}_level", value, 0.0, "DN", channel=channel)
            for name, value in zip(("dark", "bright"), levels, strict=True)
        ]
    return rows, np.zeros((0, 0)), _place(results)


def _place(results: Sequence[SfrResult]) -> _Place:
    row, col = np.mean([(r.edge_row_px, r.edge_col_px) for r in results], axis=0).tolist()
    return _Place(row, col, results[0].normal_deg, math.sqrt(np.mean([r.edge_sigma_px**2 for r in results]) / len(results)))


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
