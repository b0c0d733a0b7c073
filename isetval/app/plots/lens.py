"""Plots of a lens: fall-off and chief ray, focus, spots, MTF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots.panels import plain_log
from isetval.lens.focus import film_for_object, focus_curve
from isetval.lens.psf import mtf
from isetval.lens.spots import spot
from isetval.lens.transfer_file import load_lens

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isetval.lens.audit_report import LensAudit
    from isetval.lens.ray_transfer import RayTransferLens


def audit_figure(audit: LensAudit) -> Figure:
    """Four panels: relative illumination, chief ray, distortion, and focus with the stated pairs."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots(2, 2)
    _curve(axes[0, 0], audit.r_mm, audit.relative_illumination, "relative illumination")
    _curve(axes[0, 1], audit.r_mm, audit.chief_ray_angle_deg, "chief ray angle (deg)")
    _curve(axes[1, 0], audit.r_mm, audit.distortion_percent, "distortion (%)")
    _focus(axes[1, 1], audit)
    figure.suptitle(f"{audit.name}: F/{audit.f_number:.2f} from the pass region, {len(audit.flags)} contradictions")
    return figure


def lens_figures(file: Path | str, audit: LensAudit, *, whole: bool = True) -> list[Figure]:
    """The audit's curves and, for the ``whole``, focus, spots, MTF and depth of field of the lens in ``file``."""
    figures = [audit_figure(audit)]
    if not whole:
        return figures
    lens = load_lens(file)
    heights = [share * max(audit.r_mm) for share in (0.0, 0.5, 0.9)]
    figures.append(focus_figure(lens))
    figures.append(spot_figure(lens, heights_mm=heights))
    figures.append(mtf_figure(lens, heights_mm=heights))
    return [*figures, depth_of_field_figure(lens, focus_m=(0.3, 1.0))]


def _curve(axis: Axes, x: Sequence[float], y: Sequence[float], label: str) -> None:
    """One quantity over the field height."""
    axis.plot(x, y, color="tab:blue")
    axis.set_xlabel("image height (mm)")
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)


def _focus(axis: Axes, audit: LensAudit) -> None:
    """Film distance over 1/object distance, with stated pairs as crosses."""
    pairs = [(1 / o, f) for o, f in audit.focus if not math.isinf(o)] + [(0.0, f) for o, f in audit.focus if math.isinf(o)]
    pairs.sort()
    axis.plot([v for v, _ in pairs], [f for _, f in pairs], color="tab:blue", label="best focus")
    if audit.stated_focus:
        stated = [(1 / s.stated_object_m, s.film_mm) for s in audit.stated_focus]
        axis.plot([v for v, _ in stated], [f for _, f in stated], "x", color="tab:red", label="stated")
        axis.legend()
    axis.set_xlim(-0.1, 5)
    films = [f for v, f in pairs if v <= 5] + [s.film_mm for s in audit.stated_focus]
    axis.set_ylim(min(films) - 0.01, max(films) + 0.01)
    axis.set_xlabel("1 / object distance (1/m)")
    axis.set_ylabel("film to rear vertex (mm)")
    axis.grid(alpha=0.3)


def spot_figure(
    lens: RayTransferLens, *, heights_mm: Sequence[float], object_m: float = math.inf, film_mm: float | None = None
) -> Figure:
    """Spot diagrams at several field heights, one color per wavelength table; 20 um squares."""
    from matplotlib.figure import Figure

    film = film_for_object(lens, object_m) if film_mm is None else film_mm
    figure = Figure(figsize=(2.4 * len(heights_mm), 2.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(heights_mm), sharex=True, sharey=True))
    for axis, r in zip(axes, heights_mm, strict=True):
        for wavelength in lens.wavelengths_nm:
            s = spot(lens, r_mm=r, film_mm=film, object_m=object_m, wavelength_nm=wavelength)
            axis.plot(*(s.offset_mm * 1e3), ".", markersize=1.5, label=f"{wavelength:g} nm")
        axis.set_title(f"{r:.2f} mm", fontsize=9)
        axis.set_xlim(-10, 10)
        axis.set_ylim(-10, 10)
        axis.set_aspect("equal")
    axes[0].set_ylabel("tangential (um)")
    axes[0].set_xlabel("sagittal (um)")
    axes[-1].legend(fontsize=7)
    return figure


