# %% [markdown]
# # Sensor noise against level: 500 uniform patches, and can the data tell a DSNU of .038 mV from one of .38 mV?
#
# The paper selects patches by a rule that rejects what scatters more than shot noise, on both sides, and finds both clouds alike.
# Here the rule is part of the measurement (`method = "lyu2022"`) and its bias is shown beside a rule without one.
# Data: envelope of the measured and of the published simulated cloud (digitised, +-.25 DN); sensor numbers of table and code.
# Run time: half a minute.

# %%
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import isetval
from analyses.paper.common import (
    MEASURED,
    OURS,
    PUBLISHED,
    Claim,
    Result,
    columns,
    csv_rows,
    laboratory,
    main,
    qe_file,
    write_rows,
)

READING_DN = 0.25  # README of the data: +- of a standard deviation read off the figure
GREENS = 50  # values of a patch
SEED = 2022


# %% The campaign: the middle of the measured cloud
def envelope(data: Path, series: str) -> tuple[np.ndarray, ...]:
    """Mean with black, lower and upper edge and middle of a cloud, DN."""
    rows = [r for r in csv_rows(data / "measured" / "noise_std_vs_mean_envelope.csv") if r["series"] == series]
    return columns(rows, "mean_dv", "std_lower_edge", "std_upper_edge", "std_mid")


def prepared(data: Path, work: Path) -> Path:
    """The folder with the campaign, its curve and the camera.

    The middle of a cloud is half of its two most extreme patches: their own scatter, std / sqrt(2 x 49), is that of the middle
    to within a third, and the reading of two edges adds to it.
    """
    folder = laboratory("noise", work)
    mean, _, _, middle = envelope(data, "measured")
    sigma = np.hypot(middle / np.sqrt(2 * (GREENS - 1)) / np.sqrt(2), READING_DN / np.sqrt(2))
    black = isetval.load_model(folder_with_qe(data, folder) / "camera.toml").sensor.black_dn[0][0]
    rows = zip(mean - black, middle, sigma, strict=True)
    write_rows(folder / "noise.csv", ("level_dn", "std", "sigma"), rows)
    return folder


def folder_with_qe(data: Path, folder: Path) -> Path:
    """The folder, with the quantum efficiency that its camera names."""
    qe_file(data, folder / "qe.csv")
    return folder


# %% Both DSNUs, both rules, and 500 patches of our own
def run(data: Path, work: Path) -> Result:
    """Compare both sensor tables with the measured cloud."""
    folder = prepared(data, work)
    campaign = isetval.load_campaign(folder / "campaign.toml")
    table = isetval.load_model(folder / "camera.toml")
    numbers = json.loads((data / "sensor_parameters.json").read_text())["derived"]
    code = replace(table.with_values({"dsnu.sigma_e": numbers["dsnu_e_code"]}), name="code")
    both = isetval.compare([table, code], campaign)
    mean, low, high, _ = envelope(data, "measured")
    ours = both.table[both.table["model"] == "table"]["simulated"].to_numpy(float)
    row_z = both.table[both.table["model"] == "table"]["z"].to_numpy(float)
    z2 = {m: float(np.sum(both.table[both.table["model"] == m]["z"].to_numpy(float) ** 2)) for m in ("table", "code")}
    inside = (ours >= low - READING_DN) & (ours <= high + READING_DN)
    kept = replace(campaign, nuisances=())
    unbiased = isetval.compare(table, with_method(kept, "own")).table["simulated"].to_numpy(float)
    pattern = table.value("prnu.sigma_percent") / 100 * (mean - table.sensor.black_dn[0][0])  # spatial noise holds it as well
    whole = np.hypot(unbiased, pattern)
    bias = 100 * (ours / whole - 1)
    inside_whole = (whole >= low - READING_DN) & (whole <= high + READING_DN)
    gain, gain_sigma = next(iter(both.nuisances["table"].values()))
    their_mean, _, _, theirs = envelope(data, "simulated")
    published = np.interp(mean, their_mean, theirs)
    preferred = "the table's" if z2["table"] < z2["code"] else "the code's"
    claims = (
        Claim(
            claim=f"standard deviation of uniform patches at means of {mean[0]:g} to {mean[-1]:g} DN",
            published=f"{np.sum((published >= low) & (published <= high))} of {mean.size} levels inside the measured cloud",
            measured="envelope of 500 patches, +- 0.25 DN",
            ours=f"{inside.sum()} of {mean.size} inside; mean-square z {both.ladder[0].mean_square_z:.2f}",
            missing=f"nothing that this cloud shows; gain {gain:+.4f} +- {gain_sigma:.4f} DN/e- from the table's",
            sure=_outside(data, ours, row_z, inside),
            target="inside the measured envelope at all levels",
            met=bool(inside.all()),
            numbers={"inside": float(inside.sum()), "levels": float(mean.size), "mean_square_z": both.ladder[0].mean_square_z},
        ),
        Claim(
            claim="DSNU: .038 mV (table) or .38 mV (code)",
            published=f"{numbers['dsnu_e_code']:.2f} e- simulated, {numbers['dsnu_e_paper']:.2f} e- printed",
            measured="not decided by this cloud",
            ours=f"chi2 {z2['table']:.1f} (table), {z2['code']:.1f} (code)",
            missing=f"patches in the dark: the two differ by {_difference(both):.2f} DN at the lowest mean here",
            sure=f"{preferred} is {abs(z2['table'] - z2['code']):.1f} in chi2 nearer: "
            + ("no decision" if abs(z2["table"] - z2["code"]) < 9 else "decided at three sigmas"),
            numbers={"chi2_table": z2["table"], "chi2_code": z2["code"]},
        ),
        Claim(
            claim="the rule that selects uniform patches is without bias",
            published="the same rule on both sides",
            measured="-",
            ours=f"its standard deviation is {bias.mean():+.1f} % off on average ({bias[0]:+.1f} % at the lowest level); without "
            f"it {inside_whole.sum()} of {mean.size} levels lie inside the measured cloud",
            missing="noise beyond shot noise is rejected: excess noise of either side would not show",
            sure="simulated flats, against frame differences with the pixels' fixed response added; "
            f"+- {np.std(bias) / np.sqrt(bias.size):.1f} %",
            numbers={"bias_percent": float(bias.mean()), "inside_unbiased": float(inside_whole.sum())},
        ),
    )
    cloud = our_patches(table, campaign, mean)
    return Result(
        key="noise",
        title="Sensor noise",
        claims=claims,
        figure=drawn(data, mean, ours, whole, cloud),
        caption="Standard deviation of the greens of uniform patches against their mean, black level included: envelope of the "
        "measured cloud (digitised), of the published simulation, and 500 patches of ours by the paper's rule.",
    )


