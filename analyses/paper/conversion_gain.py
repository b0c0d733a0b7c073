# %% [markdown]
# # Conversion gain: do the printed numbers agree with each other, and what is the right answer?
#
# The paper prints mean 320.7, variance 57.8 and a gain of .1677 DN/e-, "differing by only 1.8 %" from the maker's.
# Data: the printed numbers, and the histogram of the 1815 values (digitised).
# Error bar: the same captures simulated many times (15 frames of 11 x 11 pixels, pixels keep their response), same formula.
# Run time: half a minute.

# %%
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import isetval
from analyses.paper.common import MEASURED, OURS, PRINTED, Claim, Result, columns, csv_rows, laboratory, main, qe_file
from isetval.measure.noise.lyu2022 import single_level_gain

REPLICAS = 120
ROUNDING_DN2 = 1 / 12


# %% The printed numbers
def histogram(data: Path) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Bins, counts, mean and variance of the published histogram, DN above black."""
    bins, counts = columns(csv_rows(data / "measured" / "conversion_gain_histogram.csv"), "dv_above_black_bin_center", "count")
    mean = float(np.average(bins, weights=counts))
    return bins, counts, mean, float(np.average((bins - mean) ** 2, weights=counts))


def corrected_gain(mean_dn: float, variance_dn2: float, prnu: float, read_e: float) -> float:
    """Gain with read noise and rounding taken off as well: the read noise in DN is itself gain x electrons."""
    gain = single_level_gain(mean_dn, variance_dn2, prnu).value
    for _ in range(20):  # a contraction by 1/100 each time
        gain = single_level_gain(mean_dn, variance_dn2 - (gain * read_e) ** 2 - ROUNDING_DN2, prnu).value
    return float(gain)


# %% The error bar: the captures simulated again and again
def replicas(folder: Path, mean_dn: float) -> tuple[np.ndarray, isetval.CameraModel]:
    """Estimates from simulated captures with the maker's gain: by the published formula, and corrected, (replicas, 2)."""
    model = isetval.load_model(folder / "camera.toml")
    campaign = isetval.load_campaign(folder / "campaign.toml")
    (shot,) = campaign.shots
    black = model.sensor.black_dn[0][0]
    green = (slice(0, None, 2), slice(1, None, 2))
    level = float(model.expected(shot, lights=campaign.lights)[green].mean()) - black
    plan = replace(campaign, shots=(replace(shot, light_level=mean_dn / level),))
    prnu, read_e = model.value("prnu.sigma_percent") / 100, model.value("read_noise.sigma_e")
    out = []
    for seed in range(REPLICAS):
        frames = isetval.simulate(model, plan, seed=seed).captures[shot.name]
        values = np.array([frame.mosaic[green] for frame in frames], float) - black
        mean, variance = float(values.mean()), float(values.var())
        out.append((single_level_gain(mean, variance, prnu).value, corrected_gain(mean, variance, prnu, read_e)))
    return np.array(out), model


def run(data: Path, work: Path) -> Result:
    """The inconsistency, and the answer with its error bar."""
    folder = laboratory("conversion_gain", work)
    qe_file(data, folder / "qe.csv")
    said = PRINTED["conversion_gain"]
    prnu = said["prnu_percent"] / 100
    bins, counts, mean, variance = histogram(data)
    made, model = replicas(folder, mean)
    truth, read_e = model.value("conversion_gain.gain_dn_per_e"), model.value("read_noise.sigma_e")
    bias, scatter = (made / truth - 1).mean(axis=0), (made / truth).std(axis=0, ddof=1)
    from_text = single_level_gain(said["mean_dn"], said["variance_dn2"], prnu).value
    from_figure = single_level_gain(mean, said["variance_dn2"], prnu).value
    needed = _mean_for(said["gain_dn_per_e"], said["variance_dn2"], prnu)
    right = corrected_gain(mean, said["variance_dn2"], prnu, read_e) / (1 + bias[1])
    sigma = right * scatter[1]
    claims = (
        Claim(
            claim=f"gain {said['gain_dn_per_e']} DN/e- from mean {said['mean_dn']} and variance {said['variance_dn2']}",
            published=f"{said['gain_dn_per_e']:.4f}",
            measured=f"printed numbers give {from_text:.4f}; histogram's mean {mean:.1f} gives {from_figure:.4f}",
            ours=f"{right:.4f} +- {sigma:.4f} DN/e-",
            missing=f"the mean that gives the printed gain is {needed:.1f}, not {said['mean_dn']}; "
            "read noise and rounding were left in",
            sure=f"printed mean is stale: certain from the figure; histogram's own variance {variance:.1f} (some bins hidden)",
            numbers={"gain": right, "sigma": sigma, "from_text": from_text, "from_figure": from_figure},
        ),
        Claim(
            claim="differs from the maker's value by only 1.8 %",
            published=f"{100 * (1 - said['gain_dn_per_e'] / said['maker_dn_per_e']):.1f} %",
            measured="-",
            ours=f"{100 * (right / said['maker_dn_per_e'] - 1):+.1f} +- {100 * sigma / said['maker_dn_per_e']:.1f} %",
            missing="an error bar",
            sure=f"{REPLICAS} simulated repetitions scatter by {100 * scatter[0]:.1f} %; the published formula reads "
            f"{100 * bias[0]:+.1f} +- {100 * scatter[0] / np.sqrt(REPLICAS):.1f} %, the corrected one {100 * bias[1]:+.1f} %",
            target="agrees with the maker's value within two sigmas",
            met=abs(right - said["maker_dn_per_e"]) < 2 * sigma,
            numbers={"scatter_percent": 100 * float(scatter[0]), "bias_percent": 100 * float(bias[0])},
        ),
    )
    return Result(
        key="conversion_gain",
        title="Conversion gain",
        claims=claims,
        figure=drawn(bins, counts, mean, said, made * right / truth),
        caption="Left: the 1815 values of the sphere, measured (digitised histogram), with the printed mean and its own. "
        "Right: gains from simulated repetitions of the same captures, and the printed values.",
    )


def _mean_for(gain: float, variance: float, prnu: float) -> float:
    """The mean at which the published formula gives a gain: V = m^2 s^2 + K m (1 + s^2)."""
    b = gain * (1 + prnu**2)
    return float((-b + np.sqrt(b * b + 4 * prnu**2 * variance)) / (2 * prnu**2))


# %% The paper's figure beside ours
def drawn(bins: np.ndarray, counts: np.ndarray, mean: float, said: dict, made: np.ndarray):
    """Histogram of values, histogram of gains."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.bar(bins, counts, width=np.diff(bins).mean(), color=MEASURED, alpha=0.7, label="measured")
    left.axvline(said["mean_dn"], color="tab:orange", label=f"printed mean {said['mean_dn']}")
    left.axvline(mean, color=OURS, label=f"mean of the histogram {mean:.1f}")
    left.set(xlabel="DN above black", ylabel="pixels", ylim=(0, 1.35 * counts.max()))
    left.legend(frameon=False, fontsize=8)
    right.hist(made[:, 1], bins=16, color="0.6", label="ours: simulated repetitions, corrected formula")
    right.axvline(said["gain_dn_per_e"], color="tab:red", label=f"printed {said['gain_dn_per_e']}")
    right.axvline(said["maker_dn_per_e"], color=OURS, ls="--", label=f"maker {said['maker_dn_per_e']}")
    right.set(xlabel="conversion gain / (DN/e-)", ylabel="repetitions", ylim=(0, 1.6 * np.histogram(made[:, 1], 16)[0].max()))
    right.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    main(run, "Conversion gain: printed, histogram, ours.")