def mtf_figure(
    lens: RayTransferLens, *, heights_mm: Sequence[float], object_m: float = math.inf, film_mm: float | None = None
) -> Figure:
    """Tangential (full) and sagittal (dashed) MTF up to 360 cycles/mm, diffraction included."""
    from matplotlib.figure import Figure

    film = film_for_object(lens, object_m) if film_mm is None else film_mm
    frequency = np.linspace(0, 360, 91)
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axis = figure.subplots()
    for i, r in enumerate(heights_mm):
        tangential, sagittal = mtf(lens, frequency, r_mm=r, film_mm=film, object_m=object_m)
        axis.plot(frequency, tangential, color=f"C{i}", label=f"{r:.2f} mm")
        axis.plot(frequency, sagittal, "--", color=f"C{i}")
    axis.set_xlabel("frequency on the film (cycles/mm)")
    axis.set_ylabel("MTF")
    axis.set_ylim(0, 1.02)
    axis.grid(alpha=0.3)
    axis.legend(title="image height")
    return figure


def focus_figure(lens: RayTransferLens, *, objects_m: Sequence[float] = (0.1, 0.2, 0.3, 0.5, 1.0, 3.0, 10.0)) -> Figure:
    """Best film distance over object distance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4), layout="constrained")
    axis = figure.subplots()
    axis.semilogx(objects_m, focus_curve(lens, objects_m), "o-")
    axis.set_xlabel("object to front vertex (m)")
    axis.set_ylabel("film to rear vertex (mm)")
    plain_log(axis, "x")
    axis.grid(alpha=0.3)
    return figure


def depth_of_field_figure(
    lens: RayTransferLens,
    *,
    focus_m: Sequence[float],
    frequency_cy_mm: float = 100.0,
    objects_m: Sequence[float] | None = None,
    height_mm: float = 0.0,
) -> Figure:
    """MTF at one frequency over the distance of the object, one pair of curves a focus distance (dashed: sagittal).

    Parameters
    ----------
    focus_m : sequence
        Distances on which the lens is focused, from the front vertex; each is a vertical line.
    frequency_cy_mm : float
        Frequency on the film.
    objects_m : sequence, optional
        Distances of the object; by default 40 from half the nearest to twice the furthest focus.
    height_mm : float
        Field height on the film.
    """
    from matplotlib.figure import Figure

    objects = np.geomspace(0.5 * min(focus_m), 2 * max(focus_m), 40) if objects_m is None else np.asarray(objects_m, float)
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axis = figure.subplots()
    for i, distance in enumerate(focus_m):
        film = film_for_object(lens, distance)
        pairs = [mtf(lens, [frequency_cy_mm], r_mm=height_mm, film_mm=film, object_m=float(o)) for o in objects]
        for direction, style in ((0, "-"), (1, "--")):
            label = f"focus {distance:g} m, film {film:.4f} mm" if direction == 0 else None
            axis.semilogx(objects, [pair[direction][0] for pair in pairs], style, color=f"C{i}", label=label)
        axis.axvline(distance, color=f"C{i}", linewidth=0.8, linestyle=":")
    axis.set_xlabel("object to front vertex (m)")
    axis.set_ylabel(f"MTF at {frequency_cy_mm:g} cycles/mm")
    axis.set_ylim(0, 1.02)
    plain_log(axis, "x")
    axis.set_title(f"{lens.name}, image height {height_mm:g} mm", fontsize=9)
    axis.grid(alpha=0.3)
    axis.legend()
    return figure
