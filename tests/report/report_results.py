"""Results of planted sizes, as the commands write them."""

import numpy as np


def row(model, family, z, n, error=0.01):
    return {"model": model, "family": family, "role": "prediction", "n": n, "mean_square_z": z, "rms_relative_error": error}


def metric(model, family, z, i, **more):
    made = {
        "model": model, "name": "mean", "family": family, "channel": ("R", "Gr", "Gb", "B")[i % 4], "shot": f"shot{i // 4}",
        "role": "flat", "setup": "s", "region": "", "patch": "", "unit": "DN", "measured": 100.0 + i, "simulated": 100.0 + i - z,
        "sigma": 1.0, "z": z, "frequency_cy_px": None, "exposure_s": 0.01, "level": 1.0, "field_x_mm": 0.3 * i, "field_y_mm": 0.0,
    }  # fmt: skip
    return made | more


def comparison_and_diagnosis():
    """A comparison of two models, the first wrong in flat_mean by planted amounts, and the diagnosis that explains it."""
    rng = np.random.default_rng(0)
    table = []
    for model, size in (("nominal", 6.0), ("mended", 1.0)):
        table += [metric(model, "flat_mean", float(size * rng.standard_normal()), i) for i in range(24)]
        table += [metric(model, "dark_mean", float(rng.standard_normal()), i, role="dark") for i in range(24)]
    ladder = [
        row("nominal", "all", 18.5, 48), row("nominal", "flat_mean", 36.0, 24), row("nominal", "dark_mean", 1.02, 24),
        row("mended", "all", 1.01, 48), row("mended", "flat_mean", 0.98, 24), row("mended", "dark_mean", 1.02, 24),
    ]  # fmt: skip
    comparison = {
        "kind": "compare", "campaign": "lab", "models": ["nominal", "mended"], "table": table, "ladder": ladder, "settings": {},
        "gate": {"run": True, "failed": False, "mean_square_z": 1.04, "n": 30, "allowed": 0.7}, "notes": [],
        "nuisances": {"nominal": {"light_level@set-up:s": [0.01, 0.002]}, "mended": {"light_level@set-up:s": [0.012, 0.002]}},
    }  # fmt: skip
    parameter = {"value": 0.101, "sigma": 0.004, "unit": "1", "nominal": 0.0, "delta": 0.101}
    effect = {"name": "vignetting", "parameters": {"v": parameter}, "posterior": 0.97, "equivalent": ["cos4"], "dchi2": 800.0}
    candidate = {
        "name": "vignetting", "dchi2": 800.0, "dof": 1, "p_corrected": 1e-9, "posterior": 0.97, "log_evidence": 1.0,
        "observable": True,
        "estimate": {"v": {"value": 0.1, "sigma": 0.004}},
    }  # fmt: skip
    diagnosis = {
        "kind": "diagnose", "verdict": "attributed", "effects": [effect], "candidates": [candidate], "unobservable": ["lag"],
        "next_captures": [], "leftover": None, "ladder": ladder, "gate": comparison["gate"],
        "campaign": "lab", "model": "nominal", "notes": [],
    }  # fmt: skip
    return [diagnosis, comparison]
