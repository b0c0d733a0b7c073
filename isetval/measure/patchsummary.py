"""What people quote of the uniform patches of chart and scene shots: how many were fit, their levels, the published rule.

The patches hold the same pixels as the rows of their shot, so these rows are marked ``summary`` and left out of comparisons;
noise against level itself is an analysis (`analyses.noise_by_level`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.metric import Block, Metric
from isetval.measure.analyses.noise_by_level import BINS, ROLES, choose_levels, moments_by_channel, patches_by_channel
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.noise.patch_noise import Patch

LEAST_SIGMA_DN = 1e-6  # of noise-free simulations


def patch_summary(shot: Shot, captures: Sequence[Capture], options: Mapping[str, Any] | None = None) -> Block:
    """Levels of the uniform patches of one shot, by channel.

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
        For each channel ``uniform_patch_share`` (unclipped, or accepted by the published rule, over all; binomial sigma) and,
        in up to eight bins of equally many patches, ``uniform_patch_mean`` in DN; by the published rule also the spatial
        ``uniform_patch_noise`` that it accepts, root of the mean variance.

    Raises
    ------
    InputError
        For options that `uniform_patches` refuses, or frames smaller than a patch.
    """
    options = options or {}
    published = options.get("method") == "lyu2022"
    if shot.role not in ROLES or (len(captures) < 2 and not published):
        return Block(())
    patches = patches_by_channel(captures, options)
    levels = {} if published else choose_levels(captures[0], moments_by_channel(captures, options))
    conditions = shot_conditions(shot, captures[0].sensor) | {"summary": True}
    rows: list[Metric] = []
    for channel, every in patches.items():
        fit = sorted((p for p in every if not p.reason), key=lambda p: p.mean_dn)
        share = len(fit) / len(every)
        sigma = math.sqrt(max(share * (1 - share), 1 / len(every)) / len(every))
        rows.append(_row(conditions, "uniform_patch_share", share, sigma, "1", channel))
        bins = np.array_split(np.arange(len(fit)), min(BINS, len(fit))) if published and fit else []
        groups = [[fit[i] for i in part] for part in bins] or [[every[i] for i in part] for part in levels.get(channel, [])]
        for k, group in enumerate(groups):
            region = f"level {k + 1}"
            mean = float(np.mean([p.mean_dn for p in group]))
            mean_sigma = math.sqrt(sum(p.mean_sigma_dn**2 for p in group)) / len(group)
            rows.append(_row(conditions, "uniform_patch_mean", mean, mean_sigma, "DN", channel, region))
            if published:
                rows.append(_row(conditions, "uniform_patch_noise", *_spatial_noise(group), "DN", channel, region))
    return Block(tuple(rows))


def _spatial_noise(patches: Sequence[Patch]) -> tuple[float, float]:
    """Root of the mean spatial variance, and its sigma."""
    std = np.array([p.spatial_std_dn for p in patches])
    noise = math.sqrt(float(np.mean(std**2)))
    # sigma_dn of a patch is std / sqrt(2 dof): the variances add
    spread = math.sqrt(sum((2 * s * p.sigma_dn) ** 2 for s, p in zip(std, patches, strict=True))) / len(patches)
    return noise, spread / (2 * noise) if noise > 0 else 0.0


def _row(conditions: dict[str, Any], name: str, value: float, sigma: float, unit: str, channel: str, region: str = "") -> Metric:
    sigma = max(sigma, LEAST_SIGMA_DN)
    return metric(conditions, name, value, sigma, unit, channel=channel, region=region, family=f"summary_{name}")
