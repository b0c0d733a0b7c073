# %% [markdown]
# # The authors' own captures: a clone of their repository becomes a campaign, and its numbers are measured again
#
# `python -m analyses.paper.authors_repository PATH [--camera MODEL]`: PATH is a clone of ISET/isetcornellbox with the DNGs in
# data/measurement/{integratingsphere/.../{5,10,...}, QEcalibration/{A,cwf,day}/{place}, camerapos, mccpos}/IMG_*.dng.
# `isetval campaign init` drafts the campaign from the tree alone; nothing is written into the clone (the files are linked).
# Measured: fall-off and conversion gain of the sphere (results 2 and 5), edges and uniform patches of the pictures of the box
# (3 and 4), patch means of the chart under three lights at eight places (6 and 8), which M is then fitted to.
# Run time: minutes for 107 frames of 12 MP.

# %%
from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import isetval
from analyses.paper.common import DATA
from isetval.app.cli import main as isetval_command

LIGHTS = ("A", "CWF", "Day")  # names of the stored radiances, and of the authors' folders in some case
KEPT = 15  # frames of the sphere that a fall-off needs: more fix the curve no better than the light's own unevenness


def linked(source: Path, folder: Path) -> Path:
    """The DNGs of a clone in a folder of their own: linked where the disk allows, else copied."""

    def link(a: str, b: str) -> None:
        try:
            os.link(a, b)
        except OSError:
            shutil.copy2(a, b)

    measured = source / "data" / "measurement"
    if not measured.is_dir():
        raise SystemExit(f"{source}: has no folder data/measurement; name a clone of ISET/isetcornellbox with its DNGs")

    def only_raw(place: str, names: list[str]) -> list[str]:
        return [n for n in names if not (Path(place) / n).is_dir() and not n.lower().endswith(".dng")]

    return Path(shutil.copytree(measured, folder / "measurement", copy_function=link, ignore=only_raw))


def drafted(folder: Path, camera: str) -> isetval.Campaign:
    """The campaign that `isetval campaign init` makes of the folder."""
    code = isetval_command(["campaign", "init", str(folder), "--camera", camera, "-q"])
    if code:
        raise SystemExit(code)
    return isetval.load_campaign(folder)


# %% The numbers
def sphere(campaign: isetval.Campaign) -> dict[str, object]:
    """Fall-off, centre and gain of the sphere's frames, with sigma."""
    flats = {s.name: s for s in campaign.shots if s.role == "flat"}
    if not flats:
        return {"words": "no flat was found"}
    captures = {name: campaign.captures[name] for name in flats}
    level = {name: float(np.mean(c[0].mosaic)) for name, c in captures.items()}
    white = campaign.sensor.white_dn
    brightest = max((n for n in level if captures[n][0].mosaic.max() < white), key=level.__getitem__, default=max(level))
    out: dict[str, object] = {}
    curve = isetval.measure.relative_illumination(captures[brightest][:KEPT]).planes["Gr"]
    out["fall_off"] = {
        "radius_mm": curve.radius_mm.round(4).tolist(),
        "value": curve.curve.round(5).tolist(),
        "sigma": curve.sigma.round(6).tolist(),
    }
    found = isetval.measure.photon_transfer([frame for c in captures.values() for frame in c])
    for plane in ("Gr", "Gb"):
        gain = found[plane].gain_dn_per_e
        out[f"gain_{plane}"] = {"value": float(gain.value), "sigma": float(gain.sigma), "unit": "DN/e-"}
    return out


def edges(campaign: isetval.Campaign) -> list[dict[str, object]]:
    """MTF50 of every edge that was registered, in every frame, by the authors' procedure and by our own."""
    out = []
    for shot in campaign.shots:
        if shot.role != "edge":
            continue
        roi = getattr(shot.target, "roi", None)
        for frame, capture in enumerate(campaign.captures[shot.name]):
            for method in ("lyu2022", "default"):
                found = isetval.measure.sfr(capture, roi, method=method)
                row = {"shot": shot.name, "frame": frame, "method": method}
                row |= {"mtf50_cy_px": float(found.mtf50_cy_px), "sigma": float(found.mtf50_sigma)}
                out.append(row if found.accepted else row | {"refused": dict(found.messages)})
    return out


