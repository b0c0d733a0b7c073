"""Chart measurement: where the patches are, their means, noise and doubts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, check_roi
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.core.threads import one_blas_thread
from isetval.measure.color.chart_finding import FoundChart, find_chart
from isetval.measure.color.chart_layout import (
    LAB_D50,
    PATCH_NAMES,
    PATCHES,
    from_centers,
    from_corners,
    handedness,
    match_score,
    patch_quads,
    reading_orders,
    turn_deg,
)
from isetval.measure.color.color_error import ColorError, color_error
from isetval.measure.color.patch_statistics import DIFFERENCE_VARIANCE_FACTOR, PatchRows, quad_rows

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
# of a patch's pixels: a normal noise that reaches white with so many loses 6e-4 of its sigma in the mean
CLIPPED_SHARE = 0.002
# between right order (.86 on the Canon 550D's chart, .90 on made ones) and wrong orders (below 0 on both)
DOUBTFUL_SCORE = 0.75


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


@dataclass(frozen=True, eq=False, repr=False)
class ChartResult(Drawn):
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

    def headline(self) -> str:
        """Patches, certainty of the reading, brightest levels."""
        brightest = dict(zip(self.planes, (float(v) for v in np.max(self.mean_dn, axis=0)), strict=True))
        levels = ", ".join(f"{plane} {level:.1f}" for plane, level in brightest.items())
        doubts = f", {len(self.warnings)} warnings" if self.warnings else ""
        return (
            f"{len(self.names)} patches by {self.found_by}, colours agree {self.confidence:.2f}, "
            f"brightest in DN: {levels}{doubts}"
        )

    def to_frame(self) -> pd.DataFrame:
        """One row a patch and plane: name, channel, patch, value, sigma, unit."""
        import pandas as pd

        rows = [
            ("patch_mean", plane, patch, float(self.mean_dn[i, k]), float(self.sigma_dn[i, k]), "DN")
            for i, patch in enumerate(self.names)
            for k, plane in enumerate(self.planes)
        ]
        return pd.DataFrame(rows, columns=["name", "channel", "patch", "value", "sigma", "unit"])

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

    def color_error(self, lab: ArrayLike | None = None) -> ColorError:
        """CIEDE2000 of the patches with one gain a channel and with a fitted 3 x 3 matrix.

        Parameters
        ----------
        lab : (patches, 3), optional
            CIE L*, a*, b* (D50) of the patches; by default the published ones of the 24-patch chart made before
            November 2014 (later charts differ by about 1, worn ones by more: measure your own for small errors).

        Raises
        ------
        InputError
            For a capture without colours, or patches without published colours.
        MeasurementError
            When fewer than six patches are unclipped.
        """
        if len(self.planes) != 4:
            raise InputError(f"the capture has the plane {', '.join(self.planes)}; a colour error needs R, Gr, Gb and B")
        if lab is None and len(self.names) != PATCHES:
            raise InputError(f"{len(self.names)} patches have no published colours; give lab, L*, a*, b* (D50) of each")
        published = LAB_D50 if lab is None else np.asarray(lab, dtype=float)
        clipped = self.patches.clipped_pixels > CLIPPED_SHARE * np.maximum(self.patches.pixels, 1)
        mean, sigma = self.rgb
        return color_error(mean, sigma, published, usable=np.asarray(~clipped.any(axis=1)), names=self.names)

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


@one_blas_thread()
def chart(
    capture: Capture,
    *,
    corners: ArrayLike | None = None,
    boxes: Sequence[RoiLike] | ArrayLike | None = None,
    fraction: float = 0.5,
    names: Sequence[str] | None = None,
    choices: Mapping[str, Any] | None = None,
) -> ChartResult:
    """Patch means of a 24-patch chart per colour plane, with sigma.

    Parameters
    ----------
    capture : Capture
    corners : (4, 2), optional
        (row, col) of the outer corners of patches 1, 6, 24 and 19 in pixels of the capture; by default the
        chart is looked for.
    boxes : (patches, 4), optional
        (row0, row1, col0, col1) of every patch, half open: any number of patches in any layout.
    fraction : float
        Side of the measured part of a patch in pitches of the grid, 0.1 to 0.8.
    names : sequence of str, optional
        Patch names; by default those of the 24-patch chart.
    choices : mapping, optional
        ``{"corners_px": ...}`` of an earlier result, to measure the same places again.

    Returns
    -------
    ChartResult

    Raises
    ------
    MeasurementError
        When no chart is found, or the patches are too small to measure.
    InputError
        When corners or boxes do not fit the capture.

    Notes
    -----
    Noise is half the mean square of same-colour neighbour differences: shading inside a patch does not enter it and
    is reported apart as non-uniformity.
    """
    if not 0.1 <= fraction <= 0.8:
        raise InputError(f"fraction is {fraction}; it needs 0.1 to 0.8 of the patch pitch")
    if sum(v is not None for v in (corners, boxes)) > 1:
        raise InputError("give corners or boxes, not both")
    settings = {"fraction": fraction, "corners": corners, "boxes": boxes}
    if boxes is not None:
        return _from_boxes(capture, np.asarray(boxes, dtype=np.int64).reshape(-1, 4), names, settings)
    found, grid_error = None, float("nan")
    if choices and "corners_px" in choices:
        quads, how = np.asarray(choices["corners_px"], dtype=float), "choices"
    elif corners is not None:
        quads, how = patch_quads(from_corners(corners), fraction), "corners"
    else:
        found = find_chart(capture)
        matrix, grid_error = from_centers(found.centers_px)
        quads, how = patch_quads(matrix, fraction), "finder"
    patches, row_noise = quad_rows(capture, quads)
    return _finish(patches, quads, names, how=how, found=found, grid_error=grid_error, row_noise=row_noise, settings=settings)


def _from_boxes(
    capture: Capture, boxes: NDArray[np.int64], names: Sequence[str] | None, settings: Mapping[str, Any]
) -> ChartResult:
    for box in boxes:
        check_roi(capture, tuple(box))
    edges = boxes - np.array([0, 1, 0, 1])
    quads = np.stack([edges[:, [0, 2]], edges[:, [0, 3]], edges[:, [1, 3]], edges[:, [1, 2]]], axis=1).astype(float)
    patches, row_noise = quad_rows(capture, quads)
    return _finish(
        patches, quads, names, how="boxes", found=None, grid_error=float("nan"), row_noise=row_noise, settings=settings
    )


def _finish(
    patches: PatchRows,
    quads: Float,
    names: Sequence[str] | None,
    *,
    how: str,
    found: FoundChart | None,
    grid_error: float,
    row_noise: Mapping[str, float],
    settings: Mapping[str, Any],
) -> ChartResult:
    """Names, orientation check, noise lines and warnings."""
    count = len(patches.mean_dn)
    if names is not None and len(names) != count:
        raise InputError(f"{len(names)} names for {count} patches; give one for each")
    labels = (
        tuple(names) if names is not None else PATCH_NAMES if count == PATCHES else tuple(f"patch {k + 1}" for k in range(count))
    )
    centers = quads.mean(axis=1)
    scores = {}
    if count == PATCHES and len(patches.planes) == 4:
        rgb = patches.rgb[0]
        scores = {name: match_score(rgb[order]) for name, order in reading_orders().items()}
    confidence = scores.get("upright", float("nan"))
    others = [v for k, v in scores.items() if k != "upright"]
    mirrored = bool(count == PATCHES and how != "boxes" and not handedness(centers))
    return ChartResult(
        patches=patches,
        names=labels,
        corners_px=quads,
        noise_lines=_noise_lines(patches),
        found_by=how,
        confidence=confidence,
        runner_up=max(others) if others else float("nan"),
        grid_error=grid_error,
        mirrored=mirrored,
        turned_deg=turn_deg(centers) if count == PATCHES else float("nan"),
        row_noise_dn=row_noise,
        warnings=tuple(_warnings(patches, labels, scores, mirrored=mirrored, found=found)),
        settings=settings,
    )


def _warnings(
    patches: PatchRows, labels: Sequence[str], scores: Mapping[str, float], *, mirrored: bool, found: FoundChart | None
) -> list[str]:
    out = []
    if mirrored:
        out.append("the chart is mirrored: check whether the raw file or the optics flip the picture")
    if scores and scores["upright"] < max(scores.values()) - 0.05:
        better = max(scores, key=lambda name: scores[name])
        out.append(f"the patch colours fit the chart better when read {better}: check the order of corners or boxes")
    elif scores and scores["upright"] < DOUBTFUL_SCORE:
        out.append(f"the patch colours fit the chart with only {scores['upright']:.2f}: check the place and the kind of chart")
    if found is not None and found.score - found.runner_up < 0.1:
        out.append("the reading direction of the chart is uncertain: two directions fit almost alike")
    share = patches.clipped_pixels / np.maximum(patches.pixels, 1)
    for i, j in np.argwhere(share > CLIPPED_SHARE):
        part = f"{100 * share[i, j]:.1f} % of the pixels are clipped"
        out.append(f"patch {labels[i]}, plane {patches.planes[j]}: {part}; its mean is biased")
    return out


def _noise_lines(patches: PatchRows) -> dict[str, NoiseLine]:
    lines = {p: _line(patches, [j]) for j, p in enumerate(patches.planes)}
    lines["all"] = _line(patches, list(range(len(patches.planes))))
    return {name: line for name, line in lines.items() if line is not None}


def _line(patches: PatchRows, columns: list[int]) -> NoiseLine | None:
    """Weighted straight line of variance against mean over unclipped patches, weights from the fitted variance."""
    mean, variance = patches.mean_dn[:, columns].ravel(), patches.noise_dn[:, columns].ravel() ** 2
    pixels = patches.pixels[:, columns].ravel().astype(float)
    use = (patches.clipped_pixels[:, columns].ravel() <= CLIPPED_SHARE * pixels) & (variance > 0)
    if use.sum() < 3 or np.ptp(mean[use]) <= 0:
        return None
    mean, variance, pixels = mean[use], variance[use], pixels[use]
    model = np.maximum(variance, 1e-12)
    matrix = np.stack([np.ones_like(mean), mean], axis=1)
    for _ in range(5):
        weight = np.sqrt(pixels / DIFFERENCE_VARIANCE_FACTOR) / model
        solution = np.linalg.lstsq(matrix * weight[:, None], variance * weight, rcond=None)[0]
        model = np.maximum(matrix @ solution, 0.1 * np.median(variance))
    covariance = np.linalg.inv((matrix * weight[:, None]).T @ (matrix * weight[:, None]))
    chi2_dof = float((((variance - matrix @ solution) * weight) ** 2).sum()) / max(mean.size - 2, 1)
    sigma = np.sqrt(np.diag(covariance) * max(1.0, chi2_dof))
    return NoiseLine(float(solution[1]), float(sigma[1]), float(solution[0]), float(sigma[0]), chi2_dof, int(mean.size))
