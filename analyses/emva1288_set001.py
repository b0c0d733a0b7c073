"""A real CCD with known photon numbers against the linear model of EMVA 1288: where it fails, what is missing, how sure.

Question: the published reference implementation leaves chi2 of about 390 on 36 degrees of freedom unexplained in this set.
Data: EMVA 1288 working group, reference set 001 (Basler AG, CC BY-SA 3.0), read from ``--data``; nothing of it is kept here.
Model: the standard's linear one, drafted by ``isetval campaign init`` from a part of the series; the others judge it.
Results: ``reports/emva1288_set001.html``, ``.json`` and ``.png``; with ``--quick`` (no comparison) in a minute.

    python analyses/emva1288_set001.py [--data FOLDER] [--quick]

The search takes the better part of an hour; by commands, in a copy of the set, it can be made once and shown here:

    isetval campaign init SET
    isetval diagnose SET/camera.toml SET/campaign_learn.toml --holdout SET/campaign_confirm.toml -o SET/d.json
    isetval add SET/camera.toml --from SET/d.json -o SET/model2.toml
    isetval compare SET/camera.toml SET/model2.toml SET/campaign_judge.toml -o SET/judge.json
    python analyses/emva1288_set001.py --found SET/d.json --judged SET/judge.json
"""

# %%
from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import isetval
from isetval.app.cli import main as isetval_command
from isetval.app.cli.tables import text_table
from isetval.app.words import relative_words
from isetval.core.campaign import Campaign
from isetval.files.emva_estimates import PARTS
from isetval.files.result_file import read_result

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from analyses.emva1288_causes import cause_lines, causes  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "real" / "emva1288_set001"
# what the working group's reference implementation (EMVA1288 1.0.2) gives for this set, README of the data
PUBLISHED = {"K": (0.28006, "DN/e-"), "eta": (45.2, "%"), "sigma_d": (10.92, "e-"), "DSNU": (0.553, "e-"), "PRNU": (0.433, "%")}
USED_PHOTONS = 29_000.0  # below the plateau of the converter
Float = NDArray[np.float64]


# %% The folder as `isetval campaign init` drafts it: parts to learn from, to confirm on and to judge by, and a linear camera
def laboratory(data: Path, folder: Path) -> Path:
    """A copy of the set with its drafted campaign and camera; a folder that was made before is taken as it is."""
    work = folder / "set"
    if not (work / "campaign.toml").is_file():
        shutil.copytree(data, work, dirs_exist_ok=True, copy_function=shutil.copyfile)
        if isetval_command(["campaign", "init", str(work), "-q"]) != 0:
            raise SystemExit(f"{work}: campaign init refused the folder; its sentence stands above")
    return work


# %% The table of the standard
def emva_table(campaign: Campaign) -> list[dict[str, object]]:
    """isetval's EMVA 1288 table of the two-frame series and the stacks, beside what was published."""
    flats = [s for s in campaign.shots if s.role == "flat" and s.frames == 2]
    darks = [s for s in campaign.shots if s.role == "dark" and s.frames == 2]
    captures = [c for s in flats for c in campaign.captures[s.name]]
    photons = [s.photons_per_pixel for s in flats for _ in range(s.frames)]
    dark = [c for s in darks[:1] for c in campaign.captures[s.name]]
    level = isetval.measure.emva1288(captures, dark=dark, photons_per_pixel=[*photons, *[None] * len(dark)])
    stacks = {s.role: campaign.captures[s.name] for s in campaign.shots if s.frames > 2}
    rows = [
        {"symbol": r.symbol, "name": r.name, "value": r.value, "sigma": r.sigma, "unit": r.unit, "note": r.note}
        for r in level.rows
    ]
    for row in rows:
        row["published"] = PUBLISHED.get(str(row["symbol"]), (None, ""))[0]
    return [*rows, *stack_rows(stacks)]


