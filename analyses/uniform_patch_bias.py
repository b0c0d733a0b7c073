# %% [markdown]
# # What the choice of "uniform" patches does to the noise they report
#
# Question: the paper accepts 10 x 10 patches by three Poisson sd and a hold-out test on the same values whose spread it
# then plots. How much does that selection bias the noise, level by level and in a scene with texture, and does a second
# frame settle it?
# Data: simulated flats and mixed scenes (the paper's sensor numbers); real input where `../shared/data` is there: one
# frame of a Canon 550D, and the published envelope of the Pixel 4a's noise.
# Result: pass rates, bias of the accepted standard deviation, conversion gain from mixed scenes;
# `reports/uniform_patch_bias.json` and `.png`.
# Run time: half a minute.

# %%
from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

import isetval
from isetval.app.plots.noise import bias_figure
from isetval.measure import uniform_patches

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"
GAIN, READ_E, BLACK = 0.1707, 2.954, 64
LEVELS_E = (5, 20, 50, 100, 300, 1000, 4000)
SEED = 2026


# %%
def frames(rng: np.random.Generator, electrons: np.ndarray, count: int) -> list[Any]:
    """Frames of a scene given in electrons a pixel, (rows, cols)."""
    out = []
    for _ in range(count):
        charge = rng.poisson(electrons) + READ_E * rng.standard_normal(electrons.shape)
        codes = np.clip(np.round(GAIN * charge + BLACK), 0, 1023).astype(np.uint16)
        out.append(isetval.Capture.from_array(codes, cfa="RGGB", black_dn=BLACK))
    return out


def true_sd(electrons: float) -> float:
    return math.sqrt(GAIN**2 * (electrons + READ_E**2) + 1 / 12)


def flats(side: int = 1000) -> list[dict[str, float]]:
    """Pass rate and bias of both methods at each level."""
    rows = []
    for electrons in LEVELS_E:
        pair = frames(np.random.default_rng([SEED, electrons]), np.full((side, side), float(electrons)), 2)
        row: dict[str, float] = {"electrons": electrons}
        old = uniform_patches(pair[:1], method="lyu2022", gain_dn_per_e=GAIN, seed=SEED)
        new = uniform_patches(pair, channel="G")
        for name, table, field in (("lyu2022", old, "spatial_std_dn"), ("two_frame", new, "temporal_std_dn")):
            squares = np.array([getattr(p, field) ** 2 for p in table.accepted] or [math.nan])
            row[f"{name}_pass"] = table.pass_rate()
            row[f"{name}_bias_percent"] = 100 * (math.sqrt(squares.mean()) / true_sd(electrons) - 1)
            row[f"{name}_bias_error_percent"] = 100 * squares.std() / squares.mean() / 2 / math.sqrt(squares.size)
        row["lyu2022_outlier_pass"] = 1 - sum(p.reason == "outlier" for p in old.patches) / len(old)
        rows.append(row)
    return rows


# %% Mixed scenes: tiles of flat, ramp, edge and fine texture
def mixed_scene(rng: np.random.Generator, uneven: float, tiles: int = 50, size: int = 20) -> np.ndarray:
    scene = np.empty((tiles * size, tiles * size))
    y, x = np.mgrid[0:size, 0:size] / size - 0.5
    for i in range(tiles):
        for j in range(tiles):
            level = math.exp(rng.uniform(math.log(50), math.log(4500)))
            tile = np.ones((size, size))
            if rng.random() < uneven:
                angle = rng.uniform(0, 2 * math.pi)
                along = x * math.cos(angle) + y * math.sin(angle)
                kind = rng.integers(3)
                tile += (rng.uniform(0.05, 0.4) * along, 0.3 * np.sign(along), 0.1 * rng.standard_normal((size, size)))[kind]
            scene[i * size : (i + 1) * size, j * size : (j + 1) * size] = level * tile
    return scene


