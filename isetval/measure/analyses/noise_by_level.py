"""Noise against level: temporal noise of the uniform patches of charts and scenes, in bins of about one level."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_black_dn, planes_of
from isetval.core.metric import Block, Metric
from isetval.core.sensor import Roi
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.noise.patch_noise import Patch, PatchMoments, patch_moments, uniform_patches
from isetval.measure.noise.unsteady_pixels import highest_normal_variance

Float = NDArray[np.float64]
ROLES = ("chart", "scene")
OF_MOMENTS = ("roi", "size", "count", "seed", "channel")  # options of `uniform_patches` that say which patches
SIZE = 10  # mosaic pixels, as in the paper
MOST = 4000  # patches: a noise in eight bins to 1 %; more cost time and tell nothing else
BINS = 8  # levels of the paper's figure; a hundred patches each on a small chart
CLIPPED_SD = 6.0  # what is this far below white does not clip by chance in a simulation either
EVEN = 3.0  # spatial over temporal noise: shading and fixed pattern pass, edges that a shaking camera turns into noise do not
AGREE = 0.95  # of the patches: what noise lifts over the limit of evenness is a few percent
MOST_STRUCK = 0.25  # of a bin's patches, well below the half that their median bears: one of ten is more than a twentieth
LEAST_SIGMA_DN = 1e-6  # of noise-free simulations
Levels = dict[str, list[list[int]]]


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Temporal noise by channel and level, from the differences of two or more frames.

    One frame gives no rows: no rule tells its noise from texture and fixed pattern (guide on sensors, section 6: a gain 34 %
    off on a scene that is one third uneven).

    Raises
    ------
    InputError
        For frames smaller than a patch.

    Notes
    -----
    ``uniform_patch_noise`` is the root of the mean temporal variance of a bin's patches, in DN; patches beyond what normal noise
    gives once in 1e8 are left out where they are a quarter at most.  Which patches make a bin is
    a choice: those that are unclipped and even, in up to eight bins of equally many by rising mean, so that simulations use
    the very same places.

    Temporal variances are told from differences between frames and means from their sum: for normal noise the two are
    independent, and of the patch means of the same shot.  What is left is the skewness of few electrons, a correlation
    of at most sqrt(share / (2 mu)) for mu electrons when ``share`` of the pixels is common: below .1 from 50 electrons on.
    Channels and bins share no pixels.
    """
    if len(captures) < 2:
        return Block(())
    options = ({"channel": shot.channel} if shot.channel else {}) | choices.get("options", {})
    found = moments_by_channel(captures, options)
    levels: Levels = choices.get("levels") or choose_levels(captures[0], found)
    conditions = shot_conditions(shot, captures[0].sensor)
    rows = [
        _noise_row(conditions, shot, channel, f"level {k + 1}", found[channel], numbers)
        for channel in found  # in the order of the planes, however the choices were kept
        for k, numbers in enumerate(levels.get(channel, ()))
    ]
    return Block(tuple(rows), choices={**choices, "levels": levels})


def reads(shot: Shot) -> tuple[Roi, ...] | None:
    """Nothing of a single frame, all of several."""
    return () if shot.frames < 2 else None


