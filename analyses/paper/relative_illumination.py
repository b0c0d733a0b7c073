# %% [markdown]
# # Relative illumination: what does the phone lose beyond its lens?
#
# The paper: the lens alone falls off less than the phone; "the most likely cause is that we did not model the microlens array".
# Here the sentence is a test: the loss is diagnosed from every second height of the measured curve, with its rivals, added to
# the model, and judged on the heights in between.
# Data: measured curve (digitised, +-.003), the authors' simulation and the design's table; the published lens file.
# Run time: under a minute.

# %%
from __future__ import annotations

from pathlib import Path

import numpy as np

import isetval
from analyses.paper.common import (
    DESIGN,
    MEASURED,
    OURS,
    PRINTED,
    PUBLISHED,
    Claim,
    Result,
    columns,
    csv_rows,
    laboratory,
    main,
    qe_file,
    rms,
    write_rows,
)

TARGET_POINTS = 0.5
RIVALS = {"ray_transfer": "film distance", "cos4": "cos4 exponent", "vignetting": "vignetting", "microlens": "1 - m r^2"}


# %% The campaign: the curve as two, every second height in each; the camera: the published lens file
def prepared(data: Path, work: Path) -> Path:
    """The folder with both campaigns, their curves and the camera."""
    folder = laboratory("relative_illumination", work)
    rows = csv_rows(data / "measured" / "relative_illumination.csv")
    height, value = columns(rows, "image_height_mm", "ri_measured")
    for i, name in enumerate(("fitted", "held_out")):
        write_rows(folder / f"{name}.csv", ("radius_mm", "relative_illumination"), zip(height[i::2], value[i::2], strict=True))
    (folder / "lens.json").write_bytes((data / "rtf_pixel4a_rear_ellipse_poly4.json").read_bytes())
    qe_file(data, folder / "qe.csv")
    return folder


def gap_points(model: isetval.CameraModel, campaign: isetval.Campaign) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height, measured minus simulated and simulated, in mm and points of 100; nothing is refitted."""
    from dataclasses import replace

    table = isetval.compare(model, replace(campaign, nuisances=())).table
    height = table["field_x_mm"].to_numpy(float)
    simulated = table["simulated"].to_numpy(float)
    return height, 100 * (table["measured"].to_numpy(float) - simulated), 100 * simulated


# %% The diagnosis, and the ladder on heights that it did not see
def run(data: Path, work: Path) -> Result:
    """Compare, diagnose, add, compare on the held-out heights."""
    folder = prepared(data, work)
    model = isetval.load_model(folder / "camera.toml")
    fitted, held = (isetval.load_campaign(folder / f"{name}.toml") for name in ("fitted", "held_out"))
    found = isetval.diagnose(model, fitted, holdout=held)
    better = found.apply()
    height, before, _ = gap_points(model, held)
    _, after, ours = gap_points(better, held)
    effects = ", ".join(_words(effect) for effect in found.effects) or "none"
    by_name = {row.name: row for row in found.candidates}
    names = [effect.name for effect in found.effects]
    rivals = "; ".join(_rival(by_name[n], words) for n, words in RIVALS.items() if n in by_name and n not in names)
    forms = [f"{row.form} (ln evidence {row.log_evidence:.1f})" for e in found.effects for row in e.forms]
    published = _published_rms(data)
    claims = (
        Claim(
            claim="relative illumination at held-out heights (rms, largest gap, in points of 100)",
            published=f"{published[0]:.2f}, {published[1]:.2f}",
            measured="digitised to +- 0.3",
            ours=f"{rms(after):.2f}, {np.abs(after).max():.2f} (lens alone {rms(before):.2f}, {np.abs(before).max():.2f})",
            missing=effects,
            sure=f"verdict {found.verdict}; {rivals}",
            target=f"rms <= {TARGET_POINTS}",
            met=rms(after) <= TARGET_POINTS,
            numbers={"rms_points": rms(after), "largest_points": float(np.abs(after).max()), "lens_rms_points": rms(before)},
        ),
        _falls(data, height, ours),
        Claim(
            claim="what the loss is ('most likely the microlens array')",
            published="named by eye, not simulated",
            measured="-",
            ours=", ".join(names),
            missing="a loss by angle of incidence",
            sure="forms by evidence: " + ", ".join(forms),
            target="pixel_angular_response named by itself",
            met=names[:1] == ["pixel_angular_response"],
            numbers={"named": float("pixel_angular_response" in names)},
        ),
    )
    return Result(
        key="relative_illumination",
        title="Relative illumination",
        claims=claims,
        figure=drawn(data, height, ours, before, after),
        caption="Left: fall-off, measured (digitised), the authors' simulation (published), the design's table, and ours at the "
        "heights that were held out. Right: measured minus simulated at those heights, before and after the loss was added.",
        remarks=found.notes,
    )


def _words(effect) -> str:
    shown = {k: v for k, v in effect.parameters.items() if v.value or v.sigma < 0.1}  # the curve is of the greens alone
    values = ", ".join(f"{k} {v.value:.3g} +- {v.sigma:.2g}{'' if v.unit == '1' else ' ' + v.unit}" for k, v in shown.items())
    return f"{effect.name} (posterior {effect.posterior:.2f}: {values})"


def _rival(row, words: str) -> str:
    if row.posterior is None:
        return f"{words}: not among the survivors of the score test"
    return f"{words}: posterior {row.posterior:.1g}"


def _published_rms(data: Path) -> tuple[float, float]:
    """The authors' simulation against the measured curve, points, where both can be read."""
    _, measured, simulated = columns(
        csv_rows(data / "measured" / "relative_illumination.csv"), "image_height_mm", "ri_measured", "ri_simulated_rtf_pbrt"
    )
    gap = 100 * (measured - simulated)
    return rms(gap), float(np.abs(gap).max())