def _outside(data: Path, ours: np.ndarray, z: np.ndarray, inside: np.ndarray) -> str:
    """Where the expectation leaves the measured cloud, by how much, and whether the drawing or the model is wrong there.

    Markers of the published simulation are painted over the measured ones (README of the data): where the highest measured
    one that is to be seen lies below the lowest simulated one, the cloud's upper edge is hidden, and its middle with it.
    """
    mean, low, high, _ = envelope(data, "measured")
    at, painted_low, painted_high, _ = envelope(data, "simulated")
    over_low, over_high = np.interp(mean, at, painted_low), np.interp(mean, at, painted_high)
    hidden = high < over_low
    known = (
        f"middle of the cloud known to 8 % (single patches cannot be read); inside, mean-square z {np.mean(z[inside] ** 2):.2f}"
    )
    said = [known]
    for i in np.flatnonzero(~inside):
        beside = [j for j in (i - 1, i + 1) if 0 <= j < mean.size]
        said.append(
            f"outside at {mean[i]:g} DN: {ours[i]:.2f} DN where the envelope is {low[i]:.2f} to {high[i]:.2f}, "
            f"{abs(z[i]):.1f} sigmas from its middle; beside it ({', '.join(f'{mean[j]:g}' for j in beside)} DN) "
            f"{np.sqrt(np.mean(z[beside] ** 2)):.1f} sigmas, edges {low[beside].mean():.2f} to {high[beside].mean():.2f}"
        )
        if hidden[i]:
            said.append(
                f"the envelope's fault: markers of the published simulation, {over_low[i]:.2f} to {over_high[i]:.2f}, lie "
                f"painted over it, and what is left to see ends below them{', at no other level' if hidden.sum() == 1 else ''}"
            )
    return "; ".join(said)


def with_method(campaign: isetval.Campaign, method: str) -> isetval.Campaign:
    """The campaign with its rows measured by another rule on the model's side."""
    return replace(campaign, shots=tuple(replace(s, given=replace(s.given, method=method)) for s in campaign.shots))


def _difference(both) -> float:
    """How far the two sensors are apart at the lowest level, DN."""
    first = both.table.groupby("model", sort=False)["simulated"].first()
    return float(abs(first.iloc[0] - first.iloc[1]))


def our_patches(model: isetval.CameraModel, campaign: isetval.Campaign, mean_dn: np.ndarray) -> np.ndarray:
    """Mean and standard deviation, (patches, 2), of 500 patches at the measured levels by the paper's rule."""
    (shot,) = campaign.shots
    plain = replace(shot, given=None, frames=1, name="level")
    light = campaign.lights
    level = float(model.expected(plain, lights=light)[::2, 1::2].mean()) - model.sensor.black_dn[0][0]  # of a green plane
    green = (mean_dn - model.sensor.black_dn[0][0]) / level
    shots = tuple(replace(plain, name=f"level_{i}", setup=f"level_{i}", light_level=float(g)) for i, g in enumerate(green))
    made = isetval.simulate(model, replace(campaign, shots=shots, nuisances=()), seed=SEED)
    gain = model.value("conversion_gain.gain_dn_per_e")
    out = []
    for captures in made.captures.values():
        found = isetval.measure.uniform_patches(captures, method="lyu2022", gain_dn_per_e=gain, count=40, seed=SEED)
        out += [(p.mean_dn + model.sensor.black_dn[0][0], p.spatial_std_dn) for p in found.accepted]
    return np.array(out)[np.random.default_rng(SEED).permutation(len(out))[:500]]


# %% The paper's figure beside ours
def drawn(data: Path, mean: np.ndarray, ours: np.ndarray, whole: np.ndarray, cloud: np.ndarray):
    """Envelopes, our patches, our expectation."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    ax = figure.subplots()
    for series, color, label in (("simulated", PUBLISHED, "published simulation"), ("measured", MEASURED, "measured")):
        at, low, high, _ = envelope(data, series)
        ax.fill_between(at, low, high, color=color, alpha=0.22, lw=0, label=f"{label}: envelope of 500 patches")
    ax.plot(cloud[:, 0], cloud[:, 1], ".", ms=2.5, color="0.35", label="ours (simulated): 500 patches")
    ax.plot(mean, ours, color=OURS, label="ours (simulated): expectation by the same rule")
    ax.plot(mean, whole, "--", color=OURS, label="ours (simulated): expectation by a rule without bias")
    ax.set(xlabel="mean / DN (black 64 included)", ylabel="standard deviation / DN", xlim=(64, 740), ylim=(0, 14))
    ax.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    main(run, "Noise against level: measured, published, ours.")