def patches(campaign: isetval.Campaign, gain: float) -> dict[str, object]:
    """Noise against level of uniform patches by the paper's rule, in pictures that hold a scene."""
    rows = []
    for shot in campaign.shots:
        if shot.role in ("scene", "edge", "chart"):
            frame = campaign.captures[shot.name][0]
            table = isetval.measure.uniform_patches(frame, method="lyu2022", gain_dn_per_e=gain, count=500, seed=0)
            rows += [(p.mean_dn, p.spatial_std_dn) for p in table.accepted]
    both = np.array(rows).reshape(-1, 2)
    order = np.argsort(both[:, 0])
    parts = [part for part in np.array_split(both[order], 8) if part.size]
    return {
        "patches": len(both),
        "mean_dn": [float(p[:, 0].mean()) for p in parts],
        "std_dn": [float(p[:, 1].mean()) for p in parts],
    }


def charts(campaign: isetval.Campaign) -> dict[str, object]:
    """Patch means of the chart by light and place: the rows that M and the colour scatter are made of."""
    table = isetval.measure_campaign(campaign.only([s.name for s in campaign.shots if s.role == "chart"]), summaries=False)
    out: dict[str, dict[str, list[float]]] = {}
    lights = {s.name: s.light for s in campaign.shots}
    for m in table.metrics:
        if m.name == "patch_mean":
            out.setdefault(f"{lights[m.shot]}: {m.setup}", {})[f"{m.patch} {m.channel}"] = [float(m.value), float(m.sigma)]
    return {"charts": len(out), "means": out}


def matrices(campaign: isetval.Campaign, data: Path) -> dict[str, object]:
    """M and its held-out error at each place at which the chart was taken under all three lights.

    The order of the stored radiances is column by column from a corner: of the four ways to lay it over the chart that was
    found, the one that a free 3 x 3 matrix fits best is taken.
    """
    from isetval.measure import spectral_qe
    from isetval.measure.color import predicted_responses

    nominal = np.genfromtxt(data / "sensor_qe_nominal_derived.csv", delimiter=",", names=True)
    radiance = np.genfromtxt(data / "mcc_mini_radiance.csv", delimiter=",", names=True)
    nm, at = nominal["wavelength_nm"], radiance["wavelength_nm"]
    stored = [[np.interp(nm, at, radiance[f"{light}_p{k:02d}"]) for k in range(1, 25)] for light in LIGHTS]
    qe = np.stack([nominal[c] for c in ("qe_r", "qe_g", "qe_b")], axis=1)
    predicted = predicted_responses(np.array(stored), qe, wavelength_nm=nm)
    out: dict[str, object] = {}
    for place, (measured, sigma) in _by_place(campaign).items():
        order = min(_layouts(), key=lambda o: _misfit(measured, predicted[:, o]))
        laid = predicted[:, order]
        scale = measured.sum() / laid.sum()
        found = spectral_qe(measured, laid * scale, sigma=sigma, lights=LIGHTS)
        held = [float(h.rms_relative) for h in found.holdout_light]
        out[place] = {"matrix": found.matrix.round(4).tolist(), "held_out_light": held, "excluded": list(found.outliers)}
    return out


