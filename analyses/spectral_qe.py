# %% [markdown]
# # Spectral QE: does the 3x3 matrix come back, which patches disturb it, and what do chart and line say on real data?
#
# Question: is M found within its sigma from 24 patches under three lights, are fluorescent patches named and not
# lost, how well does M predict a light and a patch that it has not seen, and how far can published reflectances be
# trusted for it?
# Data: `../shared/data/pixel4a` (nominal QE, radiances of 24 patches under A, CWF, Day, the paper's M; digitised
# grey-row profiles) and `../shared/data/real/canon550d_colorchecker.dng`; see the READMEs there.  Without them
# only made-up smooth spectra are used.
# Result: target against measured, printed; `--json` and `--figure` write it.  Run time: about a minute.

# %%
from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from isetval import Capture, read_dng
from isetval.measure import chart, line_profile, spectral_qe
from isetval.measure.color import predicted_responses
from isetval.measure.color.chart_layout import linear_rgb

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
LIGHTS = ("A", "CWF", "Day")
PATCHES = tuple(f"p{k:02d}" for k in range(1, 25))
# Lyu et al., printed matrix; row vector nominal times M
PAPER_M = np.array([[0.5636, 0.0807, 0.0069], [0.0, 0.5917, 0.0], [0.0, 0.2470, 0.7098]])
GAIN, READ_DN, PIXELS = 0.1707, 0.504, 400
# grey patches 19..24 of the Canon frame above 2048.7 DN, 16 x 16 pixels (README of the data folder)
CANON_GREYS = {
    "R": (814, 524, 328, 172, 84, 32),
    "G": (1161, 763, 480, 266, 133, 51),
    "B": (514, 341, 219, 117, 63, 30),
}


# %%
def made_up(rng):
    """Smooth filters, lights and reflectances: (wavelengths, qe, spectra (lights, patches, wavelengths))."""
    nm = np.arange(400.0, 701.0, 10.0)
    qe = np.stack([0.5 * np.exp(-(((nm - c) / w) ** 2)) for c, w in ((610, 45), (535, 50), (460, 40))], axis=1)
    lights = np.stack([(nm / 550) ** 3, 0.4 + np.exp(-(((nm - 545) / 25) ** 2)), (nm / 550) ** -1.5])
    reflectance = np.stack([np.interp(nm, np.linspace(400, 700, 6), rng.uniform(0.03, 0.9, 6)) for _ in PATCHES])
    return nm, qe, lights[:, None, :] * reflectance


def published():
    """Nominal QE and measured patch radiances, or None without the data."""
    folder = DATA / "pixel4a"
    if not folder.exists():
        return None
    filters = np.genfromtxt(folder / "sensor_qe_nominal_derived.csv", delimiter=",", names=True)
    nm = filters["wavelength_nm"]
    radiance = np.genfromtxt(folder / "mcc_mini_radiance.csv", delimiter=",", names=True)
    at = radiance["wavelength_nm"]
    spectra = np.array([[np.interp(nm, at, radiance[f"{light}_{p}"]) for p in PATCHES] for light in LIGHTS])
    return nm, np.stack([filters[c] for c in ("qe_r", "qe_g", "qe_b")], axis=1), spectra


def exposed(nm, qe, spectra):
    """Predicted responses with each light exposed to 800 DN."""
    predicted = predicted_responses(spectra, qe, wavelength_nm=nm)
    return predicted * 800 / predicted.max(axis=(1, 2), keepdims=True)


def noisy(rng, clean):
    """Patch means of 400 pixels a channel with the Pixel 4a's noise, and their sigma."""
    sigma = np.sqrt((READ_DN**2 + 1 / 12 + GAIN * clean) / PIXELS)
    return clean + sigma * rng.standard_normal(clean.shape), sigma


# %%
def recovery(trials, seed, source):
    """Planted M, with and without two fluorescent patches."""
    rng = np.random.default_rng(seed)
    found = {"plain": [], "fluorescent": []}
    for _ in range(trials):
        predicted = exposed(*(source or made_up(rng)))
        for name, rows in found.items():
            clean = predicted @ PAPER_M
            planted = set()
            if name == "fluorescent":
                clean[1, 4] += (20.0, 8.0, 0.0)
                clean[2, 13] += (0.0, 15.0, 8.0)
                planted = {"p05", "p14"}
            measured, sigma = noisy(rng, clean)
            result = spectral_qe(measured, predicted, sigma=sigma, lights=LIGHTS, patches=PATCHES)
            rows.append((result, planted))
    out = {}
    for name, rows in found.items():
        pulls = np.array([(r.matrix_free - PAPER_M) / r.sigma_free for r, _ in rows])
        error = np.array([r.matrix - PAPER_M for r, _ in rows])
        bent = np.array([r.matrix_all - PAPER_M for r, _ in rows])
        out[name] = {
            "largest_rmse": float(np.sqrt(np.mean(error**2, axis=0)).max()),
            "largest_rmse_all_patches": float(np.sqrt(np.mean(bent**2, axis=0)).max()),
            "coverage_68": float(np.mean(np.abs(pulls) < 1)),
            "coverage_95": float(np.mean(np.abs(pulls) < 1.96)),
            "named": float(np.mean([planted <= set(r.outliers) for r, planted in rows])),
            "false_alarms": float(np.mean([bool(set(r.outliers) - planted) for r, planted in rows])),
            "held_out_light": float(np.mean([h.rms_relative for r, _ in rows for h in r.holdout_light])),
            "held_out_light_gains_only": float(np.mean([h.gains_only for r, _ in rows for h in r.holdout_light])),
            "held_out_patch": float(np.mean([h.rms_relative for r, _ in rows for h in r.holdout_patch])),
        }
    return out


