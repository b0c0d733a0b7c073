"""Metrics that the regression test holds; run this file to write them anew, and say why in the commit."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
STORED = ROOT / "data" / "stored" / "sensor_noise.json"
REAL = ROOT.parent / "shared" / "data" / "real"
NOTE = (
    "What the code gave for a simulated series (tests/measure/noise/noise_camera.py, seed 4321; own work, BSD-3-Clause) "
    "and for public real files: the dark frame of 10x-Engineers/Infinite-ISP_TuningTool (Apache-2.0) and the Canon 550D "
    "picture of syoyo/tinydng (MIT); numbers only, the files are not in this repository."
)


def simulated() -> dict[str, dict[str, float]]:
    """Photon transfer, dark and statistics of one small Bayer camera."""
    from noise_camera import NoiseCamera, series

    from isetval.measure import dark, photon_transfer
    from isetval.measure.noise import flat_statistics

    captures = series(NoiseCamera(np.random.default_rng(4321), (96, 96), cfa="RGGB"), np.geomspace(50, 8000, 8), dark_frames=4)
    out: dict[str, dict[str, float]] = {}
    for name, frame in (("photon_transfer", photon_transfer(captures).to_frame()), ("dark", dark(captures[:4]).to_frame())):
        out[name] = {f"{r.plane}.{r['name']}": r.value for _, r in frame.iterrows() if np.isfinite(r.value)}
    statistics = flat_statistics(captures[8:10])
    out["flat_statistics"] = {
        f"{plane}.{name}": q.value for plane, s in statistics.items() for name, q in s.quantities.items() if np.isfinite(q.value)
    }
    return out


def real() -> dict[str, dict[str, float]]:
    """The real files, as far as they are there."""
    import isetval
    from isetval.measure import dark, uniform_patches

    out: dict[str, dict[str, float]] = {}
    raw = REAL / "dark_1920x1080_bggr_u16le.raw"
    if raw.exists():
        codes = np.fromfile(raw, dtype="<u2").reshape(1080, 1920)
        capture = isetval.Capture.from_array(codes, cfa="BGGR", black_dn=0, white_dn=4095)
        found = dark([capture], (2, 1080, 0, 1918))
        out["real_dark"] = {f"{p}.black_level_dn": d.black_level_dn.value for p, d in found.items()}
        out["real_dark"] |= {f"{p}.hot_pixels": float(d.hot_pixels) for p, d in found.items()}
    chart = REAL / "canon550d_colorchecker.dng"
    if chart.exists():
        table = uniform_patches(
            isetval.read_dng(chart), (200, 800, 200, 1400), method="lyu2022", gain_dn_per_e=1.9, count=400, seed=1
        )
        accepted = table.accepted
        out["real_chart"] = {
            "accepted": float(len(accepted)),
            "mean_dn": float(np.mean([p.mean_dn for p in accepted])),
            "spatial_std_dn": float(np.mean([p.spatial_std_dn for p in accepted])),
        }
    return out


def main() -> int:
    STORED.parent.mkdir(parents=True, exist_ok=True)
    STORED.write_text(json.dumps({"note": NOTE, **simulated(), **real()}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
