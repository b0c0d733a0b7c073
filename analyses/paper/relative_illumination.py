# %% [markdown]
# # Relative illumination: what does the phone lose beyond its lens?
#
# The paper: the lens alone falls off less than the phone; "the most likely cause is that we did not model the microlens array".
# Here the sentence is a test: the loss is diagnosed from every second height of the measured curve, with its rivals, added to
# the model, and judged on the heights in between.  The lens stands in twice: as the published file, and as the design's own
# table, from which the file departs by up to 3 % of its light at the corner.  A curve of the light against height alone cannot
# say where in the camera a loss sits: what it can say is which one-line forms predict the heights in between.
# Data: measured curve (digitised, +-.003), the authors' simulation and the design's table; the published lens file.
# Run time: a minute.

# %%
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

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
from isetval.core.campaign import Nuisance
from isetval.effects import catalogue
from isetval.lens import load_lens
from isetval.lens.illumination import chief_ray_angle_deg

TARGET_POINTS = 0.5
AT_THE_PIXEL = ("pixel_angular_response", "microlens")
"""The catalogue's two losses by the angle of arrival: stated in that angle, or, to second order, in the field radius."""
STEP_MM = 0.02  # of the design's table as the model reads it, linearly: its bend errs by 1e-5
FILM_PRIOR_UM = 100.0  # as good as free: the tolerance of a film is some um


@dataclass(frozen=True)
class Rival:
    """A one-line explanation: effects to add with where their fit starts, parameters to free with their prior sigma."""

    words: str
    starts: Mapping[str, Mapping[str, Any]]
    free: Mapping[str, float]


def _by_angle(words: str, form: str = "gaussian", *, shift: bool = False, rim: bool = False) -> Rival:
    free = {"pixel_angular_response.m_green": 0.1}
    starts: dict[str, Mapping[str, Any]] = {"pixel_angular_response": {"m_green": 0.1, "form": form}}
    if shift:
        free["pixel_angular_response.shift_deg"] = 15.0
    if rim:
        starts["vignetting"] = {"v": 0.05}
        free |= {"vignetting.v": 0.2, "vignetting.r0": 0.15}
    return Rival(words, starts, free)


RIVALS = (
    Rival("film distance", {}, {"ray_transfer.film_shift_um": FILM_PRIOR_UM}),
    Rival("black level", {}, {"black_level.offset_dn": 2.0}),
    Rival("vignetting, its onset free", {"vignetting": {"v": 0.1}}, {"vignetting.v": 0.2, "vignetting.r0": 0.15}),
    Rival("1 - m r^2, as another cos4 exponent", {"microlens": {"m_green": 0.2}}, {"microlens.m_green": 0.15}),
    _by_angle("loss by chief ray angle"),
    _by_angle("and a shift of the microlenses", shift=True),
    _by_angle("the same as 1 - m sin^2", "sin2", shift=True),
    _by_angle("loss by chief ray angle, and vignetting", rim=True),
)
"""Priors are the catalogue's but where stated; a cos4 exponent itself cannot stand beside a traced lens, which contains it."""


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
    _design_table(data, folder)
    return folder


def _design_table(data: Path, folder: Path) -> None:
    """The design's own fall-off as a lens table, with the chief rays of the file, which the design's table does not hold."""
    rows = csv_rows(data / "zemax_relative_illumination.csv")
    height, value, f_number = columns(rows, "image_height_mm", "relative_illumination", "effective_f_number")
    film = isetval.load_model(folder / "camera.toml").value("ray_transfer.film_mm")
    at = np.arange(0.0, height[-1], STEP_MM)
    angle = chief_ray_angle_deg(load_lens(folder / "lens.json"), at, film_mm=film)
    curves = {"relative_illumination": CubicSpline(height, value)(at), "chief_ray_angle_deg": angle}
    table: list[tuple[Any, ...]] = [("f_number", "", "", f_number[0])]
    table += [(name, f"{h:.2f}", "", v) for name, values in curves.items() for h, v in zip(at, values, strict=True)]
    write_rows(folder / "design.csv", ("quantity", "height_mm", "frequency_cy_mm", "value"), table)


