"""Plots of relative illumination: curves with sigma, residual map, colour shading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.app.plots.panels import PLANE_COLORS, own_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def falloff_figure(result: Any, *, predictions: Mapping[str, tuple[Any, Any]] | None = None) -> Figure:
    """Panels of a ``RelativeIllumination``: curves, difference to predictions, colour shading (of colour sensors), residual map.

    Parameters
    ----------
    result : RelativeIllumination
    predictions : mapping of label to (radius_mm, relative illumination), optional
    """
    from matplotlib.figure import Figure

    colored = bool(result.color_shading)
    figure = Figure(figsize=(10, 7) if colored else (13, 4), layout="constrained")
    axes = list(figure.subplots(2, 2).flat if colored else figure.subplots(1, 3))
    plot_relative_illumination(result, axes.pop(0), predictions=predictions)
    _differences(axes.pop(0), result, predictions or {})
    if colored:
        _ratios(axes.pop(0), result)
    plot_illumination_residuals(result, axes.pop(0))
    row, col = result.center_px
    figure.suptitle(
        f"centre (row, col) {row:.1f}, {col:.1f} px; {result.basis} of order {result.order}; chi2/dof {result.chi2_dof:.3f}"
    )
    return figure


def plot_relative_illumination(
    result: Any, ax: Axes | None = None, *, predictions: Mapping[str, tuple[Any, Any]] | None = None
) -> Axes:
    """Radial curve and ring means of every plane of a ``RelativeIllumination``; dotted where no ring supports it."""
    axis = own_axes(ax)
    for name, plane in result.planes.items():
        inside = _inside(plane)
        axis.plot(plane.radius_mm[inside], plane.curve[inside], color=PLANE_COLORS.get(name), label=name, lw=1)
        axis.plot(plane.radius_mm[~inside], plane.curve[~inside], ":", color=PLANE_COLORS.get(name), lw=1)
        axis.errorbar(plane.ring_radius_mm, plane.ring, plane.ring_sigma, fmt=".", ms=3, color=PLANE_COLORS.get(name))
    for label, (radius, value) in (predictions or {}).items():
        axis.plot(radius, value, "k--", lw=1, label=label)
    _finish(axis, "relative illumination")
    return axis


def _inside(plane: Any) -> Any:
    """Where a curve stands on rings, (n,) bool; further out it is extrapolated."""
    return plane.radius_mm <= plane.ring_radius_mm[-1]


def _differences(axis: Axes, result: Any, predictions: Mapping[str, tuple[Any, Any]]) -> None:
    """Measured minus predicted in points; without a prediction, ring means minus curve."""
    for name, plane in result.planes.items():
        color = PLANE_COLORS.get(name)
        if not predictions:
            rings = np.clip(plane.ring_radius_mm, 0, plane.radius_mm[-1])
            axis.errorbar(rings, 100 * (plane.ring - plane.at(rings)[0]), 100 * plane.ring_sigma, fmt=".", ms=3, color=color)
            continue
        radius, value = next(iter(predictions.values()))
        inside = _inside(plane)
        place, sigma = plane.radius_mm[inside], 100 * plane.sigma[inside]
        # beyond the prediction's own end there is nothing to compare with
        difference = 100 * (plane.curve[inside] - np.interp(place, radius, value, right=np.nan))
        axis.plot(place, difference, color=color, label=name)
        axis.fill_between(place, difference - sigma, difference + sigma, color=color, alpha=0.2, lw=0)
    axis.axhline(0, color="gray", lw=0.8)
    _finish(axis, f"minus {next(iter(predictions))} (points)" if predictions else "rings minus curve (points)")


def _ratios(axis: Axes, result: Any) -> None:
    colors = ("tab:red", "tab:blue", "tab:green")
    for color, (name, shading) in zip(colors, result.color_shading.items(), strict=False):
        axis.plot(shading.radius_mm, shading.ratio, color=color, label=name)
        axis.fill_between(
            shading.radius_mm, shading.ratio - shading.sigma, shading.ratio + shading.sigma, color=color, alpha=0.2, lw=0
        )
    _finish(axis, "colour shading")


def plot_illumination_residuals(result: Any, ax: Axes | None = None) -> Axes:
    """Map of (block - model) / sigma of the plane with most light, and the fitted centre."""
    axis = own_axes(ax)
    name, plane = max(result.planes.items(), key=lambda item: item[1].signal_dn)
    z = (plane.map - plane.model) / plane.map_sigma
    drawn = axis.scatter(
        plane.map_col_px.ravel(), plane.map_row_px.ravel(), c=z.ravel(), s=4, vmin=-4, vmax=4, cmap="RdBu_r", rasterized=True
    )
    axis.plot(result.center_px[1], result.center_px[0], "k+")
    axis.invert_yaxis()
    axis.set_aspect("equal")
    axis.set_xlabel("column (px)")
    axis.set_ylabel("row (px)")
    axis.set_title(f"{name}: residual / sigma", fontsize="medium")
    figure = axis.get_figure(root=True)
    assert figure is not None
    figure.colorbar(drawn, ax=axis, shrink=0.8)
    return axis


def _finish(axis: Axes, label: str) -> None:
    axis.set_xlabel("distance from the fitted centre (mm)")
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[1]:
        axis.legend(fontsize="small")
