"""The trials: what is hidden in which campaign, and what a right diagnosis would say.

Seeds and strengths were fixed before the first run that counts; a miss is listed, never drawn again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot


@dataclass(frozen=True)
class Trial:
    """One campaign with a hidden effect (or none).

    ``values`` are parameters as the catalogue names them, where the two descriptions mean the same
    number; ``also`` are names that belong to the same class because no capture of the plan separates them.
    """

    name: str
    seed: int
    hidden: dict = field(default_factory=dict)
    kind: str = "effect"
    effect: str = ""
    values: dict = field(default_factory=dict)
    also: tuple = ()


def _single(name, seed, parameters, values, also=(), label=""):
    return Trial(label or name, seed, {name: parameters}, "effect", name, values, also)


READ_E, DSNU_E, PRNU_PERCENT, DARK_E_PER_S = 2.954, 0.497, 0.54, 0.261
LEAK = 0.008
EFFECTS = (
    _single("veiling_glare", 1101, {"gamma": 0.01}, {"gamma": 0.01}, ("ambient_light",)),
    _single("read_noise", 1102, {"extra_e": 0.7}, {"sigma_e": hypot(READ_E, 0.7)}),
    _single("conversion_gain", 1103, {"gain_dn_per_e": 0.1727}, {"gain_dn_per_e": 0.1727}),
    _single("dark_current", 1104, {"extra_e_per_s": 0.1}, {"rate_e_per_s": DARK_E_PER_S + 0.1}),
    _single("defocus", 1105, {"z_um": 3.0}, {"z_um": 3.0}),
    _single("charge_diffusion", 1106, {"sigma_px": 0.15}, {"sigma_px": 0.15}, ("pixel_aperture",)),
    _single(
        "spectral_crosstalk",
        1107,
        {"leak": LEAK},
        {
            "eps_rg": LEAK / (1 - LEAK),
            "eps_gr": LEAK / 2 / (1 - LEAK),
            "eps_gb": LEAK / 2 / (1 - LEAK),
            "eps_bg": LEAK / (1 - LEAK),
            "eps_rb": 0.0,
            "eps_br": 0.0,
        },
    ),
    _single("microlens", 1108, {"loss_rgb": (0.05, 0.05, 0.05)}, {}, ("cos4",), "microlens_common"),
    _single(
        "microlens",
        1109,
        {"loss_rgb": (0.03, 0.015, 0.0)},
        {"m_red": 0.03, "m_green": 0.015, "m_blue": 0.0},
        (),
        "microlens_colour",
    ),
    _single("nonlinearity", 1110, {"a": 0.012}, {"a": 0.012}),
    _single("black_level", 1111, {"offset_dn": 0.08}, {"offset_dn": 0.08}, ("wrong_black_tag",)),
    _single("prnu", 1112, {"extra": 0.0025}, {"sigma_percent": hypot(PRNU_PERCENT, 0.25)}),
    _single("dsnu", 1113, {"extra_e": 0.3}, {"sigma_e": hypot(DSNU_E, 0.3)}),
    _single("temporal_row_noise", 1114, {"sigma_dn": 0.045}, {"sigma_dn": 0.045}),
    _single("column_fpn", 1115, {"sigma_dn": 0.035}, {"sigma_dn": 0.035}),
    _single("brighter_fatter", 1116, {"a_per_e": 1.5e-6}, {"a_per_e": 1.5e-6}),
    _single("exposure_time", 1117, {"late_s": 8e-6}, {"offset_ms": 0.008}),
    _single("vignetting", 1118, {"onset": 0.6, "corner_loss": 0.06}, {}),
    _single("gr_gb_imbalance", 1119, {"share": 0.001}, {"center": 0.001, "corner": 0.0}),
    _single("hot_pixels", 1120, {"fraction": 0.002, "mean_e_per_s": 100.0}, {"fraction": 0.002}),
    _single("field_curvature", 1121, {"sag_um": 4.0}, {"kappa_um": 4.0}),
)
# strangers until the catalogue learnt of them; grains at three places, columns in groups of eight: forms of their own
FORMS = (
    _single("dust", 1301, {"loss": 0.008, "points": (2, 6, 9)}, {}),
    Trial("column_group_gain", 1302, {"column_group_gain": {"share": 0.0008}}, "effect", "alternating_columns"),
)
NULLS = tuple(Trial(f"null_{i}", 1200 + i, kind="null") for i in range(1, 9))
OUTSIDERS = (
    Trial("faded_patch", 1303, {"faded_patch": {"patch": "orange", "loss": 0.006}}, "outsider"),
    Trial("light_leak", 1304, {"light_leak": {"e_per_s": 600.0, "x": -0.45, "y": 0.4}}, "outsider"),
)
TRIALS = {trial.name: trial for trial in (*EFFECTS, *FORMS, *NULLS, *OUTSIDERS)}