def _falls(data: Path, height: np.ndarray, ours: np.ndarray) -> Claim:
    """The fall-off at 3 mm that the paper states in its text."""
    said = PRINTED["relative_illumination"]
    at = said["height_mm"]
    rows = csv_rows(data / "measured" / "relative_illumination.csv")
    falls = {}
    for name in ("ri_measured", "ri_simulated_rtf_pbrt", "ri_zemax"):
        falls[name] = 100 * (1 - float(np.interp(at, *columns(rows, "image_height_mm", name))))
    mine = 100 - float(np.interp(at, height, ours))
    return Claim(
        claim=f"falls off by {said['lens_falls_by']:.0%} (lens) and {said['measured_falls_by']:.0%} (phone) at {at:g} mm",
        published=f"{falls['ri_simulated_rtf_pbrt']:.1f} % (design {falls['ri_zemax']:.1f} %)",
        measured=f"{falls['ri_measured']:.1f} +- 0.3 %",
        ours=f"{mine:.1f} %",
        missing="the printed percentages are those of 3.5 mm, the edge of the figure",
        sure="read off the same figure: certain to the digitisation",
        numbers={"ours_percent": mine, "measured_percent": falls["ri_measured"]},
    )


# %% The paper's figure beside ours
def drawn(data: Path, height: np.ndarray, ours: np.ndarray, before: np.ndarray, after: np.ndarray):
    """Curves on the left, what is left over on the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.9), layout="constrained")
    curves, rest = figure.subplots(1, 2)
    rows = csv_rows(data / "measured" / "relative_illumination.csv")
    for name, color, label in (
        ("ri_zemax", DESIGN, "lens design (table)"),
        ("ri_simulated_rtf_pbrt", PUBLISHED, "published simulation"),
        ("ri_measured", MEASURED, "measured"),
    ):
        curves.plot(*columns(rows, "image_height_mm", name), color=color, label=label)
    curves.plot(height, ours / 100, ".", color=OURS, label="ours, held-out heights")
    curves.set(xlabel="field height / mm", ylabel="relative illumination", ylim=(0, 1.02))
    curves.legend(frameon=False)
    rest.axhspan(-0.3, 0.3, color="0.9", label="digitisation")
    rest.plot(height, before, "o", mfc="none", color=PUBLISHED, label="lens alone (simulated)")
    rest.plot(height, after, ".", color=OURS, label="with the diagnosed loss (simulated)")
    rest.set(xlabel="field height / mm", ylabel="measured - simulated / points")
    rest.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main(run, "Relative illumination: measured, published, ours.")
