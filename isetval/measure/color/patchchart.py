"""Chart measurement: where the patches are, their means, noise and doubts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, Roi, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.color.chartresult import ChartResult, NoiseLine
from isetval.measure.color.finding import FoundChart, find_chart
from isetval.measure.color.grid import from_centers, from_corners, handedness, inside_quad, patch_quads, turn_deg
from isetval.measure.color.patches import (
    DIFFERENCE_VARIANCE_FACTOR,
    PatchRows,
    difference_variance,
    good_pixels,
)
from isetval.measure.color.reference import PATCH_NAMES, arrangements, match_score

Float = NDArray[np.float64]
CLIPPED_SHARE = 0.002
DOUBTFUL_SCORE = 0.75


def chart(
    capture: Capture,
    *,
    corners: ArrayLike | None = None,
    boxes: Sequence[Roi] | ArrayLike | None = None,
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
    patches, row_noise = _measure_quads(capture, quads)
    return _finish(patches, quads, names, how=how, found=found, grid_error=grid_error, row_noise=row_noise, settings=settings)


def _from_boxes(
    capture: Capture, boxes: NDArray[np.int64], names: Sequence[str] | None, settings: Mapping[str, Any]
) -> ChartResult:
    for box in boxes:
        check_roi(capture, tuple(box))
    edges = boxes - np.array([0, 1, 0, 1])
    quads = np.stack([edges[:, [0, 2]], edges[:, [0, 3]], edges[:, [1, 3]], edges[:, [1, 2]]], axis=1).astype(float)
    patches, row_noise = _measure_quads(capture, quads)
    return _finish(
        patches, quads, names, how="boxes", found=None, grid_error=float("nan"), row_noise=row_noise, settings=settings
    )


def _measure_quads(capture: Capture, quads: Float) -> tuple[PatchRows, dict[str, float]]:
    """Statistics of quadrilaterals (patches, 4, 2) in every plane, row noise added to sigma."""
    rows, cols = capture.mosaic.shape
    if quads.min() < -0.5 or quads[..., 0].max() > rows - 0.5 or quads[..., 1].max() > cols - 0.5:
        raise InputError(
            f"the patches span rows {quads[..., 0].min():.0f}..{quads[..., 0].max():.0f} and columns "
            f"{quads[..., 1].min():.0f}..{quads[..., 1].max():.0f}, outside the capture of {rows} x {cols} pixels"
        )
    planes = planes_of(capture)
    columns, row_noise = [], {}
    for plane in planes:
        table = [_quad_statistics(capture, plane, quad) for quad in quads]
        values = [np.array(v) for v in zip(*table, strict=True)]
        excess = _row_variance(values[7], values[8])
        row_noise[plane] = float(np.sqrt(excess))
        values[1] = np.sqrt(values[1] ** 2 + excess / values[9])
        columns.append(values[:7])
    return PatchRows(planes, *(np.stack([c[k] for c in columns], axis=1) for k in range(7))), row_noise


def _quad_statistics(capture: Capture, plane: str, quad: Float) -> tuple[float, ...]:
    """Seven columns of PatchRows, then row-mean variance, its pixel share, and the number of rows."""
    step = 1 if capture.sensor.cfa == "MONO" else 2
    low, high = np.floor(quad.min(axis=0)).astype(int), np.ceil(quad.max(axis=0)).astype(int) + 1
    shape = capture.mosaic.shape
    box = (max(low[0], 0), min(high[0], shape[0]), max(low[1], 0), min(high[1], shape[1]))
    view, first, _ = plane_view(capture, plane, box)
    row = first[0] + step * np.arange(view.shape[0], dtype=float)[:, None]
    col = first[1] + step * np.arange(view.shape[1], dtype=float)[None, :]
    mask = inside_quad(quad, row, col)
    if mask.sum() < 9:
        raise MeasurementError(
            f"a patch at rows {box[0]}..{box[1]}, columns {box[2]}..{box[3]} holds {int(mask.sum())} pixels of plane {plane}; "
            "it needs at least 9: come closer or give a larger fraction"
        )
    values = view.astype(np.float64)
    variance = float(difference_variance(values[None], mask[None])[0])
    good = good_pixels(values, variance, mask)
    sample = values[good]
    clipped = int(((view >= capture.sensor.white_dn) | (view == 0))[mask].sum())
    excess = float(sample.var(ddof=1)) - variance
    width = mask.sum(axis=1)
    full = np.flatnonzero(width >= 0.5 * width.max())
    means = np.where(mask, values, 0).sum(axis=1)[full] / width[full]
    scatter = float(np.mean(np.diff(means) ** 2) / 2) if full.size > 2 else 0.0
    return (
        float(sample.mean()) - plane_black_dn(capture, plane),
        float(np.sqrt(variance / sample.size)),
        float(np.sqrt(variance)),
        float(np.sign(excess) * np.sqrt(abs(excess))),
        sample.size,
        clipped,
        int(mask.sum()) - sample.size,
        scatter,
        variance / float(width[full].mean()),
        float(full.size),
    )


def _row_variance(scatter: Float, own: Float) -> float:
    """Variance of whole rows beyond pixel noise, from the patches with least noise; 0 where not significant."""
    quiet = np.argsort(own)[: max(6, own.size // 2)]
    excess = scatter[quiet] - own[quiet]
    mean, error = float(excess.mean()), float(excess.std(ddof=1) / np.sqrt(excess.size)) if excess.size > 1 else 0.0
    return mean if mean > 3 * error else 0.0


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
    labels = tuple(names) if names is not None else PATCH_NAMES if count == 24 else tuple(f"patch {k + 1}" for k in range(count))
    centers = quads.mean(axis=1)
    scores = {}
    if count == 24 and len(patches.planes) == 4:
        rgb = patches.rgb[0]
        scores = {name: match_score(rgb[order]) for name, order in arrangements().items()}
    confidence = scores.get("upright", float("nan"))
    others = [v for k, v in scores.items() if k != "upright"]
    mirrored = bool(count == 24 and how != "boxes" and not handedness(centers))
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
        turned_deg=turn_deg(centers) if count == 24 else float("nan"),
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