def stack_rows(stacks: dict[str, tuple[isetval.Capture, ...]]) -> list[dict[str, object]]:
    """PRNU and DSNU of the 50-frame stacks: covariance of the mean images of odd and even frames, free of temporal noise."""
    dark, flat = ([mean_of(stacks[role][i::2]) for i in (0, 1)] for role in ("dark", "flat"))
    level = float(np.mean(flat) - np.mean(dark))

    def common(pair: list[Float]) -> tuple[float, float]:
        a, b = (x - x.mean() for x in pair)
        variance = float(np.mean(a * b))
        spread = float(np.sqrt((np.mean(a**2) * np.mean(b**2) + variance**2) / a.size))
        return variance, spread

    (light, light_sigma), (black, black_sigma) = common(flat), common(dark)
    gain = PUBLISHED["K"][0]
    prnu = np.sqrt(max(light - black, 0.0)) / level
    dsnu = np.sqrt(max(black, 0.0)) / gain
    note = "all of the field, slow unevenness of the light included"
    return [
        {"symbol": "PRNU", "name": "50-frame stacks", "value": 100 * prnu, "unit": "%", "note": note,
         "published": PUBLISHED["PRNU"][0],
         "sigma": 100 * float(np.hypot(light_sigma, black_sigma)) / (2 * prnu * level**2)},
        {"symbol": "DSNU", "name": "50-frame stacks", "value": dsnu, "unit": "e-", "note": "with the published gain",
         "published": PUBLISHED["DSNU"][0], "sigma": black_sigma / (2 * dsnu * gain**2)},
    ]  # fmt: skip


# %% Is the gain the same at every level?  Two independent answers
def local_gain(campaign: Campaign) -> dict[str, list[float]]:
    """Gain by level from temporal noise and from the fixed pattern, each relative to a smooth curve, in percent.

    A converter whose codes are not equally wide amplifies noise and the camera's fixed pattern alike at each level: variance
    goes as the square of the local gain, the pattern's contrast as the gain itself.  The pattern is known from the stack of
    50 frames, whose noise is independent of all others.
    """
    stacks = {s.role: campaign.captures[s.name] for s in campaign.shots if s.frames > 2}
    dark = mean_of(stacks["dark"])
    halves = [mean_of(stacks["flat"][i::2]) - dark for i in (0, 1)]
    maps = [half / half.mean() - 1 for half in halves]
    pattern, power = (maps[0] + maps[1]) / 2, float(np.mean(maps[0] * maps[1]))
    rows = []
    for shot in campaign.shots:
        if shot.frames != 2 or shot.role != "flat" or not 900 < (shot.photons_per_pixel or 0.0) < USED_PHOTONS:
            continue
        a, b = (c.mosaic.astype(float) for c in campaign.captures[shot.name])
        difference = a - b - (a - b).mean()
        mean = (a + b) / 2
        level = float(mean.mean() - dark.mean())
        contrast = float(np.mean((mean - mean.mean() - dark + dark.mean()) * pattern)) / power / level
        variance = float(np.mean(difference**2)) / 2
        rows.append((level, variance, contrast, variance * np.sqrt(2 / a.size), np.sqrt(variance / 2 / a.size / power) / level))
    level, variance, contrast, variance_sigma, contrast_sigma = np.array(rows).T
    noise = relative(level, variance, variance_sigma, degree=3)
    fixed = relative(level, contrast, contrast_sigma, degree=2)
    return {
        "level_dn": level.tolist(),
        "variance_percent": (100 * noise).tolist(),
        "variance_sigma_percent": (100 * variance_sigma / variance).tolist(),
        "contrast_percent": (100 * fixed).tolist(),
        "contrast_sigma_percent": (100 * contrast_sigma / contrast).tolist(),
    }


def mean_of(captures: tuple[isetval.Capture, ...]) -> Float:
    """Mean of frames, (rows, cols)."""
    return np.mean([c.mosaic for c in captures], axis=0, dtype=float)