def on_design(model: isetval.CameraModel) -> isetval.CameraModel:
    """The camera behind the design's table in the place of the file."""
    lens = replace(model.effect("ray_transfer"), file="design.csv", film_mm=0.0)
    return replace(model.replace(lens), name="design_table")


def gap_points(model: isetval.CameraModel, campaign: isetval.Campaign) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height, measured minus simulated and simulated, in mm and points of 100; nothing is refitted."""
    table = isetval.compare(model, replace(campaign, nuisances=())).table
    height = table["field_x_mm"].to_numpy(float)
    simulated = table["simulated"].to_numpy(float)
    return height, 100 * (table["measured"].to_numpy(float) - simulated), 100 * simulated


# %% One-line explanations: fitted on every second height, judged on the others
@dataclass(frozen=True)
class Rung:
    """An explanation with one lens: fitted values with sigma, mean-square z there, rms in points at the held-out heights."""

    words: str
    fitted: Mapping[str, tuple[float, float]]
    mean_square_z: float
    held_points: float


def rung(rival: Rival, lens: isetval.CameraModel, fitted: isetval.Campaign, held: isetval.Campaign) -> Rung | None:
    """None where the lens has no such parameter (a table has no film)."""
    model = lens
    for name, start in rival.starts.items():
        model = model.add(catalogue()[name]().changed(**start))
    if any(key.startswith("ray_transfer.film") for key in rival.free) and not lens.value("ray_transfer.film_mm"):
        return None
    model = replace(model, name="rival")
    free = tuple(Nuisance(key, sigma, "own", "campaign") for key, sigma in rival.free.items())
    found = isetval.compare(model, replace(fitted, nuisances=(*fitted.nuisances, *free)))
    moved = {key.split("@")[0]: v for key, v in found.nuisances["rival"].items()}
    values = {key: (float(model.value(key)) + moved[key][0], moved[key][1]) for key in rival.free}
    _, gap, _ = gap_points(model.with_values({key: v for key, (v, _) in values.items()}), held)
    return Rung(rival.words, values, found.ladder[0].mean_square_z, rms(gap))


# %% The diagnosis, with both lenses
@dataclass(frozen=True, eq=False)
class Verdict:
    """What `diagnose` says with one lens, and its gaps at the held-out heights before and after."""

    lens: str
    found: Any
    height: np.ndarray = field(repr=False)
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)
    ours: np.ndarray = field(repr=False)

    @property
    def names(self) -> list[str]:
        """Named effects, in order."""
        return [effect.name for effect in self.found.effects]

    @property
    def words(self) -> str:
        """Named effects, with the form where it is none of the catalogue's."""
        return f"{self.lens}: " + (", ".join(effect.words for effect in self.found.effects) or "none")


def verdict(lens: str, model: isetval.CameraModel, fitted: isetval.Campaign, held: isetval.Campaign) -> Verdict:
    """Diagnose on the fitted heights, add, look at the others."""
    found = isetval.diagnose(model, fitted, holdout=held)
    height, before, _ = gap_points(model, held)
    _, after, ours = gap_points(found.apply(), held)
    return Verdict(lens, found, height, before, after, ours)


