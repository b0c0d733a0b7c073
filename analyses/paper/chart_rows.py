"""The miniature chart for two scripts: its campaign, its patch means, and the published scatter."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

import isetval
from analyses.paper.common import columns, csv_rows, laboratory, qe_file

LIGHTS = ("A", "CWF", "Day")
PATCHES = tuple(f"p{k:02d}" for k in range(1, 25))
CHANNELS = ("R", "G", "B")
BRIGHTEST_DN = 500.0  # above black, of the brightest patch: the published scatter reaches that far
PANELS = {
    "nominal": "fig3a_midcenter_nominalQE",
    "corrected": "fig3b_midcenter_correctedQE",
    "eight places": "fig10c_8pos_correctedQE_vig",
}


def prepared(data: Path, work: Path) -> Path:
    """The folder with the campaign, its lights and reflectances, and the camera with both quantum efficiencies."""
    folder = laboratory("chart", work)
    shutil.copy(data / "lightbooth_illuminants.csv", folder / "lights.csv")
    for light in LIGHTS:
        shutil.copy(data / f"mcc_mini_reflectance_ill{light}.csv", folder / f"reflectance_{light}.csv")
    shutil.copy(data / "rtf_pixel4a_rear_ellipse_poly4.json", folder / "lens.json")
    qe_file(data, folder / "qe.csv")
    qe_file(data, folder / "qe_nominal.csv", corrected=False)
    return folder


def exposed(model: isetval.CameraModel, campaign: isetval.Campaign) -> isetval.Campaign:
    """The campaign with each light at the level that brings its brightest pixel near `BRIGHTEST_DN`."""
    black = float(np.mean(model.sensor.black_dn))
    shots = []
    for shot in campaign.shots:
        dim = replace(shot, light_level=1e-3 * shot.light_level)
        top = float(model.expected(dim, lights=campaign.lights).max()) - black
        shots.append(replace(shot, light_level=1e-3 * shot.light_level * BRIGHTEST_DN / top))
    return replace(campaign, shots=tuple(shots))


def patch_means(model: isetval.CameraModel, campaign: isetval.Campaign, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Means above black and their sigma, (shots, patches, 3), measured of the captures that the model makes."""
    table = isetval.measure_campaign(isetval.simulate(model, campaign, seed=seed), summaries=False)
    found = {(m.shot, m.patch, m.channel): (m.value, m.sigma) for m in table.metrics if m.name == "patch_mean"}
    planes = {"R": ("R",), "G": ("Gr", "Gb"), "B": ("B",)}
    out = [
        [[np.mean([found[s.name, p, k] for k in planes[c]], axis=0) for c in CHANNELS] for p in PATCHES] for s in campaign.shots
    ]
    both = np.array(out)
    return both[..., 0], both[..., 1]


def expected_means(model: isetval.CameraModel, campaign: isetval.Campaign) -> np.ndarray:
    """Noise-free means above black, (shots, patches, 3)."""
    plain = model.without("prnu")
    places = {"R": ((0, 0),), "G": ((0, 1), (1, 0)), "B": ((1, 1),)}  # of the colours in a window of even origin
    black = float(np.mean(model.sensor.black_dn))
    out = []
    for shot in campaign.shots:
        dn = plain.expected(shot, lights=campaign.lights) - black
        m = shot.target.margin_px
        boxes = [dn[p.box[0] + m : p.box[1] - m, p.box[2] + m : p.box[3] - m] for p in shot.target.patches]
        out.append([[np.mean([b[i::2, j::2].mean() for i, j in places[c]]) for c in CHANNELS] for b in boxes])
    return np.array(out)


def with_nominal_qe(model: isetval.CameraModel) -> isetval.CameraModel:
    """The camera before the paper's correction."""
    return replace(model.replace(replace(model.effect("quantum_efficiency"), file="qe_nominal.csv")), name="nominal")


def scatter(data: Path, panel: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Measured and simulated values of a published panel by channel, DN above black."""
    rows = [r for r in csv_rows(data / "measured" / "mcc_scatter.csv") if r["panel"] == PANELS[panel]]
    out = {}
    for channel in CHANNELS:
        measured, simulated = columns([r for r in rows if r["channel"] == channel], "measured_dv", "simulated_dv")
        out[channel] = (measured - 64.0, simulated - 64.0)
    return out


def slope(measured: np.ndarray, simulated: np.ndarray) -> tuple[float, float, float]:
    """Measured over simulated through the origin, its sigma, and the relative rms that is left."""
    k = float(measured @ simulated / (simulated @ simulated))
    rest = measured - k * simulated
    return (
        k,
        float(np.sqrt(rest @ rest / (measured.size - 1) / (simulated @ simulated))),
        float(np.sqrt(rest @ rest / (measured @ measured))),
    )