def relative(level: Float, value: Float, sigma: Float, *, degree: int) -> Float:
    """Deviation from a polynomial of the level, relative."""
    smooth = np.polynomial.Polynomial.fit(level, value, degree, w=1 / sigma)(level)
    return np.asarray(value / smooth - 1)


def slope_of(gain: dict[str, list[float]]) -> dict[str, float]:
    """Slope of variance over contrast with errors in both (2 where the local gain is the cause), and their correlation."""
    from scipy.optimize import minimize_scalar

    keep = np.array(gain["level_dn"]) > 800  # below, the pattern is lost in the noise
    x, y, sx, sy = (np.array(gain[f"{k}_percent"])[keep] for k in ("contrast", "variance", "contrast_sigma", "variance_sigma"))
    scatter = float(np.sqrt(np.mean(sx**2) / np.var(x)))

    def cost(slope: float) -> float:
        """-2 ln L of a line through 0 whose points have errors in both directions and lie normally along it."""
        along = max(np.var(x) - np.mean(sx**2), 1e-6)
        values = np.array([np.linalg.slogdet(c)[1] + d @ np.linalg.solve(c, d) for c, d in _points(slope, along, x, y, sx, sy)])
        return float(values.sum())

    best = minimize_scalar(cost, bounds=(-5, 8), method="bounded")
    step = 0.05
    curvature = (cost(best.x + step) - 2 * best.fun + cost(best.x - step)) / step**2
    return {
        "slope": float(best.x),
        "slope_sigma": float(np.sqrt(2 / curvature)),
        "correlation": float(np.corrcoef(x, y)[0, 1]),
        "noise_share_of_contrast": scatter,
        "levels": int(keep.sum()),
    }


def _points(slope: float, along: float, *data: Float) -> list[tuple[Float, Float]]:
    """Covariance (2, 2) and deviation (2,) of each point of a line with ``along`` its spread in x."""
    line = along * np.outer([1, slope], [1, slope])
    return [(line + np.diag([sx**2, sy**2]), np.array([x, y])) for x, y, sx, sy in zip(*data, strict=True)]


# %% Compare, diagnose, add, compare on what was not used
def run(
    data: Path, folder: Path, *, quick: bool, diagnose: bool = True, made: tuple[Path, Path] | None = None
) -> dict[str, object]:
    """Everything that is printed and drawn; ``made`` are results of the commands ``diagnose`` and ``compare``."""
    campaign = isetval.load_campaign(data)
    out: dict[str, object] = {"table": emva_table(campaign), "local_gain": local_gain(campaign)}
    out["local_gain_test"] = slope_of(out["local_gain"])  # type: ignore[arg-type]
    out["causes"] = causes(campaign)
    if made is not None:
        out["diagnosis"] = read_result(made[0], filled=True)
        out["held_out"] = read_result(made[1], filled=True)["ladder"]
        return out
    if quick:
        return out
    work = laboratory(data, folder)
    learn, confirm, judge = (isetval.load_campaign(work / f"campaign_{part}.toml") for part in PARTS)
    models = [isetval.load_model(work / "camera.toml")]
    if diagnose:
        found = isetval.diagnose(models[0], learn, confirm, say=print, with_next_captures=False)
        out["diagnosis"] = found.to_json()
        models += [replace(found.model, name="with what was named")] if found.effects else []
    out["held_out"] = [vars(row) for row in isetval.compare(models, judge, say=print).ladder]
    return out