def run(data: Path, work: Path) -> Result:
    """Compare, diagnose, add, compare on the held-out heights."""
    folder = prepared(data, work)
    model = isetval.load_model(folder / "camera.toml")
    lenses = {"lens file": model, "design's table": on_design(model)}
    fitted, held = (isetval.load_campaign(folder / f"{name}.toml") for name in ("fitted", "held_out"))
    verdicts = [verdict(words, lens, fitted, held) for words, lens in lenses.items()]
    rungs = {words: [rung(rival, lens, fitted, held) for rival in RIVALS] for words, lens in lenses.items()}
    first = verdicts[0]
    published = _published_rms(data)
    claims = (
        Claim(
            claim="relative illumination at held-out heights (rms, largest gap, in points of 100)",
            published=f"{published[0]:.2f}, {published[1]:.2f}",
            measured="digitised to +- 0.3",
            ours="; ".join(f"{v.lens} {_gap(v.after)} (alone {_gap(v.before)})" for v in verdicts),
            missing="; ".join(f"{v.lens}: " + (", ".join(_words(e) for e in v.found.effects) or "none") for v in verdicts),
            sure="fitted on every second height, nothing refitted on the others; verdicts "
            + _listed(v.found.verdict for v in verdicts),
            target=f"rms <= {TARGET_POINTS}",
            met=all(rms(v.after) <= TARGET_POINTS for v in verdicts),
            numbers={
                "rms_points": rms(first.after),
                "largest_points": float(np.abs(first.after).max()),
                "lens_rms_points": rms(first.before),
                "design_rms_points": rms(verdicts[1].after),
            },
        ),
        _falls(data, first.height, first.ours),
        _class_claim(verdicts),
        _form_claim(rungs),
    )
    return Result(
        key="relative_illumination",
        title="Relative illumination",
        claims=claims,
        figure=drawn(data, verdicts),
        caption="Left: fall-off, measured (digitised), the authors' simulation (published), the design's table, and ours at the "
        "heights that were held out. Right: measured minus simulated at those heights, before and after the loss was added, "
        "with the lens file and with the design's table.",
        remarks=first.found.notes,
        ladder=_table(rungs),
    )


def _gap(points: np.ndarray) -> str:
    return f"{rms(points):.2f}, {np.abs(points).max():.2f}"


def _listed(words: Any) -> str:
    return " and ".join(dict.fromkeys(words))


def _class_claim(verdicts: list[Verdict]) -> Claim:
    """The class of the loss, its form by the detective's evidence, its rivals."""
    forms = [
        f"{v.lens}, {e.name}: "
        + ", ".join(f"{row.form}, {len(row.free)} free (ln evidence {row.log_evidence:.1f})" for row in e.forms)
        for v in verdicts
        for e in v.found.effects
        if e.forms
    ]
    named = [bool(v.names) and v.names[0] in AT_THE_PIXEL for v in verdicts]
    odds = [f"{v.lens} " + ", ".join(f"{e.name} {e.posterior:.3f}" for e in v.found.effects) for v in verdicts]
    return Claim(
        claim="what the loss is ('most likely the microlens array')",
        published="named by eye, not simulated",
        measured="-",
        ours="; ".join(v.words for v in verdicts),
        missing="a loss at the pixel by the angle of arrival",
        sure="posterior of each name with its look-alikes: " + "; ".join(odds) + ". Forms by evidence: " + "; ".join(forms),
        target="an angle-dependent loss at the pixel is named by itself, with either lens",
        met=all(named),
        numbers={"named": float(named[0]), "named_design": float(named[1])},
    )


