# %% [markdown]
# # Photon transfer and dark signal: how near to the statistical limit, and are the error bars true?
#
# Question: what are bias, rmse and coverage of conversion gain, read noise, DSNU and PRNU under the disturbances of a
# real laboratory, against the Cramer-Rao bound and against the EMVA 1288 way (unweighted line through zero)?
# Data: simulated frames of a camera with the paper's sensor numbers (K .1707 DN/e-, read noise 2.954 e-, DSNU .497 e-,
# PRNU .54 %, black 64); real input from `../shared/data/real` where it is there: a raw dark frame, and a Canon
# 550D picture of a chart, whose even and odd columns stand in for two frames.
# Result: target and measured side by side; `reports/photon_transfer.json` and `.png`.
# Run time: some minutes with the default 300 trials of 16 levels.  `--coverage 2000` instead counts how often the 68 and
# 95 % intervals hold the truth, on 48 x 48 pixels, in each case: about half an hour on one core, written with its date to
# `data/stored/sensor_coverage.json`.

# %%
from __future__ import annotations

import argparse
import datetime
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

import isetval
from isetval.measure import dark, emva1288, photon_transfer, quality
from isetval.measure.noise.lyu2022 import single_level_gain

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "data" / "real"
GAIN, READ_E, DSNU_E, PRNU, BLACK = 0.1707, 2.954, 0.497, 0.0054, 64.0
LEVELS = np.geomspace(20, 5000, 16)


# %% A camera with planted truth
class Specimen:
    """One sensor: fixed offsets and responses; frames of an even field."""

    def __init__(self, rng: np.random.Generator, shape: tuple[int, int], **changes: Any) -> None:
        self.rng, self.shape = rng, shape
        self.gain, self.read_e, self.black = GAIN, READ_E, BLACK
        self.bend = self.repulsion = 0.0
        self.__dict__.update(changes)
        self.offset = DSNU_E * rng.standard_normal(shape)
        self.response = 1 + PRNU * rng.standard_normal(shape)

    def frames(self, electrons: float, count: int, *, time_s: float | None = None, drift=0.0, flicker=0.0, shade=1.0):
        """``count`` captures; drift: sd of the lamp from frame to frame, flicker: rms of the rows."""
        out = []
        for _ in range(count):
            lamp = 1 + drift * self.rng.standard_normal()
            wave = 1 + math.sqrt(2) * flicker * np.sin(0.2 * np.arange(self.shape[0]) + self.rng.uniform(0, 2 * math.pi))
            mu = np.broadcast_to(electrons * shade * lamp * wave[:, None] * self.response, self.shape)
            if self.repulsion:
                charge = mu + np.sqrt(mu * (1 - self.repulsion * mu)) * self.rng.standard_normal(self.shape)
            else:
                charge = self.rng.poisson(mu) + self.offset
            charge = charge * (1 - self.bend * charge / 6000) + self.read_e * self.rng.standard_normal(self.shape)
            codes = np.clip(np.round(self.gain * charge + self.black), 0, 1023).astype(np.uint16)
            out.append(isetval.Capture.from_array(codes, cfa="MONO", black_dn=self.black, white_dn=1023, time_s=time_s))
        return out


def line_bound(pixels: int, *, bend: bool = False) -> float:
    """Relative Cramer-Rao bound of K: a straight line (or a parabola) through 16 pair variances and one dark pair."""
    mean = np.concatenate([[0.0], GAIN * LEVELS])
    variance = GAIN**2 * READ_E**2 + 1 / 12 + GAIN * mean
    powers = [mean**k for k in range(3 if bend else 2)]
    design = np.stack(powers, axis=1) / (variance * math.sqrt(2 / pixels))[:, None]
    scale = np.abs(design).max(axis=0)
    return float(np.sqrt(np.linalg.inv((design / scale).T @ (design / scale))[1, 1]) / scale[1] / GAIN)


def emva_gain(captures: list[Any]) -> float:
    """The standard's way: pair variances with means subtracted, unweighted line through zero up to 70 % of saturation."""
    mean, variance = [], []
    for a, b in zip(captures[::2], captures[1::2], strict=True):
        x, y = a.mosaic.astype(float), b.mosaic.astype(float)
        mean.append((x.mean() + y.mean()) / 2)
        variance.append(np.mean((x - y) ** 2) / 2 - (x.mean() - y.mean()) ** 2 / 2)
    m, v = np.array(mean) - mean[0], np.array(variance) - variance[0]
    keep = m <= 0.7 * max(m)
    return float(m[keep] @ v[keep] / (m[keep] @ m[keep]))