# %% In words and as a picture
def lines(result: dict[str, object]) -> list[str]:
    """What a person reads."""
    test: dict[str, float] = result["local_gain_test"]  # type: ignore[assignment]
    out = cause_lines(result["causes"], PUBLISHED["K"][0])  # type: ignore[arg-type]
    out += [
        f"Variance against the contrast of the fixed pattern, level by level ({test['levels']} levels): "
        f"slope {test['slope']:.2f} +- {test['slope_sigma']:.2f} (2 if the local gain is the cause), "
        f"correlation {test['correlation']:.2f}."
    ]
    diagnosis = result.get("diagnosis")
    if isinstance(diagnosis, dict):
        out.append(f"verdict: {diagnosis['verdict']}")
        for effect in diagnosis["effects"]:
            values = ", ".join(f"{k} {p['value']:.5g} +- {p['sigma']:.2g} {p['unit']}" for k, p in effect["parameters"].items())
            rivals = ", ".join(effect["equivalent"]) or "no rival"
            out.append(f"  {effect['name']}: {values} (posterior {effect['posterior']:.3f}; {rivals})")
        out.append(f"  left over: {diagnosis['leftover']}")
        out += [f"  not looked at: {words}" for words in diagnosis.get("not_looked_at") or ()]
        for row in (r for r in diagnosis["ladder"] if r["family"] == "all"):
            where = f"{row['role']}, {row['captures']}"
            out.append(f"  {where}: {row['model']}: mean-square z {row['mean_square_z']:.1f}, n {row['n']}")
    return out


def held_out(result: dict[str, object]) -> list[list[object]]:
    """Families of the levels and stacks that nothing was learned from: mean-square z and relative error of each model."""
    held: list[dict[str, object]] = result.get("held_out", [])  # type: ignore[assignment]
    models = list(dict.fromkeys(row["model"] for row in held))
    table: list[list[object]] = [["family", "n", *(f"{m}: {what}" for m in models for what in ("mean-square z", "rms error"))]]
    for family in dict.fromkeys(row["family"] for row in held):
        own = [row for m in models for row in held if (row["family"], row["model"]) == (family, m)]
        cells = (cell for row in own for cell in (f"{row['mean_square_z']:.2f}", relative_words(row)))
        table.append([str(family).replace("_", " "), own[0]["n"], *cells])
    return table


