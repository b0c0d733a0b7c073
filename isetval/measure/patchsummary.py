"""Uniform patches of chart and scene shots as summaries: noise against level, and how many patches were fit for it.

The patches hold the same pixels as the rows of their shot, so they are marked ``summary`` and left out of comparisons.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.metric import Block, Metric
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.noise.patch_noise import Patch, uniform_patches

ROLES = ("chart", "scene")
SIZE = 10
MOST = 4000
BINS = 8


def patch_summary(shot: Shot, captures: Sequence[Capture], options: Mapping[str, Any] | None = None) -> Block:
    """Noise of the uniform patches of one shot, by channel and level.

    Parameters
    ----------
    shot : Shot
        Of any role; roles other than chart and scene give no rows.
    captures : sequence of Capture
        Its frames; one alone gives no rows with the two-frame method.
    options : mapping, optional
        Arguments of `uniform_patches`, for instance ``method="lyu2022"`` with ``gain_dn_per_e``.

    Returns
    -------
    Block
        For each channel ``uniform_patch_share`` (accepted over all, binomial sigma) and, in up to eight bins of equally many
        accepted patches, ``uniform_patch_mean`` and ``uniform_patch_noise`` in DN: root of the mean variance,
        temporal for the two-frame method, spatial for the published one.

    Raises
    ------
    InputError
        For options that `uniform_patches` refuses, or frames smaller than a patch.
    """
    settings = {"method": "two_frame", "size": SIZE, **(options or {})}
    if shot.role not in ROLES or (len(captures) < 2 and settings["method"] == "two_frame"):
        return Block(())
    if "count" not in settings and captures[0].mosaic.size > MOST * settings["size"] ** 2:
        settings["count"] = MOST
    table = uniform_patches(captures, **settings)
    rows: list[Metric] = []
    conditions = shot_conditions(shot, captures[0].sensor) | {"summary": True}
    for channel in [p for p in (*planes_of(captures[0]), "G") if any(patch.channel == p for patch in table.patches)]:
        every = [p for p in table.patches if p.channel == channel]
        fit = sorted((p for p in every if not p.reason), key=lambda p: p.mean_dn)
        share = len(fit) / len(every)
        sigma = math.sqrt(max(share * (1 - share), 1 / len(every)) / len(every))
        rows.append(
            metric(conditions, "uniform_patch_share", share, sigma, "1", channel=channel, family="summary_uniform_patch_share")
        )
        for k, index in enumerate(np.array_split(np.arange(len(fit)), min(BINS, len(fit)))):
            if len(index):
                rows += _bin(conditions, channel, f"level {k + 1}", [fit[i] for i in index])
    return Block(tuple(rows))


def _bin(conditions: dict[str, Any], channel: str, region: str, patches: Sequence[Patch]) -> list[Metric]:
    """Mean and noise of patches of about one level."""
    temporal = math.isfinite(patches[0].temporal_std_dn)
    std = np.array([p.temporal_std_dn if temporal else p.spatial_std_dn for p in patches])
    noise = math.sqrt(float(np.mean(std**2)))
    # sigma_dn of a patch is std / sqrt(2 dof): the variances add
    spread = math.sqrt(sum((2 * s * p.sigma_dn) ** 2 for s, p in zip(std, patches, strict=True))) / len(patches)
    mean = float(np.mean([p.mean_dn for p in patches]))
    mean_sigma = math.sqrt(sum(p.mean_sigma_dn**2 for p in patches)) / len(patches)
    values = (
        ("uniform_patch_mean", mean, mean_sigma),
        ("uniform_patch_noise", noise, spread / (2 * noise) if noise > 0 else 0.0),
    )
    return [
        metric(conditions, name, value, max(sigma, 1e-6), "DN", channel=channel, region=region, family=f"summary_{name}")
        for name, value, sigma in values
    ]