# %% Series of sixteen levels, one pair each
CASES: dict[str, tuple[dict[str, float], dict[str, float], float]] = {
    "ideal": ({}, {}, 0.37),
    "non-linearity 5 %": ({"bend": 0.05}, {}, 0.5),
    "brighter-fatter 2e-6": ({"repulsion": 2e-6}, {}, 0.5),
    "rolling flicker 1 %": ({}, {"flicker": 0.01}, 0.5),
    "drift 1 %": ({}, {"drift": 0.01}, 0.5),
}
LOW = "low light, 2 to 200 e-"
COVERED = {**CASES, LOW: ({}, {}, math.nan)}


def series_trials(name: str, trials: int, size: int, seed: int) -> dict[str, list[float]]:
    """Relative errors and sigmas of K, read noise and PRNU, and errors of the standard's way, trial by trial."""
    changes, light, _ = COVERED[name]
    levels = np.geomspace(2, 200, 16) if name == LOW else LEVELS
    rng = np.random.default_rng([seed, list(COVERED).index(name)])
    out: dict[str, list[float]] = {key: [] for key in ("K", "K sigma", "read", "read sigma", "PRNU", "PRNU sigma", "EMVA way")}
    for _ in range(trials):
        camera = Specimen(rng, (size, size), **changes)
        captures = camera.frames(0.0, 2, time_s=1e-5)
        for electrons in levels:
            captures += camera.frames(electrons, 2, time_s=electrons * 2e-5, **light)
        found = photon_transfer(captures)["MONO"]
        for key, quantity, truth in (
            ("K", found.gain_dn_per_e, GAIN),
            ("read", found.read_noise_e, READ_E),
            ("PRNU", found.prnu, 100 * PRNU),
        ):
            out[key].append(quantity.value / truth - 1)
            out[f"{key} sigma"].append(quantity.total_sigma / truth)
        out["EMVA way"].append(emva_gain(captures) / GAIN - 1)
    return out


def series_row(name: str, trials: int, size: int, seed: int) -> dict[str, Any]:
    """Bias, rmse, ratio to the bound and coverage of one case."""
    found = series_trials(name, trials, size, seed)
    row = scores(f"K, 16 levels x 1 pair, {size}x{size}, {name}", found["K"], found["K sigma"], CASES[name][2])
    bound = line_bound(size * size)
    return {**row, "over_bound": rms(found["K"]) / bound, "bound_percent": 100 * bound,
            "quadratic_bound_percent": 100 * line_bound(size * size, bend=True),
            "emva_way_rmse_percent": 100 * rms(found["EMVA way"])}  # fmt: skip


def coverage(trials: int, seed: int, size: int = 48, cases: list[str] | None = None) -> list[dict[str, Any]]:
    """Share of intervals that hold the truth, and how many binomial sd that is from the share they should hold."""
    rows = []
    for name in cases or COVERED:
        found = series_trials(name, trials, size, seed)
        for key in ("K", "read", "PRNU"):
            if name == LOW and key == "PRNU":
                continue  # at 200 e- nothing of half a percent is seen
            pull = np.abs(found[key]) / np.array(found[f"{key} sigma"])
            row: dict[str, Any] = {"case": name, "quantity": key, "n": trials, "size": size,
                                   "rmse_percent": 100 * rms(found[key]),
                                   "bias_percent": 100 * float(np.mean(found[key])),
                                   "sigma_percent": 100 * float(np.mean(found[f"{key} sigma"]))}  # fmt: skip
            for share, limit in ((0.6827, 1.0), (0.95, 1.96)):
                there = float(np.mean(pull < limit))
                row[f"within_{round(100 * share)}"] = there
                row[f"off_{round(100 * share)}_sd"] = (there - share) / math.sqrt(share * (1 - share) / trials)
            rows.append(row)
            print(
                f"{name:24s} {key:5s} {trials:5d}  rmse {row['rmse_percent']:.3f}  sigma {row['sigma_percent']:.3f}  bias "
                f"{row['bias_percent']:+.3f} %  68 %: {row['within_68']:.3f} ({row['off_68_sd']:+.1f} sd)  "
                f"95 %: {row['within_95']:.3f} ({row['off_95_sd']:+.1f} sd)",
                flush=True,
            )
    return rows