def draw(result: dict[str, object], path: Path) -> None:
    """Both deviations by level, and against each other."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    gain: dict[str, list[float]] = result["local_gain"]  # type: ignore[assignment]
    level, v, vs = gain["level_dn"], gain["variance_percent"], gain["variance_sigma_percent"]
    c, cs = np.array(gain["contrast_percent"]), np.array(gain["contrast_sigma_percent"])
    figure, panels = plt.subplots(2, 2, figsize=(10, 7), layout="constrained", width_ratios=(2, 1))
    (left, right), (codes, steps) = panels
    causes_found: dict[str, object] = result["causes"]  # type: ignore[assignment]
    for k, (name, marks) in enumerate((("pattern_even", "o-"), ("pattern_odd", "s--"))):
        words = ("even levels", "odd levels")[k]
        codes.plot(range(16), causes_found[name], marks, ms=4, lw=1, mfc="none" if k else None, label=words)  # type: ignore[arg-type]
    codes.set(xlabel="code modulo 16", ylabel="width of the codes / LSB", title="measured: counts of codes over a smooth curve")
    codes.legend()
    named: dict[str, dict[str, float]] = causes_found["steps"]  # type: ignore[assignment]
    steps.barh([name.replace(", ", ",\n") for name in named], [step["chi2"] for step in named.values()])
    steps.invert_yaxis()
    steps.set(xlabel=f"chi2 of {causes_found['judged']} odd levels", title="model: variance against light")
    left.errorbar(level, v, vs, fmt="o", ms=4, label="temporal variance")
    left.errorbar(level, 2 * c, 2 * cs, fmt="s", ms=3, mfc="none", label="2 x contrast of the fixed pattern")
    left.set(xlabel="level / DN", ylabel="deviation from a smooth curve / %", ylim=(-4, 4))
    left.legend()
    right.errorbar(c, v, vs, cs, fmt="o", ms=3)
    line = np.array([-1.5, 1.5])
    right.plot(line, 2 * line, "k--", lw=1, label="slope 2: local gain")
    right.set(xlabel="contrast / %", ylabel="variance / %", xlim=(-2, 2), ylim=(-3, 3))
    right.legend()
    figure.suptitle("Measured: EMVA 1288 reference set 001 (Basler AG, CC BY-SA 3.0); gain that changes from level to level")
    figure.savefig(path, dpi=120)


def write_page(result: dict[str, object], path: Path) -> None:
    """Everything in one page; the picture is inside it."""
    import base64
    from html import escape

    def cells(values: list[object], tag: str = "td") -> str:
        plain = ("" if v is None or v != v else f"{v:.4g}" if isinstance(v, float) else str(v) for v in values)
        return "<tr>" + "".join(f"<{tag}>{escape(v)}</{tag}>" for v in plain) + "</tr>"

    keys = ("symbol", "name", "value", "sigma", "unit", "published", "note")
    table = cells(list(keys), "th") + "".join(cells([row[k] for k in keys]) for row in result["table"])  # type: ignore[attr-defined]
    said = "".join(f"<p>{escape(line)}</p>" for line in lines(result))
    head, *families = held_out(result)
    rows = cells(head, "th") + "".join(map(cells, families))
    held = f"<h2>Levels and stacks that nothing was learned from</h2><table>{rows}</table>" if families else ""
    if "diagnosis" not in result:
        said += "<p>isetval diagnose was not run for this page (no --diagnose); the causes are named by its own test.</p>"
    picture = base64.b64encode(path.with_suffix(".png").read_bytes()).decode()
    style = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:auto;padding:1rem}table{border-collapse:collapse;display:block;overflow-x:auto}td,th{border-bottom:1px solid #ccc;padding:.2rem .6rem;text-align:left}img{max-width:100%}"  # noqa: E501
    path.write_text(
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>EMVA 1288 set 001</title><style>{style}</style><h1>A real CCD with known photon numbers</h1>"
        "<p>Measured: EMVA 1288 working group, reference set 001 (Basler AG, CC BY-SA 3.0); published: reference implementation "
        "1.0.2; the rest is this project's. Nothing of the pictures is kept here.</p>"
        f"<h2>What the linear model leaves</h2>{said}<img alt='local gain' src='data:image/png;base64,{picture}'>"
        "<p>Sure: code counts, temporal noise and fixed pattern are three measurements that share no random number, and each was "
        "judged on levels that nothing was learned from. Not sure: what else makes the last chi2 more than its degrees of freedom"
        " "
        "(widths that go together over more than 16 codes would). A test: the same camera with another analog gain or offset; "
        "codes of unequal width stay at the same codes, effects of the light do not.</p>"
        f"{held}<h2>Table of the standard</h2><table>{table}</table>"
        "</html>\n"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the set (default: %(default)s)")
    parser.add_argument("--work", type=Path, help="folder for the drafted campaign, kept (default: a temporary one)")
    parser.add_argument("--quick", action="store_true", help="table and local gain alone, without comparison and diagnosis")
    parser.add_argument("--diagnose", action="store_true", help="ask isetval for the missing effect as well (minutes)")
    parser.add_argument("--found", type=Path, metavar="RESULT", help="JSON of `isetval diagnose`, in place of asking again")
    parser.add_argument("--judged", type=Path, metavar="RESULT", help="JSON of `isetval compare` that goes with --found")
    options = parser.parse_args()
    if (options.found is None) != (options.judged is None):
        parser.error("--found and --judged go together")
    if not options.data.is_dir():
        raise SystemExit(f"{options.data}: the set is not there; name its folder with --data")
    with tempfile.TemporaryDirectory() as temporary:
        made = run(
            options.data,
            options.work or Path(temporary),
            quick=options.quick,
            diagnose=options.diagnose,
            made=(options.found, options.judged) if options.found else None,
        )
    head, *families = held_out(made)
    judged = ["levels and stacks that nothing was learned from", *text_table(head, families)] if families else []
    print("\n".join([*lines(made), *judged]))
    (ROOT / "reports" / "emva1288_set001.json").write_text(json.dumps(made, indent=1, default=float) + "\n")
    draw(made, ROOT / "reports" / "emva1288_set001.png")
    write_page(made, ROOT / "reports" / "emva1288_set001.html")