def print_recovery(out, trials):
    """Target against measured."""
    print(f"planted M (the paper's), {trials} trials, patch means of {PIXELS} pixels")
    print("                                  target      plain   2 fluorescent patches")
    lines = (
        ("largest rmse of an entry", "largest_rmse", "noise", ".5f"),
        ("same, no patch left out", "largest_rmse_all_patches", "", ".5f"),
        ("68 % intervals cover", "coverage_68", ".60-.76", ".3f"),
        ("95 % intervals cover", "coverage_95", ".95", ".3f"),
        ("planted patches named", "named", "1", ".3f"),
        ("other patches named", "false_alarms", ".01", ".3f"),
        ("held-out light, rms relative", "held_out_light", "noise", ".4f"),
        ("same with gains only", "held_out_light_gains_only", "", ".4f"),
        ("held-out patch, rms relative", "held_out_patch", "noise", ".4f"),
    )
    for label, key, target, form in lines:
        print(f"  {label:30s} {target:>8s}   {out['plain'][key]:{form}}   {out['fluorescent'][key]:{form}}")


# %%
def published_reflectances(source):
    """How far the three published reflectance sets disagree, seen as errors of M.

    Responses are those of the measured radiances; predictions use the reflectance measured under one light for all
    three.  A perfect set of reflectances would give M = 1.
    """
    nm, qe, spectra = source
    folder = DATA / "pixel4a"
    booth = np.genfromtxt(folder / "lightbooth_illuminants.csv", delimiter=",", names=True)
    lights = np.array([np.interp(nm, booth["wavelength_nm"], booth[f"ill{n}"]) for n in LIGHTS])
    measured = exposed(nm, qe, spectra)
    scale = measured.sum(axis=(1, 2)) / predicted_responses(spectra, qe, wavelength_nm=nm).sum(axis=(1, 2))
    print("\npublished reflectances of the miniature chart, used under all three lights (M should be 1)")
    out = {}
    for name in LIGHTS:
        table = np.genfromtxt(folder / f"mcc_mini_reflectance_ill{name}.csv", delimiter=",", names=True)
        reflectance = np.array([np.interp(nm, table["wavelength_nm"], table[p]) for p in PATCHES])
        predicted = predicted_responses(lights[:, None] * reflectance, qe, wavelength_nm=nm) * scale[:, None, None]
        result = spectral_qe(measured, predicted, lights=LIGHTS, patches=PATCHES)
        out[name] = {"model_error": result.model_error, "outliers": result.outliers, "matrix": result.matrix.tolist()}
        print(f"  from light {name}: relative error {result.model_error:.3f}; named: {', '.join(result.outliers) or 'none'}")
        for row, sigma in zip(result.matrix, result.sigma, strict=True):
            print("     " + "   ".join(f"{v:6.3f} +- {s:.3f}" for v, s in zip(row, sigma, strict=True)))
    return out