def store_coverage(rows: list[dict[str, Any]], seed: int) -> None:
    """Put the rows, dated, in place of those of the same cases."""
    path = ROOT / "data" / "stored" / "sensor_coverage.json"
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    before = json.loads(path.read_text())["rows"] if path.exists() else []
    kept = [row for row in before if row["case"] not in {new["case"] for new in rows}]
    note = "analyses/photon_transfer.py --coverage: share of intervals that hold the planted value; simulated frames, own work"
    dated = [{**row, "date": today, "seed": seed} for row in rows]
    path.write_text(json.dumps({"note": note, "rows": kept + dated}, indent=1) + "\n")


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def scores(name: str, errors: list[float], sigmas: list[float], target: float) -> dict[str, Any]:
    """A row of the table, in percent."""
    pull = np.abs(errors) / np.array(sigmas)
    return {
        "case": name, "n": len(errors), "target_rmse_percent": target, "rmse_percent": 100 * rms(errors),
        "bias_percent": 100 * float(np.mean(errors)), "bias_error_percent": 100 * float(np.std(errors)) / math.sqrt(len(errors)),
        "sigma_percent": 100 * float(np.mean(sigmas)),
        "within_68": float(np.mean(pull < 1)), "within_95": float(np.mean(pull < 1.96)),
    }  # fmt: skip


# %% One level, dark signal, PRNU, the public reference conditions
def one_level(trials: int, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 100])
    errors, sigmas = [], []
    for _ in range(trials):
        camera = Specimen(rng, (64, 64))
        captures = camera.frames(0.0, 15, time_s=1e-5) + camera.frames(320.7 / GAIN, 15, time_s=0.1, drift=0.01)
        found = photon_transfer(captures)["MONO"].gain_dn_per_e
        errors.append(found.value / GAIN - 1)
        sigmas.append(found.sigma / GAIN)
    row = scores("K, one level, 64x64, 15 frames, 1 % drift", errors, sigmas, 0.7)
    bound = math.sqrt(2 / (64 * 64 * 14)) * (1 + (GAIN**2 * READ_E**2 + 1 / 12) / (GAIN * 320.7))
    return {**row, "over_bound": rms(errors) / bound}


def dark_rows(trials: int, seed: int) -> list[dict[str, Any]]:
    rows = []
    for read_e, target in ((2.954, 0.5), (1.96, 1.0)):
        for fraction in (0.0, 0.25, 0.5):
            rng = np.random.default_rng([seed, 200, int(100 * read_e), int(100 * fraction)])
            read, dsnu = [], []
            for _ in range(trials):
                camera = Specimen(rng, (128, 128), read_e=read_e, black=BLACK + fraction)
                found = dark(camera.frames(0.0, 16))["MONO"]
                read.append((found.read_noise_dn.value / GAIN / read_e - 1, found.read_noise_dn.sigma / GAIN / read_e))
                dsnu.append((found.dsnu_dn.value / GAIN / DSNU_E - 1, found.dsnu_dn.total_sigma / GAIN / DSNU_E))
            place = f"{read_e * GAIN:.2f} DN, black x{fraction:.2f}, 16 frames 128x128"
            rows.append(scores(f"read noise at {place}", *map(list, zip(*read, strict=True)), target))
            rows.append(scores(f"DSNU at {place}", *map(list, zip(*dsnu, strict=True)), 3.0))
    return rows


def prnu_rows(trials: int, seed: int) -> list[dict[str, Any]]:
    y, x = np.mgrid[-1:1:128j, -1:1:128j]
    rows = []
    for name, shade in (("even light", 1.0), ("30 % fall-off", 1 - 0.3 * (x**2 + y**2) / 2)):
        rng = np.random.default_rng([seed, 300])
        pairs = []
        for _ in range(trials):
            camera = Specimen(rng, (128, 128))
            captures = camera.frames(0.0, 16, time_s=1e-5) + camera.frames(2800.0, 16, time_s=0.05, shade=shade)
            found = photon_transfer(captures)["MONO"].prnu
            pairs.append((found.value / 100 / PRNU - 1, found.total_sigma / 100 / PRNU))
        rows.append(scores(f"PRNU, 16 frames 128x128 at 2800 e-, {name}", *map(list, zip(*pairs, strict=True)), 1.5))
    return rows


