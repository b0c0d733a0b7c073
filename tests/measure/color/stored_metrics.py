"""The metrics of ``data/stored/shading_color.json``; run as a script to write them anew (say why in the commit)."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
STORED = ROOT / "data" / "stored" / "shading_color.json"
CANON = ROOT.parent / "shared" / "data" / "real" / "canon550d_colorchecker.dng"
PHONE = ROOT.parent / "shared" / "data" / "pixel4a"
sys.path.insert(0, str(ROOT / "tests" / "measure" / "shading"))


def canon_chart(corners_px=None) -> dict:
    """Patch means and slope of the real chart; with stored corners the places do not depend on the finder."""
    from isetval import read_dng
    from isetval.measure import chart

    result = chart(read_dng(CANON), choices=None if corners_px is None else {"corners_px": corners_px})
    line = result.noise_lines["all"]
    return {
        "corners_px": np.round(result.corners_px, 3).tolist(),
        "mean_dn": result.mean_dn.tolist(),
        "sigma_dn": result.sigma_dn.tolist(),
        "slope_dn": line.slope_dn,
        "slope_sigma_dn": line.slope_sigma_dn,
    }


def phone_falloff() -> dict:
    """Digitised measured fall-off over the design's."""
    from isetval.measure.shading.comparisons import compare_curves

    table = np.genfromtxt(PHONE / "measured" / "relative_illumination.csv", delimiter=",", names=True)
    there = np.isfinite(table["ri_measured"]) & np.isfinite(table["ri_zemax"])
    radius, ours, design = (table[c][there] for c in ("image_height_mm", "ri_measured", "ri_zemax"))
    part = compare_curves(radius, ours, design, sigma=0.003)
    ratios = np.interp([1.0, 2.0, 3.0], part.radius_mm, part.ratio)
    return {"ratio": ratios.tolist(), "loss_per_mm2": part.loss_per_mm2, "loss_sigma_per_mm2": part.loss_sigma_per_mm2}


def made_flat() -> dict:
    """Relative illumination of a flat made from a fixed seed."""
    from flat_fields import Flat

    from isetval.measure import relative_illumination

    flat = Flat(center_px=(3.0, -4.0), tilt_per_mm=(0.008, -0.006))
    result = relative_illumination(flat.capture(np.random.default_rng(2026)))
    red = result.color_shading["R/G"]
    return {
        "center_px": list(result.center_px),
        "center_sigma_px": list(result.center_sigma_px),
        "tilt_per_mm": list(result.tilt_per_mm),
        "tilt_sigma_per_mm": list(result.tilt_sigma_per_mm),
        "curve": result["Gr"].curve[::10].tolist(),
        "curve_sigma": result["Gr"].sigma[::10].tolist(),
        "red_over_green": red.ratio[::10].tolist(),
        "red_over_green_sigma": red.sigma[::10].tolist(),
        "order": result.order,
        "chi2_dof": result.chi2_dof,
    }


def made_matrix() -> dict:
    """The 3x3 matrix from made-up predictions and noise of a fixed seed."""
    from isetval.measure import spectral_qe

    rng = np.random.default_rng(2027)
    predicted = rng.uniform(20, 800, (3, 24, 1)) * rng.uniform(0.3, 1.0, (3, 24, 3))
    clean = predicted @ np.array([[0.56, 0.08, 0.01], [0.0, 0.59, 0.0], [0.0, 0.25, 0.71]])
    clean[1, 6] *= 1.1
    sigma = np.sqrt(0.3 + 0.17 * clean) / 20
    result = spectral_qe(clean + sigma * rng.standard_normal(clean.shape), predicted, sigma=sigma)
    return {"matrix": result.matrix.tolist(), "sigma": result.sigma_free.tolist(), "outliers": list(result.outliers)}


def main() -> None:
    """Write the file."""
    out = {
        "about": "Stored metrics of shading and colour analyses; checked by tests/measure/color/test_regression.py.",
        "sources": {
            "canon_chart": "canon550d_colorchecker.dng of syoyo/tinydng (MIT), sha256 592dba16...; analysed, not copied",
            "phone_falloff": "digitised from Figure_05.html of ISET/isetcornellbox (cite Lyu et al.); ratios only",
            "made_flat": "made by tests/measure/shading/flat_fields.py, seed 2026; project licence",
            "made_matrix": "made by tests/measure/color/stored_metrics.py, seed 2027; project licence",
        },
        "canon_chart": canon_chart(),
        "phone_falloff": phone_falloff(),
        "made_flat": made_flat(),
        "made_matrix": made_matrix(),
    }
    out["canon_chart"] = canon_chart(out["canon_chart"]["corners_px"])
    STORED.write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
