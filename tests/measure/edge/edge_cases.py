"""Helpers of the slanted-edge tests: truth for one region, errors against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.core.capture import Capture
from isetval.measure.edge import sfr
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

AIRY = EdgeBlur(cutoff_cy_px=0.9)  # with the pixel: MTF50 near 0.3 cy/px


@dataclass(frozen=True)
class Errors:
    """Relative MTF50 error, the same in sigmas, and the largest |dMTF| over (0, 0.5] cy/px."""

    mtf50: float
    pull: float
    curve: float
    flags: tuple[str, ...]


def errors(truth: EdgeTruth, capture: Capture, channel: str = "G", **options) -> Errors:
    result = sfr(capture, None, channel, **options)
    true = truth.mtf50_cy_px()
    seen = (result.frequency_cy_px > 0) & (result.frequency_cy_px <= 0.5)
    curve = np.abs(result.mtf[seen] - truth.mtf(result.frequency_cy_px[seen])).max()
    pull = (result.mtf50_cy_px - true) / result.mtf50_sigma
    return Errors(result.mtf50_cy_px / true - 1, pull, float(curve), result.flags)


def clean(truth: EdgeTruth, shape=(100, 100), **options) -> Capture:
    """Noise-free, 16 bit."""
    return edge_capture(truth, shape, **{"bright_dn": 52000.0, "black_dn": 1024.0, "white_dn": 65535.0} | options)


def any_angle(rng: np.random.Generator, low=2.0, high=43.0) -> float:
    return float(rng.uniform(low, high) * rng.choice([-1, 1]) + rng.choice([0, 90, 180, 270]))