def reference_conditions(trials: int, seed: int) -> list[dict[str, Any]]:
    """EMVA set 003: 640 x 480, 12 bit, K .1, 30 e-, 2 % cubic bend, 50 steps of one pair."""
    rng = np.random.default_rng([seed, 400])
    shape = (480, 640)
    gain, noise = [], []
    for _ in range(trials):
        offset, response = 22 * rng.standard_normal(shape), 1 + 0.005 * rng.standard_normal(shape)
        captures = []
        for step in range(51):
            for _ in range(2):
                charge = rng.poisson(42000 * step / 50 * response) + offset + 30 * rng.standard_normal(shape)
                charge *= 1 - 0.02 * (charge / 42000) ** 2
                codes = np.clip(np.round(0.1 * charge + 32.4), 0, 4095).astype(np.uint16)
                captures.append(
                    isetval.Capture.from_array(codes, cfa="MONO", black_dn=32, white_dn=4095, time_s=1e-6 + step * 1e-3)
                )
        found = photon_transfer(captures)["MONO"]
        gain.append((found.gain_dn_per_e.value / 0.1 - 1, found.gain_dn_per_e.sigma / 0.1))
        noise.append((found.read_noise_e.value / 30 - 1, found.read_noise_e.sigma / 30))
    return [
        scores("K, EMVA set 003 conditions", *map(list, zip(*gain, strict=True)), 0.3),
        scores("dark noise, EMVA set 003 conditions", *map(list, zip(*noise, strict=True)), 0.5),
    ]


def published() -> dict[str, Any]:
    """The paper's single-level estimator on the numbers it prints: 15 frames of 10 x 10 pixels, 320.7 DN, 57.8 DN^2, .54 %."""
    found = single_level_gain(320.7, 57.8, PRNU, values=1500)
    return {"formula_dn_per_e": found.value, "sampling_sigma_dn_per_e": found.sigma, "printed_dn_per_e": 0.1677,
            "data_sheet_dn_per_e": GAIN, "printed_minus_data_sheet_sigmas": (0.1677 - GAIN) / found.sigma}  # fmt: skip


# %% Real input, through the same functions
def real_dark() -> dict[str, Any] | None:
    path = REAL / "dark_1920x1080_bggr_u16le.raw"
    if not path.exists():
        return None
    codes = np.fromfile(path, dtype="<u2").reshape(1080, 1920)
    capture = isetval.Capture.from_array(codes, cfa="BGGR", black_dn=0, white_dn=4095)
    verdict = quality(capture)
    inside = (2, 1080, 0, 1918)
    found = dark([capture], inside)["Gr"]
    return {"verdict": verdict.verdict, "reasons": list(verdict.reasons), "mean_dn_gr": found.black_level_dn.value,
            "hot_pixels_gr": found.hot_pixels, "flags": list(found.flags)}  # fmt: skip


def real_chart() -> dict[str, Any] | None:
    """Canon 550D: even blocks of the picture sorted into levels; even and odd columns are the two frames."""
    path = REAL / "canon550d_colorchecker.dng"
    if not path.exists():
        return None
    capture = isetval.read_dng(path)
    out: dict[str, Any] = {"quality": list(quality(capture).reasons)}
    for plane, (row, col) in {"R": (0, 0), "Gr": (0, 1), "Gb": (1, 0), "B": (1, 1)}.items():
        black = capture.sensor.black_dn[row][col]
        found = photon_transfer(pseudo_pairs(capture.mosaic[row::2, col::2], black))["MONO"]
        k = found.gain_dn_per_e
        out[plane] = {
            "gain_dn_per_e": k.value,
            "sigma": k.sigma,
            "levels": len(found.levels),
            "chi2": found.chi2,
            "dof": found.dof,
            "flags": list(found.flags),
            "left_out": [f"{level.mean_dn:.0f} DN: {level.reason}" for level in found.levels if not level.used],
        }
    return out


