# %% [markdown]
# # The lens: does the ray-transfer file say what the design says?
#
# The paper: the ray-transfer function in the renderer matches the design's line spread, MTF and relative illumination.
# Data: the published lens file (exact) and the design's tables (exact); the file is audited by `isetval lens audit`.
# Run time: half a minute.

# %%
from __future__ import annotations

from pathlib import Path

import numpy as np

from analyses.paper.common import DESIGN, OURS, Claim, Result, columns, crossing, csv_rows, main, rms
from isetval.lens import audit_file, load_lens
from isetval.lens.focus import film_for_object
from isetval.lens.illumination import irradiance_factor
from isetval.lens.psf import mtf

FILE = "rtf_pixel4a_rear_ellipse_poly4.json"
FIELDS_MM = (0.0, 1.4)  # of the figure: the axis, and 40 % of the field
HIGHEST_CY_MM = 350.0


# %%
def run(data: Path, work: Path) -> Result:
    """The file's own curves against the design's tables, and what the audit finds."""
    lens, found = load_lens(data / FILE), audit_file(data / FILE)
    height, design, f_design = columns(
        csv_rows(data / "zemax_relative_illumination.csv"), "image_height_mm", "relative_illumination", "effective_f_number"
    )
    inside = height <= 3.5
    factor = irradiance_factor(lens, height[inside], film_mm=found.film_mm)
    gap = 100 * (factor / factor[0] - design[inside])
    film = _fitted_film(data, lens)
    curves = {field: _mtf(data, lens, field, film) for field in _fields(data)}
    axis = curves[0.0]
    off = max(rms(c[2] - c[1]) for c in curves.values())
    codes = [flag.code for flag in found.flags]
    claims = (
        Claim(
            claim="relative illumination of the lens file against the design (points of 100)",
            published="'matches very closely'",
            measured="-",
            ours=f"rms {rms(gap):.2f}, largest {np.abs(gap).max():.2f}",
            missing="nothing in the shape; a half-sized pupil hardly changes it",
            sure="both tables exact",
            numbers={"rms_points": rms(gap)},
        ),
        Claim(
            claim="absolute light and defocus blur of the lens file (f-number)",
            published=f"F/{f_design[0]:.2f} (design's table, on axis)",
            measured="-",
            ours=f"F/{found.f_number:.2f} traced from the file",
            missing="half of the pupil's diameter: light "
            + ", ".join(f"{v:.2f} times too low for F/{found.stated_f_number[k]:.2f}" for k, v in found.light_factor.items()),
            sure="the rim is one circle in the entrance pupil at all heights: the edge of the sampled pupil, not of the lens",
            numbers={"f_number": found.f_number, "design_f_number": float(f_design[0])},
        ),
        Claim(
            claim="MTF of the lens file against the design, geometric (rms over frequency; MTF50 on axis, cy/mm)",
            published="'matches'",
            measured=f"design: {crossing(axis[0], axis[1]):.0f}",
            ours=f"on axis rms {rms(axis[2] - axis[1]):.3f}, MTF50 {crossing(axis[0], axis[2]):.0f}; worst field rms {off:.3f}",
            missing="the design's table is polychromatic, at the full pupil, its distance unstated; the file has one wavelength",
            sure="one film distance, fitted to the design's on-axis curve; off the axis the conditions differ: no verdict",
            numbers={"axis_rms": rms(axis[2] - axis[1])},
        ),
        Claim(
            claim="the lens file agrees with itself and its label",
            published="not examined",
            measured="-",
            ours=f"{len(codes)} contradictions: {', '.join(dict.fromkeys(codes))}",
            missing="; ".join(f"{flag.code}: {flag.found.split(':')[0].split(';')[0]}" for flag in found.flags[2:5]),
            sure="computed from the file alone",
            target="the nine contradictions are named",
            met=len(codes) >= 9,
            numbers={"contradictions": float(len(codes))},
        ),
    )
    return Result(
        key="lens",
        title="The lens file",
        claims=claims,
        figure=drawn(height[inside], design[inside], factor / factor[0], {f: curves[f] for f in _drawn_fields(curves)}),
        caption="Left: relative illumination, the design's table (published) and traced from the lens file (ours, simulated). "
        "Right: geometric MTF (tangential) on and off the axis, the design's table and the lens file's own trace.",
    )


def _fitted_film(data: Path, lens) -> float:
    """The film at which the file's on-axis curve is nearest to the design's, whose focus is not stated; far object, mm."""
    from scipy.optimize import minimize_scalar

    best = film_for_object(lens, np.inf)

    def gap(film: float) -> float:
        _, design, traced = _mtf(data, lens, 0.0, film)
        return rms(design - traced)

    return float(minimize_scalar(gap, bounds=(best, best + 0.02), method="bounded", options={"xatol": 1e-5}).x)


def _fields(data: Path) -> list[float]:
    rows = csv_rows(data / "zemax_geometric_mtf.csv")
    return sorted({float(r["field_mm"]) for r in rows if float(r["field_mm"]) <= 3.5})


def _drawn_fields(curves) -> list[float]:
    """The tabulated fields nearest to those of the figure."""
    return [min(curves, key=lambda f: abs(f - wanted)) for wanted in FIELDS_MM]


def _mtf(data: Path, lens, field: float, film: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, the design's tangential MTF and the file's, without diffraction on both sides."""
    rows = [r for r in csv_rows(data / "zemax_geometric_mtf.csv") if float(r["field_mm"]) == field]
    frequency, design = columns(rows, "freq_cy_per_mm", "mtf_tangential")
    keep = frequency <= HIGHEST_CY_MM
    tangential, _ = mtf(lens, frequency[keep], r_mm=field, film_mm=film, diffraction=False)
    return frequency[keep], design[keep], tangential


# %% The paper's figure beside ours
def drawn(height: np.ndarray, design: np.ndarray, ours: np.ndarray, curves):
    """Fall-off and MTF."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(height, design, "o", mfc="none", color=DESIGN, label="design's table")
    left.plot(height, ours, color=OURS, label="lens file, traced")
    left.set(xlabel="field height / mm", ylabel="relative illumination", ylim=(0, 1.02))
    left.legend(frameon=False)
    for (field, (frequency, table, traced)), style in zip(curves.items(), ("-", "--"), strict=False):
        right.plot(frequency, table, style, color=DESIGN, label=f"design's table, {field:.2g} mm")
        right.plot(frequency, traced, style, color=OURS, label=f"lens file, {field:.2g} mm")
    right.set(xlabel="frequency / (cycles/mm)", ylabel="geometric MTF", xlim=(0, HIGHEST_CY_MM), ylim=(0, 1.02))
    right.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    main(run, "The lens file against the design.")