# %%
def canon():
    """Chart, grey-row profile and a one-light matrix on the real frame."""
    path = DATA / "real" / "canon550d_colorchecker.dng"
    if not path.exists():
        print(f"\nno real chart: {path} is absent")
        return {}
    capture = read_dng(path)
    result = chart(capture)
    line = result.noise_lines["all"]
    print(f"\nCanon 550D frame: chart found, colours fit {result.confidence:.2f} (next direction {result.runner_up:.2f})")
    print(f"  mean-variance slope {line.slope_dn:.3f} +- {line.slope_sigma_dn:.3f} DN (README, 16 x 16 px: 1.87 to 1.95)")
    means, sigma = result.rgb
    print("  grey patch   R          G          B     (measured +- sigma / README)")
    for k in range(6):
        cells = [f"{means[18 + k, j]:7.1f} +- {sigma[18 + k, j]:.1f} / {CANON_GREYS[c][k]}" for j, c in enumerate("RGB")]
        print(f"  {19 + k:2d}    " + "   ".join(cells))
    centers = result.corners_px.mean(axis=1)
    pitch = float(np.hypot(*(centers[23] - centers[18])) / 5)
    parts = [(f"patch {19 + k}", pitch * (k + 0.75), pitch * (k + 1.25)) for k in range(6)]
    away = (centers[23] - centers[18]) / 5
    profile = line_profile(capture, tuple(centers[18] - away), tuple(centers[23] + away), width_px=pitch / 2, segments=parts)
    ratios = ", ".join(f"{s.ratio['G/R']:.3f} +- {s.ratio_sigma['G/R']:.3f}" for s in profile.segments)
    print(f"  line along the grey row, G/R: {ratios}")
    one_light = spectral_qe(means, linear_rgb(), sigma=np.hypot(sigma, 0.02 * means), patches=result.names)
    print(
        f"  one-light matrix from published sRGB: relative rms {one_light.rms_relative:.3f}, named {one_light.outliers or 'none'}"
    )
    return {"slope_dn": line.slope_dn, "slope_sigma_dn": line.slope_sigma_dn, "confidence": result.confidence}


def grey_rows():
    """The digitised grey-row profiles of the phone, put back on a mosaic and measured as a capture."""
    folder = DATA / "pixel4a" / "measured"
    if not folder.exists():
        return {}
    table = np.genfromtxt(folder / "interreflection_profiles.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    wanted = np.genfromtxt(folder / "interreflection_patches.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    print("\ndigitised grey rows as captures: G/R of patches 1..6 (black removed), ours / table")
    out = {}
    for name in dict.fromkeys(table["profile"]):
        part, rows = table[table["profile"] == name], wanted[wanted["profile"] == name]
        place = np.arange(part["position_um"].min(), part["position_um"].max(), 1.4)
        mosaic = np.zeros((8, place.size))
        for i, j, column in ((0, 0, "dv_r"), (0, 1, "dv_g"), (1, 0, "dv_g"), (1, 1, "dv_b")):
            there = np.isfinite(part[column])
            mosaic[i::2, j::2] = np.interp(place[j::2], part["position_um"][there], part[column][there])
        # tenths of a DN survive the rounding
        capture = Capture.from_array(np.rint(10 * mosaic), black_dn=640, white_dn=10230)
        parts = [(str(r["gray_patch"]), *((np.array([r["x0_um"], r["x1_um"]]) - place[0]) / 1.4)) for r in rows]
        ours = [s.ratio["G/R"] for s in line_profile(capture, box=(0, 8, 0, place.size), segments=parts).segments]
        table_ratio = rows["g_over_r_black_subtracted"]
        out[str(name)] = {"largest_difference": float(np.nanmax(np.abs(np.array(ours) - table_ratio)))}
        print(f"  {name:16s} " + "  ".join(f"{a:.3f}/{b:.3f}" for a, b in zip(ours, table_ratio, strict=True)))
    return out


# %%
def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description="Spectral QE, chart and line profiles: target against measured.")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    source = published()
    out = {"made up": recovery(args.trials, args.seed, None)}
    print("made-up smooth spectra")
    print_recovery(out["made up"], args.trials)
    if source is not None:
        out["published"] = recovery(args.trials, args.seed + 1, source)
        print("\npublished radiances and filters")
        print_recovery(out["published"], args.trials)
        out["reflectances"] = published_reflectances(source)
    out["canon"] = canon()
    out["grey rows"] = grey_rows()
    if args.json:
        args.json.write_text(json.dumps(out, indent=1) + "\n")
    if args.figure:
        from isetval.app.plots.color import qe_figure

        nm, qe, spectra = source or made_up(np.random.default_rng(args.seed))
        predicted = exposed(nm, qe, spectra)
        measured, sigma = noisy(np.random.default_rng(args.seed), predicted @ PAPER_M)
        plain = predicted_responses(spectra, qe, wavelength_nm=nm).max(axis=(1, 2))
        exposed_spectra = spectra * (800 / plain)[:, None, None]
        names = {"lights": LIGHTS, "patches": PATCHES}
        result = spectral_qe(measured, exposed_spectra, qe=qe, wavelength_nm=nm, sigma=sigma, **names)
        figure = qe_figure(result, nm, measured, predicted)
        for axis in figure.axes[:2]:
            axis.set_ylabel("simulated with the planted M (DN)")
        spectra_used = "published radiances and nominal QE" if source else "made-up spectra"
        figure.supxlabel(
            f"simulated patch means: {spectra_used} times the paper's M, "
            f"with shot and read noise of {PIXELS} pixels; no measurement",
            fontsize=8,
        )
        figure.savefig(args.figure)


if __name__ == "__main__":
    main()