def _by_place(campaign: isetval.Campaign) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Means and sigma, (lights, 24, 3), of each place that all lights have."""
    charts = [s for s in campaign.shots if s.role == "chart"]
    table = isetval.measure_campaign(campaign.only([s.name for s in charts]), summaries=False)
    found = {(m.shot, m.patch, m.channel): (m.value, m.sigma) for m in table.metrics if m.name == "patch_mean"}
    out: dict[str, dict[str, np.ndarray]] = {}
    for shot in charts:
        names = [p.name for p in shot.target.patches]
        folders = Path(shot.files[0]).parent.parts
        light = next((light for light in LIGHTS if light.lower() in (f.lower() for f in folders)), "")
        if not light or len(names) != 24 or any((shot.name, n, c) not in found for n in names for c in ("R", "Gr", "Gb", "B")):
            continue
        rows = [
            [np.mean([found[shot.name, n, c] for c in planes], axis=0) for planes in (("R",), ("Gr", "Gb"), ("B",))]
            for n in names
        ]
        out.setdefault(folders[-1], {})[light] = np.array(rows)
    full = {place: np.array([lights[light] for light in LIGHTS]) for place, lights in out.items() if len(lights) == len(LIGHTS)}
    return {place: (both[..., 0], both[..., 1]) for place, both in full.items()}


def _layouts() -> list[np.ndarray]:
    """Numbers of the stored patches for the 24 of the chart row by row, for the four corners that they may start from."""
    columnwise = np.arange(24).reshape(6, 4).T  # 4 rows of 6, stored column by column
    return [columnwise[::up, ::left].ravel() for up in (1, -1) for left in (1, -1)]


def _misfit(measured: np.ndarray, predicted: np.ndarray) -> float:
    """What a free matrix leaves, relative."""
    a, b = predicted.reshape(-1, 3), measured.reshape(-1, 3)
    return float(np.sum((b - a @ np.linalg.lstsq(a, b, rcond=None)[0]) ** 2) / np.sum(b**2))


def run(source: Path, camera: str, data: Path = DATA) -> dict[str, object]:
    """All numbers of a clone; M only where the published radiances are in ``data``."""
    with tempfile.TemporaryDirectory() as work:
        campaign = drafted(linked(source, Path(work)), camera)
        shots = {role: sum(s.role == role for s in campaign.shots) for role in ("dark", "flat", "edge", "chart", "scene")}
        lit = sphere(campaign)
        gain = lit.get("gain_Gr")
        value = float(gain["value"]) if isinstance(gain, dict) else 0.1707
        return {
            "files": sum(len(s.files) for s in campaign.shots),
            "shots": shots,
            "sphere": lit,
            "edges": edges(campaign),
            "uniform_patches": patches(campaign, value),
            "charts": charts(campaign) if shots["chart"] else {"charts": 0},
            "matrices": matrices(campaign, data) if shots["chart"] and (data / "mcc_mini_radiance.csv").is_file() else {},
        }


def main() -> None:
    """Print what was found; ``--json`` all of it."""
    parser = argparse.ArgumentParser(description="The authors' captures, measured again.")
    parser.add_argument("path", type=Path, metavar="PATH", help="clone of ISET/isetcornellbox with its DNGs")
    parser.add_argument("--camera", default="isetval:pixel4a/camera.toml", help="nominal camera model (default: %(default)s)")
    parser.add_argument(
        "--data", type=Path, default=DATA, help="folder of the published radiances (default: ../shared/data/pixel4a)"
    )
    parser.add_argument("--json", action="store_true", help="all numbers as JSON")
    args = parser.parse_args()
    found = run(args.path, args.camera, args.data)
    if args.json:
        json.dump(found, sys.stdout, indent=1)
        return
    print(f"{found['files']} files as {found['shots']}")
    lit = found["sphere"]
    for plane in ("Gr", "Gb"):
        if f"gain_{plane}" in lit:
            print(f"conversion gain {plane}: {lit[f'gain_{plane}']['value']:.4f} +- {lit[f'gain_{plane}']['sigma']:.4f} DN/e-")
    if "fall_off" in lit:
        curve = lit["fall_off"]
        for wanted in (1.0, 2.0, 3.0):
            if wanted <= curve["radius_mm"][-1]:
                print(f"relative illumination at {wanted:g} mm: {np.interp(wanted, curve['radius_mm'], curve['value']):.4f}")
    for edge in found["edges"]:
        name = f"{edge['shot']} frame {edge['frame']} ({edge['method']})"
        print(f"{name}: MTF50 {edge['mtf50_cy_px']:.4f} +- {edge['sigma']:.4f} cy/px")
    for place, m in found["matrices"].items():
        print(f"M at {place}: {m['matrix']}; held-out lights {', '.join(f'{100 * v:.1f} %' for v in m['held_out_light'])}")
    print(f"{found['uniform_patches']['patches']} uniform patches; {found['charts']['charts']} charts")


if __name__ == "__main__":
    main()
