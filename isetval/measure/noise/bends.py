"""What bends a photon-transfer curve: response of the mean, charge repulsion between neighbours."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from isetval.core.capture import Capture, Roi, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.quantity import Quantity
from isetval.measure.noise.curve import Response
from isetval.measure.noise.levels import Level, LevelSeries
from isetval.measure.noise.moments import frame_moments
from isetval.measure.noise.statistics import PlaneStatistics, neighbour_covariance

LARGEST = 512


def nonlinearity_at(response: Response | None, used: Sequence[Level]) -> Quantity:
    """M / L - 1 at the highest level used; 0 where the means are straight, nan where times are unknown."""
    if response is None:
        times = {level.time_s for level in used}
        if None in times or len(times) < 5:
            return Quantity(math.nan, math.nan)
        rate = np.array([level.mean_dn / level.time_s for level in used if level.time_s])
        return Quantity(0.0, float(np.std(rate, ddof=1) / np.mean(rate)))
    top = float(response.linear(np.array([used[-1].mean_dn]))[0]) / response.scale_dn
    powers = np.array([top, top**2])
    value = float(powers @ np.array([response.a, response.b]))
    return Quantity(value, float(math.sqrt(max(powers @ response.covariance @ powers, 0.0))))


Found = dict[int, PlaneStatistics]


def covariance_per_e(series: LevelSeries, plane: str, roi: Roi | None, known: Found) -> Quantity:
    """Sum of the covariances with the four nearest neighbours over the squared mean, 1/e-.

    Charge repulsion takes A mu^2 from the variance of a pixel and gives it to the covariances with its neighbours; the
    four nearest hold part of it, so this is a lower bound of A, measured apart from the variance.  ``known`` keeps the
    mosaic's covariances by level from one plane to the next.
    """
    used = [level for level in series.levels if level.used]
    top = used[-1].mean_dn
    bright = [level for level in used if level.mean_dn > 0.4 * top]
    bright = bright[-4:] if bright[0].pixels < LARGEST**2 // 4 else bright[-2:]
    value = weight_sum = 0.0
    for level in bright:
        if not level.mean_dn > 0:
            continue
        found = _four_neighbours(level.captures, plane, roi, known)
        weight = (level.mean_dn**2 / found.sigma) ** 2 if found.sigma > 0 else 0.0
        value += weight * found.value / level.mean_dn**2
        weight_sum += weight
    if not weight_sum > 0:
        return Quantity(math.nan, math.nan, "1/e-")
    return Quantity(value / weight_sum, 1 / math.sqrt(weight_sum), "1/e-")


def _four_neighbours(captures: Sequence[Capture], plane: str, roi: Roi | None, known: Found) -> Quantity:
    if id(captures[0]) not in known:
        known[id(captures[0])] = _mosaic_covariance(captures, roi)
    found = known[id(captures[0])].quantities
    mine = [q for n, q in found.items() if plane == "MONO" or plane.lower() in n.split("_")[2:]]
    return Quantity(2 * sum(q.value for q in mine), 2 * math.sqrt(sum(q.sigma**2 for q in mine)), "DN^2")


def _mosaic_covariance(captures: Sequence[Capture], roi: Roi | None) -> PlaneStatistics:
    row0, row1, col0, col1 = check_roi(captures[0], roi)
    region = (row0, min(row1, row0 + LARGEST), col0, min(col1, col0 + LARGEST))
    planes = {}
    for name in planes_of(captures[0]):
        views = [plane_view(c, name, region)[0] for c in captures]
        _, first, _ = plane_view(captures[0], name, region)
        planes[name] = (frame_moments(views, plane_black_dn(captures[0], name), keep=True, dtype=np.float32), first)
    return neighbour_covariance(planes, region)