def gain_of(mean: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Weighted line of variance against mean, weights from the model; K and its sigma without the common factor."""
    model = np.maximum(GAIN * mean + GAIN**2 * READ_E**2, 0.1)
    design = np.stack([np.ones_like(mean), mean], axis=1) / model[:, None]
    inverse = np.linalg.inv(design.T @ design)
    return float((inverse @ design.T @ (variance / model))[1]), float(math.sqrt(inverse[1, 1]) * math.sqrt(2 / 48))


def mixed() -> list[dict[str, float]]:
    rows = []
    for uneven in (0.0, 0.35, 0.7):
        rng = np.random.default_rng([SEED, int(100 * uneven)])
        pair = frames(rng, mixed_scene(rng, uneven), 2)
        row: dict[str, float] = {"uneven_share": uneven}
        old = uniform_patches(pair[:1], method="lyu2022", gain_dn_per_e=GAIN, count=3000, seed=SEED)
        new = uniform_patches(pair, channel="G", count=3000, seed=SEED)
        for name, table, field in (("lyu2022", old, "spatial_std_dn"), ("two_frame", new, "temporal_std_dn")):
            mean = np.array([p.mean_dn for p in table.accepted])
            gain, sigma = gain_of(mean, np.array([getattr(p, field) ** 2 for p in table.accepted]))
            row |= {f"{name}_gain_bias_percent": 100 * (gain / GAIN - 1), f"{name}_gain_sigma_percent": 100 * sigma / GAIN,
                    f"{name}_pass": table.pass_rate()}  # fmt: skip
        rows.append(row)
    return rows


# %% Real input
def real_picture() -> dict[str, float] | None:
    path = SHARED / "real" / "canon550d_colorchecker.dng"
    if not path.exists():
        return None
    capture = isetval.read_dng(path)
    table = uniform_patches(capture, method="lyu2022", gain_dn_per_e=1.9, count=2000, seed=SEED)
    mean = np.array([p.mean_dn for p in table.accepted])
    variance = np.array([p.spatial_std_dn**2 for p in table.accepted])
    reasons = [p.reason for p in table.patches]
    return {"patches": len(table), "pass_rate": table.pass_rate(), "outlier": reasons.count("outlier"),
            "not_uniform": reasons.count("not_uniform"), "slope_dn": float(np.polyfit(mean, variance, 1)[0])}  # fmt: skip


def published_envelope() -> list[dict[str, float]] | None:
    """Noise model of the paper's sensor table against the digitized measured envelope (black level included there)."""
    path = SHARED / "pixel4a" / "measured" / "noise_std_vs_mean_envelope.csv"
    if not path.exists():
        return None
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    measured = [row for row in rows if row["series"] == "measured"]
    out = []
    for row in measured:
        signal = float(row["mean_dv"]) - BLACK
        model = math.sqrt(GAIN * signal + GAIN**2 * READ_E**2 + 1 / 12 + (0.0054 * signal) ** 2)
        out.append({"mean_dv": float(row["mean_dv"]), "measured_std": float(row["std_mid"]), "model_std": round(model, 2)})
    return out


# %%
def main() -> None:
    flat_rows, mixed_rows = flats(), mixed()
    print("flat: share accepted, bias of the accepted sd (target: two frames within .5 %)")
    for r in flat_rows:
        print(f"{r['electrons']:6.0f} e-  lyu2022 {r['lyu2022_pass']:.2f} (outlier step {r['lyu2022_outlier_pass']:.2f}) "
              f"{r['lyu2022_bias_percent']:+.2f} +- {r['lyu2022_bias_error_percent']:.2f} % two frames {r['two_frame_pass']:.1f} "
              f"{r['two_frame_bias_percent']:+.2f} +- {r['two_frame_bias_error_percent']:.2f} %")  # fmt: skip
    print("mixed scenes: gain from patches (target: two frames within 1 %)")
    for r in mixed_rows:
        print(f"{r['uneven_share']:.0%} uneven  lyu2022 {r['lyu2022_gain_bias_percent']:+.2f} (pass {r['lyu2022_pass']:.2f})   "
              f"two frames {r['two_frame_gain_bias_percent']:+.2f} +- {r['two_frame_gain_sigma_percent']:.2f} %")  # fmt: skip
    real: dict[str, Any] = {"canon 550D": real_picture(), "pixel 4a envelope": published_envelope()}
    print(json.dumps(real["canon 550D"]))
    for point in real["pixel 4a envelope"] or []:
        print(
            f"pixel 4a, {point['mean_dv']:.0f} DV: measured sd {point['measured_std']:.2f} +- .25, model {point['model_std']:.2f}"
        )
    out = ROOT / "reports"
    out.mkdir(exist_ok=True)
    (out / "uniform_patch_bias.json").write_text(json.dumps({"seed": SEED, "flat": flat_rows, "mixed": mixed_rows}, indent=1))
    names = ("lyu2022", "two_frame")
    figure = bias_figure(
        LEVELS_E,
        {n: [r[f"{n}_pass"] for r in flat_rows] for n in names},
        {n: [r[f"{n}_bias_percent"] / 100 for r in flat_rows] for n in names},
    )
    figure.supxlabel("simulated patches with a known standard deviation (analyses/uniform_patch_bias.py)", fontsize=8)
    figure.savefig(out / "uniform_patch_bias.png", dpi=110)


if __name__ == "__main__":
    main()
