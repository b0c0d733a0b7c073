"""Wrong forms of catalogue effects, and effects that no catalogue holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .concealed import CHARTS, DARK, EDGES, FIELD, OWN, Concealed


def _form(key: str, name: str, amplitude: Mapping[str, Any], practice: str, **more: Any) -> Concealed:
    return Concealed(key, "form", name, amplitude, practice, **more)


FORMS = (
    _form(
        "vignetting_early",
        "vignetting",
        {"loss": 0.06},
        "onset .4 and third power",
        seen=FIELD,
        fixed={"onset": 0.4, "power": 3.0},
    ),
    _form("microlens_fourth", "microlens", {"loss": 0.05}, "fourth power", seen=FIELD, also=("vignetting", "cos4")),
    _form("microlens_angle", "microlens", {"loss": 0.05}, "saturates with the chief ray's angle", seen=FIELD, also=("cos4",)),
    _form(
        "linear_fall_off", "cos4", {"loss": 0.04}, "a cusp in the middle", seen=FIELD, also=("microlens", "light_nonuniformity")
    ),
    _form(
        "glare_falling",
        "veiling_glare",
        {"gamma": 0.02},
        "half as strong in the corner",
        seen=FIELD,
        fixed={"fall": 0.5},
        also=("ghost",),
    ),
    _form("nonlinearity_cubic", "nonlinearity", {"c": 0.012}, "second power of the swing"),
    _form("dark_current_warming", "dark_current", {"e_per_s": 0.1}, "grows within an exposure", seen=DARK),
    _form("read_noise_tailed", "read_noise", {"extra_e": 0.7}, "Laplace spread", seen=DARK, power=2, also=("rts",)),
    _form("dsnu_skewed", "dsnu", {"extra_e": 0.3}, "skew offsets", seen=DARK, power=2),
    _form("row_noise_flickering", "temporal_row_noise", {"sigma_dn": 0.045}, "changes from frame to frame", seen=DARK, power=2),
    _form("shutter_bounce", "exposure_time", {"late_s": 1e-5}, "smaller for long exposures"),
    _form("spectral_line", "spd_mismatch", {"height": 0.1}, "a line at 611 nm", seen=CHARTS, fixed={"nm": 611.0}),
    _form("curvature_fourth", "field_curvature", {"sag_um": 5.0}, "fourth power of the radius", seen=EDGES),
    _form("dust", "dust", {"loss": 0.008}, "three grains", seen=FIELD, fixed={"points": (2, 6, 9)}),
    _form("column_group_gain", "alternating_columns", {"share": 0.0008}, "groups of eight", power=2, also=("column_fpn",)),
    _form(
        "slow_row_drift", "correlated_row_noise", {"sigma_dn": 0.05}, "AR(1)", seen=DARK, power=2, also=("temporal_row_noise",)
    ),
    _form("particle_hits", "transient_hits", {"per_frame": 1.0}, "at any exposure", seen=DARK),
)


def _outsider(key: str, amplitude: Mapping[str, Any], practice: str, **more: Any) -> Concealed:
    return Concealed(key, "outsider", "", amplitude, practice, **more)


OUTSIDERS = (
    _outsider("light_leak", {"e_per_s": 600.0}, OWN, seen=FIELD, fixed={"x": -0.45, "y": 0.4}),
    _outsider("stitched_half", {"share": 0.003}, OWN, seen=FIELD),
    _outsider("diagonal_hatch", {"share": 0.004}, OWN, power=2),
    _outsider("shutter_travel", {"last_row_late_s": 2e-5}, OWN, seen=FIELD),
    _outsider("row_bands", {"depth": 0.003}, OWN, power=2, also=("rolling_flicker",)),
    _outsider("warming_lamp", {"first": 0.005}, OWN, also=("lamp_drift",)),
    _outsider("settling_rows", {"share": 0.001}, OWN, also=("amplifier_crosstalk",)),
    _outsider("missing_codes", {"every": 8}, OWN, seen=DARK, scaled=False),
    _outsider("faded_patch", {"loss": 0.006}, OWN, seen=CHARTS, fixed={"patch": "orange"}),
    _outsider("row_group_gain", {"share": 0.001}, OWN, power=2),
    _outsider("smear", {"share": 0.002}, OWN),
    _outsider("sharpened", {"weight": 0.04}, OWN, also=("raw_filtering",)),
)
