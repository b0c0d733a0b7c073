"""Effects of the catalogue in forms of their own: what is hidden, and how strongly it is met in practice."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot
from typing import Any

from .concealed import CHARTS, DARK, EDGES, FIELD, OWN, Concealed, Values
from .types import Camera


def _same(**names: str) -> Values:
    return lambda parameters, camera: {own: float(parameters[theirs]) for own, theirs in names.items()}


def _quadrature(own: str, theirs: str, constant: str, scale: float = 1.0) -> Values:
    return lambda p, camera: {own: scale * hypot(getattr(camera, constant), p[theirs])}


def _crosstalk(p: Mapping[str, Any], camera: Camera) -> dict[str, float]:
    leak = p["leak"]
    near, far = leak / (1 - leak), leak / 2 / (1 - leak)
    return {"leak": leak, "eps_rg": near, "eps_gr": far, "eps_gb": far, "eps_bg": near, "eps_rb": 0.0, "eps_br": 0.0}


def _effect(key: str, amplitude: Mapping[str, Any], practice: str, **more: Any) -> Concealed:
    return Concealed(key, "effect", more.pop("name", key), amplitude, practice, **more)


PAPER = "Lyu et al. (2022), sensor table"
EFFECTS = (
    _effect(
        "veiling_glare",
        {"gamma": 0.01},
        "ISO 9358 reports 0.5 to 3 % for phone lenses",
        values=_same(gamma="gamma"),
        also=("ambient_light",),
    ),
    _effect(
        "read_noise",
        {"extra_e": 0.7},
        "a quarter of the 2.95 e- of " + PAPER,
        seen=DARK,
        power=2,
        values=_quadrature("sigma_e", "extra_e", "read_e"),
    ),
    _effect(
        "conversion_gain",
        {"gain_dn_per_e": 0.012},
        "1.2 %: photon transfer of one specimen against the data sheet",
        values=_same(gain_dn_per_e="gain_dn_per_e"),
    ),
    _effect(
        "dark_current",
        {"extra_e_per_s": 0.1},
        "5 K warmer than " + PAPER,
        seen=DARK,
        values=lambda p, c: {"rate_e_per_s": c.dark_e_per_s + p["extra_e_per_s"]},
    ),
    _effect(
        "spectral_crosstalk",
        {"leak": 0.008},
        "0.8 % to the four neighbours, small pixels",
        values=_crosstalk,
        also_small=("channel_gain", "spd_mismatch"),
    ),
    _effect(
        "microlens",
        {"loss_rgb": (0.03, 0.015, 0.0)},
        "color shading of 3 % red to blue",
        seen=FIELD,
        values=lambda p, c: dict(zip(("m_red", "m_green", "m_blue"), p["loss_rgb"], strict=True)),
    ),
    _effect("nonlinearity", {"a": 0.012}, "EMVA 1288 linearity errors of 0.1 to 1 %", values=_same(a="a")),
    _effect(
        "black_level",
        {"offset_dn": 0.08},
        "optical-black clamp, a tenth of a code",
        seen=DARK,
        values=_same(offset_dn="offset_dn"),
        also=("wrong_black_tag",),
    ),
    _effect(
        "prnu",
        {"extra": 0.0025},
        "half of the 0.54 % of " + PAPER,
        power=2,
        values=_quadrature("sigma_percent", "extra", "prnu", 100.0),
    ),
    _effect(
        "dsnu",
        {"extra_e": 0.3},
        "two thirds of the 0.5 e- of " + PAPER,
        seen=DARK,
        power=2,
        values=_quadrature("sigma_e", "extra_e", "dsnu_e"),
    ),
    _effect(
        "temporal_row_noise",
        {"sigma_dn": 0.045},
        "a tenth of the read noise, the limit of visibility",
        seen=DARK,
        power=2,
        values=_same(sigma_dn="sigma_dn"),
    ),
    _effect(
        "column_fpn", {"sigma_dn": 0.035}, "a tenth of the read noise", seen=DARK, power=2, values=_same(sigma_dn="sigma_dn")
    ),
    _effect("row_fpn", {"sigma_dn": 0.035}, "a tenth of the read noise", seen=DARK, power=2, values=_same(sigma_dn="sigma_dn")),
    _effect("brighter_fatter", {"a_per_e": 1.5e-6}, "1 % less variance at full well", values=_same(a_per_e="a_per_e")),
    _effect(
        "exposure_time", {"late_s": 8e-6}, "one row of a rolling shutter", values=lambda p, c: {"offset_ms": 1e3 * p["late_s"]}
    ),
    _effect("vignetting", {"corner_loss": 0.06}, "a front rim that clips 6 % in the corner", seen=FIELD, fixed={"onset": 0.6}),
    _effect(
        "gr_gb_imbalance", {"share": 0.001}, "0.2 % between the greens", values=lambda p, c: {"center": p["share"], "corner": 0.0}
    ),
    _effect(
        "uneven_dark_current",
        {"sd_e_per_s": 0.13},
        "half the rate of " + PAPER,
        name="dark_current_nonuniformity",
        seen=DARK,
        power=2,
        values=_same(sigma_e_per_s="sd_e_per_s"),
    ),
    _effect("hot_pixels", {"fraction": 0.002}, OWN, seen=DARK, fixed={"mean_e_per_s": 100.0}, values=_same(fraction="fraction")),
    _effect(
        "light_nonuniformity",
        {"near": 0.2},
        "a lamp five half diagonals away",
        seen=FIELD,
        power=2,
        fixed={"x": 0.8, "y": 0.3},
        also_small=("decenter",),
    ),
    _effect(
        "ambient_light",
        {"radiance": 2e-5},
        "stray light of 1 % of the sphere",
        values=_same(radiance="radiance"),
        also=("veiling_glare",),
    ),
    _effect("cos4", {"nearer": 0.06}, "an exit pupil 6 % nearer than the focal length", seen=FIELD, also=("microlens",)),
    _effect(
        "decenter",
        {"x_mm": 0.05, "y_mm": 0.02},
        "lens 50 um beside the middle: assembly tolerance",
        seen=FIELD,
        also_small=("light_nonuniformity",),
    ),
    _effect("ghost", {"gamma": 0.004}, "two uncoated reflections of 4 % would give 0.16 %", seen=FIELD, fixed={"reach": 0.5}),
    _effect("etalon_ripple", {"reflectance": 0.004}, "a coated cover glass", seen=FIELD, fixed={"glass_um": 4.0}),
    _effect(
        "cfa_angle_shift", {"inverse_index2": 0.08}, "a shift of several nm at 40 deg", seen=FIELD, also_small=("microlens",)
    ),
    _effect(
        "channel_gain",
        {"d_red": 0.03, "d_blue": -0.02},
        "lots of color filters differ by some percent",
        values=_same(d_red="d_red", d_blue="d_blue"),
        also_small=("spectral_crosstalk", "spd_mismatch"),
    ),
    _effect("flicker", {"sigma": 0.005}, "1 % of mains ripple left over an exposure", power=2, values=_same(sigma="sigma")),
    _effect("pdaf_pixels", {"loss": 0.08}, "shielded pixels corrected to 8 %", values=_same(loss="loss")),
    _effect("lag", {"fraction": 0.002}, "0.2 % left behind", seen=DARK, values=_same(fraction="fraction")),
    _effect("temperature_drift", {"rise_e_per_s": 0.15}, "2 K in eight frames", seen=DARK),
    _effect("amp_glow", {"e_per_s": 2.0}, OWN, seen=DARK),
    _effect(
        "rts",
        {"step_e": 12.0},
        "0.2 % of the pixels with steps of 12 e-",
        seen=DARK,
        power=2,
        fixed={"fraction": 0.002},
        values=_same(fraction="fraction"),
    ),
    _effect("gain_knee", {"slope": 0.02}, "dual gain matched to 2 %", fixed={"knee_e": 2500.0}),
    _effect(
        "full_well",
        {"well_e": -0.2},
        "4800 e-: the pixel is full before the converter ends",
        scaled=False,
        values=_same(well_e="well_e"),
    ),
    _effect(
        "quantization",
        {"step_dn": 2.0},
        "a converter that lost its last bit",
        seen=DARK,
        scaled=False,
        values=_same(step_dn="step_dn"),
    ),
    _effect("linearization_table", {"log": 0.04}, "a table that was not undone", also=("nonlinearity",)),
    _effect("gain_map_applied", {"share": 0.15}, "a seventh of the fall-off taken back", seen=FIELD, also=("cos4",)),
    _effect("digital_gain", {"gain": 0.01}, OWN, fixed={"above_s": 0.06}, values=_same(gain="gain")),
    _effect(  # along rows and then columns: of w the nearest get w (1 - 2 w), the diagonal ones w^2
        "raw_filtering",
        {"weight": 0.04},
        OWN,
        seen=DARK,
        values=lambda p, c: {"weight": p["weight"] * (1 - 2 * p["weight"]), "diagonal": p["weight"] / (1 - 2 * p["weight"])},
    ),
    _effect(
        "wrong_black_tag",
        {"codes_more": 1.0},
        "one code",
        seen=DARK,
        scaled=False,
        values=_same(pedestal_dn="codes_more"),
        also=("black_level",),
    ),
    _effect(
        "black_clip",
        {},
        "codes below black cut off",
        seen=DARK,
        scaled=False,
        fixed={"all_pixels": True},
        values=lambda p, c: {"strength": 1.0},
    ),
    _effect(
        "defocus", {"z_um": 3.0}, "autofocus of a phone stops within some um", seen=EDGES, power=2, values=_same(z_um="z_um")
    ),
    _effect(
        "charge_diffusion",
        {"sigma_px": 0.15},
        "0.2 um of a 1.4 um pixel",
        seen=EDGES,
        power=2,
        values=_same(sigma_px="sigma_px"),
        also=("pixel_aperture",),
    ),
    _effect(
        "pixel_aperture",
        {"width_px": 0.08},
        "light reaches 8 % into the neighbours",
        seen=EDGES,
        values=_same(width_px="width_px"),
        also=("charge_diffusion",),
    ),
    # a smaller pupil narrows the cone out of focus as well, which the catalogue's number leaves to the aperture: no common value
    _effect("diffraction", {"f_number": 0.05}, "a pupil 5 % smaller than stated", seen=EDGES),
    _effect("field_curvature", {"sag_um": 4.0}, "depth of focus at F/1.7 is 2 um", seen=EDGES, values=_same(kappa_um="sag_um")),
    _effect("sensor_tilt", {"x_deg": 0.05, "y_deg": -0.03}, "active alignment reaches 0.05 deg", seen=EDGES),
    _effect("axial_color", {"primary_um": 1.5, "secondary_um": 0.5}, "plastic lenses: a few um", seen=EDGES),
    # odd about the focus along the radius and across it, even aslant: between the first and the second power
    _effect("astigmatism", {"gap_um": 3.0}, OWN, seen=EDGES, power=1.5),
    _effect("spherical", {"rms_waves": 0.04}, "Marechal's limit is 0.07", seen=EDGES, values=_same(rms_waves="rms_waves")),
    _effect(  # counts the wave's path the other way: its flare points outwards
        "coma",
        {"rms_waves": 0.06},
        "Marechal's limit is 0.07",
        seen=EDGES,
        values=lambda p, c: {"rms_waves": -p["rms_waves"]},
    ),
    _effect("motion_blur", {"px": 0.5}, OWN, seen=EDGES, power=2, fixed={"deg": 0.0}, values=_same(length_px="px")),
    _effect(
        "lateral_color",
        {"red_px": 0.3, "blue_px": -0.4},
        "phone lenses: under a pixel",
        seen=EDGES,
        values=_same(red_px="red_px", blue_px="blue_px"),
    ),
    _effect("distortion", {"corner_px": 3.0}, OWN, seen=EDGES, values=_same(k1_px="corner_px")),
    _effect("black_reflectance", {"rho": 0.01}, "black paper reflects 4 to 6 %", seen=EDGES, values=_same(rho_b="rho")),
    _effect(
        "chart_tilt",
        {"a": 0.02, "b": 0.01},
        "a chart 1 deg askew half a metre from the lamp",
        seen=CHARTS,
        values=_same(a="a", b="b"),
    ),
    _effect("position_scale", {"fall": 0.03}, OWN, seen=CHARTS),
    _effect("gloss", {"level": 0.004}, "4 % Fresnel, a tenth of it into the lens", seen=CHARTS, values=_same(level="level")),
    _effect("fluorescence", {"share": 0.05}, "brightened paper", seen=CHARTS),
    _effect("spd_mismatch", {"warmer": 0.02}, "a lamp 100 K off", seen=CHARTS),
    _effect("filter_lot", {"red": 0.015, "green": -0.01, "blue": 0.02}, "some nm elsewhere", name="qe_shift", seen=CHARTS),
    _effect("ir_leak", {"eps": 0.01}, "an infrared filter that lets 1 % through", seen=CHARTS),
    _effect(
        "inter_pixel_capacitance",
        {"share": 0.003},
        "0.3 % to each neighbor",
        name="interpixel_capacitance",
        values=_same(alpha="share"),
    ),
    _effect(  # more on odd columns; the catalogue's gain is that of the first of each pair
        "alternating_columns", {"share": 0.0008}, OWN, values=lambda p, c: {"gain": -p["share"], "offset_dn": 0.0}
    ),
    _effect("amplifier_crosstalk", {"share": 0.003}, OWN, values=_same(share="share")),
)
