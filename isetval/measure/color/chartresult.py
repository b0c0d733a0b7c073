"""Result of a chart measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.color.patches import PatchRows

Float = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseLine:
    """Pixel variance against mean over the patches: ``variance = intercept + slope x mean``.

    ``slope_dn`` is the conversion gain in DN/e- where noise is shot and read noise only; ``chi2_dof`` above 1
    has widened the sigmas.
    """

    slope_dn: float
    slope_sigma_dn: float
    intercept_dn2: float
    intercept_sigma_dn2: float
    chi2_dof: float
    patches: int


@dataclass(frozen=True, eq=False)
class ChartResult:
    """A measured chart.

    Parameters
    ----------
    patches : PatchRows
        Statistics, one row a patch, one column a plane; ``sigma_dn`` holds row noise too where it is significant.
    names : tuple of str
    corners_px : (patches, 4, 2)
        (row, col) of each measured quadrilateral in pixels of the capture.
    noise_lines : mapping
        Mean-variance line of each plane, and of all together under ``"all"``.
    found_by : str
        ``finder``, ``corners`` or ``boxes``.
    confidence, runner_up : float
        Agreement of the patch colours with the chart (1 is perfect), and that of the next best reading direction.
    grid_error : float
        rms distance of the found centres from a projected grid, in patch pitches (NaN for boxes).
    row_noise_dn : mapping of plane to float
        Standard deviation of whole rows beyond pixel noise (0 where not significant).
    """

    patches: PatchRows
    names: tuple[str, ...]
    corners_px: Float
    noise_lines: Mapping[str, NoiseLine]
    found_by: str
    confidence: float
    runner_up: float
    grid_error: float
    mirrored: bool
    turned_deg: float
    row_noise_dn: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def planes(self) -> tuple[str, ...]:
        """Plane names, in the order of the columns."""
        return self.patches.planes

    @property
    def mean_dn(self) -> Float:
        """(patches, planes), DN above black."""
        return self.patches.mean_dn

    @property
    def sigma_dn(self) -> Float:
        """Standard deviation of ``mean_dn``."""
        return self.patches.sigma_dn

    @property
    def rgb(self) -> tuple[Float, Float]:
        """Means and sigma, (patches, 3): R, mean green, B."""
        return self.patches.rgb

    def rows(self) -> list[dict[str, Any]]:
        """One dictionary a patch and plane, for tables and JSON."""
        p = self.patches
        return [
            {
                "patch": name,
                "number": i + 1,
                "plane": plane,
                "mean_dn": float(p.mean_dn[i, j]),
                "sigma_dn": float(p.sigma_dn[i, j]),
                "noise_dn": float(p.noise_dn[i, j]),
                "nonuniformity_dn": float(p.nonuniformity_dn[i, j]),
                "pixels": int(p.pixels[i, j]),
                "clipped_pixels": int(p.clipped_pixels[i, j]),
                "bad_pixels": int(p.bad_pixels[i, j]),
            }
            for i, name in enumerate(self.names)
            for j, plane in enumerate(p.planes)
        ]