def holds(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> bool:
    """Whether patches chosen on another capture of the shot are unclipped and even in these, but for a few at the limit."""
    if len(captures) < 2:
        return True
    own = {"channel": shot.channel} if shot.channel else {}
    levels = choose_levels(captures[0], moments_by_channel(captures, own | choices.get("options", {})))
    here, there = ({c: {i for part in bins for i in part} for c, bins in found.items()} for found in (levels, choices["levels"]))
    return set(here) == set(there) and all(len(there[c] & here[c]) >= AGREE * len(there[c]) for c in there)


def patches_by_channel(captures: Sequence[Capture], options: Mapping[str, Any]) -> dict[str, list[Patch]]:
    """All patches of each channel, in an order that depends on frame size and options only."""
    table = uniform_patches(captures, **_settings(captures, options))
    found: dict[str, list[Patch]] = {}
    for patch in table.patches:
        found.setdefault(patch.channel, []).append(patch)
    return {name: found[name] for name in _in_order(captures[0], found)}


def moments_by_channel(captures: Sequence[Capture], options: Mapping[str, Any]) -> dict[str, PatchMoments]:
    """The numbers of the same patches of two or more frames, by channel, without a `Patch` for each."""
    settings = _settings(captures, options)
    found = patch_moments(captures, **{key: settings[key] for key in OF_MOMENTS if key in settings})
    return {name: found[name] for name in _in_order(captures[0], found)}


def _settings(captures: Sequence[Capture], options: Mapping[str, Any]) -> dict[str, Any]:
    settings = {"method": "two_frame", "size": SIZE, **options}
    if "count" not in settings and captures[0].mosaic.size > MOST * settings["size"] ** 2:
        settings["count"] = MOST
    return settings


def _in_order(capture: Capture, channels: Collection[str]) -> list[str]:
    return [name for name in (*planes_of(capture), "G") if name in channels]


def choose_levels(capture: Capture, patches: Mapping[str, PatchMoments]) -> Levels:
    """Numbers of the patches of each bin, by channel; a channel without an even patch has none."""
    out: Levels = {}
    for channel, every in patches.items():
        range_dn = capture.sensor.white_dn - plane_black_dn(capture, "Gr" if channel == "G" else channel)
        open_ = (every.clip == 0) & (every.mean_dn + CLIPPED_SD * every.temporal_std_dn < range_dn)
        # evenness is judged against the noise of the whole bin: a patch's own would be selected with it
        even: list[int] = []
        for numbers in _bins(np.flatnonzero(open_), every):
            noise = math.sqrt(float(np.mean(every.temporal_std_dn[numbers] ** 2)))
            even += [i for i in numbers if every.spatial_std_dn[i] <= EVEN * noise]
        if even:
            out[channel] = _bins(np.array(even), every)
    return out


def _bins(numbers: NDArray[np.intp], patches: PatchMoments) -> list[list[int]]:
    """Up to eight bins of equally many patches, by rising mean."""
    ordered = numbers[np.argsort(patches.mean_dn[numbers], kind="stable")]
    return [[int(i) for i in part] for part in np.array_split(ordered, min(BINS, len(ordered)))] if len(ordered) else []


def _noise_row(
    conditions: dict[str, Any], shot: Shot, channel: str, region: str, found: PatchMoments, numbers: Sequence[int]
) -> Metric:
    """Root of the mean temporal variance of some patches, and its sigma."""
    variance = _without_strikes(found.temporal_std_dn[list(numbers)] ** 2, found.dof)
    # the mean square of a variance with dof degrees of freedom is (1 + 2 / dof) of its square
    noise = math.sqrt(float(variance.mean()))
    sigma = math.sqrt(float(np.sum(2 * variance**2 / (found.dof + 2)))) / len(variance) / (2 * noise) if noise > 0 else 0.0
    family = f"{shot.role}_noise_by_level"
    sigma = max(sigma, LEAST_SIGMA_DN)
    return metric(conditions, "uniform_patch_noise", noise, sigma, "DN", channel=channel, region=region, family=family)


def _without_strikes(variance: Float, dof: int) -> Float:
    """Variances of a bin's patches, by rising mean, without the few that one struck or blinking pixel makes.

    A particle of a few hundred e- adds as much as all noise of a bin's patches, whichever it fell in: flats count such pixels and
    leave them out of their noise.  The bulk is that of the brightest quarter, since variance grows with the level.
    """
    bulk = float(np.median(variance[-max(1, len(variance) // 4) :]))
    normal = variance <= highest_normal_variance(bulk, dof)
    return variance[normal] if np.mean(normal) >= 1 - MOST_STRUCK else variance