def _form_claim(rungs: Mapping[str, list[Rung | None]]) -> Claim:
    """What the heights in between say of the one-line forms."""
    best = {lens: min((r for r in made if r), key=lambda r: r.held_points) for lens, made in rungs.items()}
    file, design = (made[-1] for made in rungs.values())
    rim = [r.fitted["vignetting.v"] for r in (file, design)]
    loss = [r.fitted["pixel_angular_response.m_green"] for r in (file, design)]
    film = next(iter(rungs.values()))[0]
    shift = film.fitted["ray_transfer.film_shift_um"][0]
    return Claim(
        claim="which form of the loss the heights in between ask for (held-out rms in points)",
        published="-",
        measured="-",
        ours="; ".join(f"{lens}: {r.words} {r.held_points:.2f}" for lens, r in best.items()),
        missing=f"a loss of {100 * loss[0][0]:.1f} +- {100 * loss[0][1]:.1f} % at 30 degrees (design's table "
        f"{100 * loss[1][0]:.1f}) and, at the corner, {100 * rim[0][0]:.1f} +- {100 * rim[0][1]:.1f} % of vignetting "
        f"({100 * rim[1][0]:.1f}: the file keeps light there that the design does not)",
        sure=f"film distance alone leaves {film.held_points:.2f} at {shift:.0f} um. The chief rays turn back beyond 2.75 mm: a "
        "loss by angle alone cannot fall there as measured; shifted microlenses or a rim that cuts can, and the latter predicts "
        "better. A radial loss anywhere else would look the same: the curve fixes the form, not the place",
        numbers={"file_points": best["lens file"].held_points, "design_points": best["design's table"].held_points},
    )


def _table(rungs: Mapping[str, list[Rung | None]]) -> tuple[tuple[str, ...], ...]:
    """All one-line explanations with both lenses."""
    head = ("fitted on every second height", *(f"{lens}: held-out rms (mean-square z fitted)" for lens in rungs), "fitted values")
    rows = []
    for made in zip(*rungs.values(), strict=True):
        some = next(r for r in made if r)
        cells = (f"{r.held_points:.2f} ({r.mean_square_z:.1f})" if r else "-" for r in made)
        values = ", ".join(f"{k.split('.')[1]} {round(v, 6):.3g} +- {s:.1g}" for k, (v, s) in some.fitted.items())
        rows.append((some.words, *cells, values))
    return (head, *rows)


def _words(effect) -> str:
    own = {k: v for k, v in effect.parameters.items() if not k.startswith("free_")}
    shown = {k: v for k, v in own.items() if abs(v.value) > 1e-9 or v.sigma < 0.1}  # the curve is of the greens alone
    values = ", ".join(f"{k} {v.value:.3g} +- {v.sigma:.2g}{'' if v.unit == '1' else ' ' + v.unit}" for k, v in shown.items())
    return f"{effect.words} ({values})"


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
def drawn(data: Path, verdicts: list[Verdict]):
    """Curves on the left, what is left over on the right."""
    from matplotlib.figure import Figure

    first = verdicts[0]

    figure = Figure(figsize=(9.5, 3.9), layout="constrained")
    curves, rest = figure.subplots(1, 2)
    rows = csv_rows(data / "measured" / "relative_illumination.csv")
    for name, color, label in (
        ("ri_zemax", DESIGN, "lens design (table)"),
        ("ri_simulated_rtf_pbrt", PUBLISHED, "published simulation"),
        ("ri_measured", MEASURED, "measured"),
    ):
        curves.plot(*columns(rows, "image_height_mm", name), color=color, label=label)
    curves.plot(first.height, first.ours / 100, ".", color=OURS, label="ours, held-out heights")
    curves.set(xlabel="field height / mm", ylabel="relative illumination", ylim=(0, 1.02))
    curves.legend(frameon=False)
    rest.axhspan(-0.3, 0.3, color="0.9", label="digitisation")
    for v, color, mark in zip(verdicts, (PUBLISHED, DESIGN), ("o", "s"), strict=True):
        rest.plot(v.height, v.before, mark, ms=4, mfc="none", color=color, label=f"{v.lens} alone (simulated)")
    for v, mark in zip(verdicts, (".", "+"), strict=True):
        rest.plot(v.height, v.after, mark, color=OURS, label=f"{v.lens}, with the diagnosed loss (simulated)")
    rest.set(xlabel="field height / mm", ylabel="measured - simulated / points", ylim=(-8.5, 4.5))
    rest.legend(frameon=False, fontsize=8, loc="upper right")
    return figure


if __name__ == "__main__":
    main(run, "Relative illumination: measured, published, ours.")