def pseudo_pairs(plane: np.ndarray, black: float, *, side: int = 16, blocks: int = 4) -> list[Any]:
    """Levels of ``blocks`` even blocks each, means within 8 %; frames are their even and odd columns."""
    rows, cols = (n // side for n in plane.shape)
    tiles = (
        plane[: rows * side, : cols * side].reshape(rows, side, cols, side).swapaxes(1, 2).reshape(-1, side, side).astype(float)
    )
    mean = tiles.mean(axis=(1, 2)) - black
    noise = np.mean(np.diff(tiles, axis=2) ** 2, axis=(1, 2)) / 2
    coarse = tiles.reshape(-1, 4, side // 4, 4, side // 4).mean(axis=(2, 4)).var(axis=(1, 2))
    # block means scatter as white noise does (15 degrees of freedom, 2.8 sd): no texture, no slope
    even = np.flatnonzero((coarse < 2.0 * noise / (side // 4) ** 2) & (mean > 20))
    order = even[np.argsort(mean[even])]
    captures, last = [], 0.0
    for i in range(order.size - blocks + 1):
        near = order[i : i + blocks]
        if mean[near[0]] > 1.15 * last and mean[near[-1]] < 1.08 * mean[near[0]]:
            pair = np.concatenate([tiles[j] for j in near])
            for half in (pair[:, 0::2], pair[:, 1::2]):
                captures.append(isetval.Capture.from_array(half.astype(np.uint16), cfa="MONO", black_dn=black, white_dn=15000))
            last = mean[near[-1]]
    return captures


# %%
def table(rows: list[dict[str, Any]]) -> str:
    head = f"{'case':58s} {'n':>5s} {'target':>7s} {'rmse %':>7s} {'bias %':>15s} {'sigma %':>8s} "
    lines = [head + f"{'68 %':>6s} {'95 %':>6s} {'/bound':>7s} {'EMVA way':>9s}"]
    for r in rows:
        bias = f"{r['bias_percent']:+.3f} +- {r['bias_error_percent']:.3f}"
        bound = f"{r['over_bound']:.2f}" if "over_bound" in r else ""
        other = f"{r['emva_way_rmse_percent']:.2f}" if "emva_way_rmse_percent" in r else ""
        lines.append(
            f"{r['case']:58s} {r['n']:5d} {r['target_rmse_percent']:7.2f} {r['rmse_percent']:7.3f} {bias:>15s} "
            f"{r['sigma_percent']:8.3f} {r['within_68']:6.3f} {r['within_95']:6.3f} {bound:>7s} {other:>9s}"
        )
    return "\n".join(lines)


def figure(path: Path, seed: int) -> None:
    """Curve, residuals and fixed pattern of one simulated series."""
    from isetval.app.plots.noise import transfer_figure

    rng = np.random.default_rng([seed, 500])
    bend = 0.05  # of the charge at 6000 e-
    camera = Specimen(rng, (128, 128), bend=bend)
    captures = camera.frames(0.0, 2, time_s=1e-5)
    for electrons in LEVELS:
        captures += camera.frames(electrons, 2, time_s=electrons * 2e-5)
    result = photon_transfer(captures)
    drawn = transfer_figure(result)
    drawn.supxlabel(
        f"simulated sensor, 128 x 128 pixels, 2 frames a level; K {GAIN} DN/e$^-$, PRNU {100 * PRNU:.2f} %, and a planted "
        f"non-linearity: x (1 - {bend:g} x / 6000 e$^-$), which bends the last levels below the straight line",
        fontsize=8,
    )
    drawn.savefig(path, dpi=110)
    print(emva1288(captures).to_frame().to_string(index=False))


def main() -> None:
    parser = argparse.ArgumentParser(description="photon transfer: target against measured")
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--coverage", type=int, metavar="TRIALS", help="only the coverage of intervals, with so many trials")
    parser.add_argument("--cases", nargs="*", choices=list(COVERED), help="only these cases of the coverage")
    parser.add_argument("--name", default="photon_transfer", help="name of the files in reports/")
    options = parser.parse_args()
    start = time.perf_counter()
    if options.coverage:
        rows = coverage(options.coverage, options.seed, cases=options.cases)
        store_coverage(rows, options.seed)
        print(f"{time.perf_counter() - start:.0f} s")
        return
    few = max(options.trials // 10, 3)
    rows = [series_row(name, options.trials, options.size, options.seed) for name in CASES]
    rows += [one_level(options.trials, options.seed), *dark_rows(few, options.seed), *prnu_rows(few, options.seed)]
    rows += reference_conditions(max(few // 3, 2), options.seed)
    print(table(rows))
    print(f"the paper's single-level estimator: {json.dumps(published())}")
    real = {"raw dark frame": real_dark(), "canon 550D": real_chart()}
    print(json.dumps(real, indent=1))
    out = ROOT / "reports"
    out.mkdir(exist_ok=True)
    (out / f"{options.name}.json").write_text(
        json.dumps({"seed": options.seed, "rows": rows, "published": published(), "real": real}, indent=1)
    )
    figure(out / f"{options.name}.png", options.seed)
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
