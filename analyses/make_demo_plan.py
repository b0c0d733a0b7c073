# %% [markdown]
# Question: what should the embedded demonstration campaign look like?
#
# Writes `data/demo/plan.toml`, `lights.csv` and `chart.csv`: two measurement sessions of a small laboratory (darks,
# flats, field flats, slanted edges through focus, a 24-patch chart under three lights), with the priors of everything
# that laboratory does not know exactly.  All spectra are the project's own formulas; exposure times follow from the
# nominal camera, so that the brightest flat stands at about 90 % of the range.
#
# Run: `python analyses/make_demo_plan.py` (a few seconds).  The files are committed; run it again after a change.

# %%
from __future__ import annotations

from pathlib import Path

import numpy as np

import isetval
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.core.campaign import Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.scenes.rendered.own_spectra import chart_reflectances, lamp

HERE = Path(__file__).resolve().parent.parent / "data" / "demo"
NM = np.arange(390.0, 711.0, 5.0)
SESSIONS = ("A", "B")
CENTER = (1464, 1968)
DARK_S = (0.001, 0.5, 4.0)
FLAT_E = (60, 200, 600, 1500, 3000, 4500)
LEVELS = (0.2, 0.6)
FIELD = [(0, 0), (0.55, 0), (-0.55, 0), (0, 0.6), (0, -0.6), (0.97, 0.97), (-0.97, 0.97), (0.97, -0.97), (-0.97, -0.97)]
EDGE_POINTS = {"center": (0.0, 0.0), "outer": (-0.75, -0.8)}
EDGE_ANGLES = {"vertical": 5.2, "horizontal": -4.6}
FOCUS_UM = {
    ("center", "vertical"): (-8, 0, 8),
    ("center", "horizontal"): (0,),
    ("outer", "vertical"): (0, 8),
    ("outer", "horizontal"): (0,),
}
NOTES = "own formula of the project, see analyses/make_demo_plan.py and isetval/scenes/own_spectra.py; licence BSD-3-Clause"


# %%
def planck(kelvin: float) -> np.ndarray:
    """Relative spectral radiance of a black body (second radiation constant 1.438777e-2 m K)."""
    metres = NM * 1e-9
    curve = metres**-5 / (np.exp(1.438777e-2 / (metres * kelvin)) - 1)
    return curve / curve.max()


def lights() -> dict[str, np.ndarray]:
    """Three lights: a warm white LED (the sphere too), a black body at 6500 K, narrow bands as of a tube."""
    tube = sum(a * np.exp(-0.5 * ((NM - c) / w) ** 2) for a, c, w in ((1, 546, 7), (0.8, 611, 8), (0.5, 436, 7), (0.25, 490, 12)))
    return {"sphere": lamp(0.002).at(NM), "sky": 0.0013 * planck(6500.0), "tube": 0.0035 * np.asarray(tube)}


def write_spectra(name: str, columns: dict[str, np.ndarray], unit: str) -> None:
    """A CSV file with its origin in remarks."""
    rows = [f"# {unit}; {NOTES}", ",".join(["wavelength_nm", *columns])]
    rows += [",".join([f"{nm:g}", *(f"{c[i]:.6g}" for c in columns.values())]) for i, nm in enumerate(NM)]
    (HERE / name).write_text("\n".join(rows) + "\n", encoding="utf-8")


HERE.mkdir(exist_ok=True)
write_spectra("lights.csv", lights(), "spectral radiance of a perfect white in the light, W/(sr m2 nm)")
write_spectra("chart.csv", {k: v.at(NM) for k, v in chart_reflectances().items()}, "reflectance")

# %% Electrons per second of green pixels in the middle, under the sphere: sets the exposure times.
model = isetval.load_model(HERE.parent / "pixel4a" / "camera.toml")
probe = Shot("probe", "flat", exposure=Exposure(0.01), light="sphere", window=(*CENTER, 16, 16))
sphere = Light("sphere", Spectrum(NM, lights()["sphere"]))
GREEN_E_PER_S = float(mean_electrons(model, ShotSetup(probe, sphere, {}))[..., 0::2, 1::2].mean()) / 0.01
print(f"green electrons per second under the sphere: {GREEN_E_PER_S:.0f}")


def seconds(electrons: float) -> float:
    """Exposure time for a number of green electrons, to three digits."""
    return float(f"{electrons / GREEN_E_PER_S:.3g}")


# %%
HEAD = """\
# The embedded demonstration campaign: two measurement sessions of a small laboratory, planned for the Pixel 4a.
# A plan is a campaign without captures: `isetval simulate MODEL plan.toml -o DIR` shoots it.
# Written by analyses/make_demo_plan.py; every number is the project's own choice.

name = "demo"
camera = "isetval:pixel4a/camera.toml"     # the nominal model: gives the sensor that windows refer to

# --- lights: radiance of a perfect white in the light (or of the sphere looked into), W/(sr m2 nm) ---
"""
NUISANCES = [
    ("light_level", 0.02, "relative", "set-up", '["flat", "edge", "chart"]', "level of the light in every set-up: 2 %"),
    ("light_level", 0.001, "relative", "frame", '["flat", "edge", "chart"]', "its flicker from frame to frame: 0.1 %"),
    ("light_tilt_x", 0.005, "relative", "measurement session", '["flat"]', "evenness of the sphere across the field"),
    ("light_tilt_y", 0.005, "relative", "measurement session", '["flat"]', "and down the field"),
    ("light_radial", 0.005, "relative", "measurement session", '["flat"]', "and towards the corners"),
    ("spectrum_tilt", 0.02, "relative per 100 nm", "campaign", "", "how well the spectra are known (each light)"),
    ("focus_um", 0.5, "um", "measurement session", '["edge"]', "zero of the focus scale"),
    ("edge_shift_px", 0.5, "px", "set-up", '["edge"]', "place of the edge"),
    ("edge_angle_deg", 0.2, "deg", "set-up", '["edge"]', "its angle"),
    ("dark_reflectance", 0.002, "reflectance", "measurement session", '["edge"]', "the black side of the edge"),
    ("target_tilt_x", 0.005, "relative", "set-up", '["chart"]', "evenness of the light over the chart"),
    ("target_tilt_y", 0.005, "relative", "set-up", '["chart"]', "and down the chart"),
]


def nuisance(parameter, sigma, unit, scope, roles, remark, light=""):
    lines = [
        "[[nuisance]]",
        f"# {remark}",
        f'parameter = "{parameter}"',
        f"sigma = {sigma}",
        f'unit = "{unit}"',
        f'scope = "{scope}"',
    ]
    return "\n".join([*lines, *([f"roles = {roles}"] if roles else []), *([f'lights = ["{light}"]'] if light else [])]) + "\n"


def nuisances() -> list[str]:
    out = ["# --- what the laboratory does not know exactly: one standard deviation each, refitted under every hypothesis ---\n"]
    for row in NUISANCES:
        if row[0] == "spectrum_tilt":
            out += [nuisance(*row[:5], f"how well the spectrum of the {name} is known", light=name) for name in lights()]
        else:
            out.append(nuisance(*row))
    return out


def targets() -> list[str]:
    out = ["# --- targets: two slanted edges and a chart; boxes are [row0, row1, col0, col1] in the window ---\n"]
    for orientation, angle in EDGE_ANGLES.items():
        out.append(
            f'[target.edge_{orientation}]\nkind = "edge"\norientation = "{orientation}"\nangle_deg = {angle}\n'
            "dark_reflectance = 0.05\nbright_reflectance = 0.8\nsurround = 0.4\n"
        )
    boxes = []
    for i, name in enumerate(chart_reflectances()):
        row, col = 6 + 28 * (i // 6), 6 + 28 * (i % 6)
        boxes.append(f'  {{ name = "{name}", box = [{row}, {row + 24}, {col}, {col + 24}], reflectance = "{name}" }},')
    patches = "\n".join(["patch = [", *boxes, "]"])
    return [*out, f'[target.chart]\nkind = "chart"\nreflectance = "chart.csv"\nsurround = 0.1\nmargin_px = 3\n{patches}\n']


# %%
def shot(name: str, role: str, session: str, setup: str, window, exposure_s: float, frames: int, **more) -> str:
    lines = ["[[shot]]", f'name = "{name}"', f'role = "{role}"', f'measurement_session = "{session}"', f'setup = "{setup}"']
    lines += [f"exposure_s = {exposure_s!r}", f"window = {list(window)}", f"frames = {frames}"]
    lines += [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in more.items()]
    return "\n".join(lines) + "\n"


def window_at(x: float, y: float, rows: int, cols: int) -> tuple[int, int, int, int]:
    row = (model.sensor.rows - rows) / 2 * (1 + y)
    col = (model.sensor.cols - cols) / 2 * (1 + x)
    return (2 * round(row / 2), 2 * round(col / 2), rows, cols)


def flats(s: str) -> list[str]:
    middle = (*CENTER, 80, 80)
    light = {"light": "sphere"}
    out = [shot(f"{s}_dark{i}", "dark", s, f"{s}_dark", middle, t, 5) for i, t in enumerate(DARK_S)]
    out += [shot(f"{s}_flat{i}", "flat", s, f"{s}_series", middle, seconds(e), 3, **light) for i, e in enumerate(FLAT_E)]
    time_s = seconds(3500)
    for i, level in enumerate(LEVELS):
        out.append(shot(f"{s}_level{i}", "flat", s, f"{s}_level{i}", middle, time_s, 3, **light, light_level=level))
    again = {"light_level": LEVELS[1], "repeat_of": f"{s}_level1"}
    out.append(shot(f"{s}_level1r", "flat", s, f"{s}_level1r", middle, time_s, 3, **light, **again))
    for i, point in enumerate(FIELD):
        out.append(shot(f"{s}_field{i}", "flat", s, f"{s}_field", window_at(*point, 64, 64), seconds(3500), 2, **light))
    return out


def edges(s: str) -> list[str]:
    out = []
    for point, (x, y) in EDGE_POINTS.items():
        for orientation in EDGE_ANGLES:
            setup = f"{s}_edge_{point}_{orientation[0]}"
            more = {"light": "sphere", "target": f"edge_{orientation}"}
            for focus in FOCUS_UM[point, orientation]:
                name = f"{setup}_{'m' if focus < 0 else 'p' if focus > 0 else 'z'}{abs(focus)}"
                out.append(shot(name, "edge", s, setup, window_at(x, y, 80, 80), seconds(4200), 1, **more, focus_um=float(focus)))
    again = {"light": "sphere", "target": "edge_vertical", "focus_um": 0.0, "repeat_of": f"{s}_edge_center_v_z0"}
    out.append(shot(f"{s}_edge_center_v_r", "edge", s, f"{s}_edge_center_vr", window_at(0, 0, 80, 80), seconds(4200), 1, **again))
    return out


def charts(s: str) -> list[str]:
    window = window_at(-0.05, 0.03, 120, 176)
    return [
        shot(f"{s}_chart_{light}", "chart", s, f"{s}_chart_{light}", window, seconds(4500), 1, light=light, target="chart")
        for light in lights()
    ]


# %%
text = HEAD + "\n".join(f'[light.{name}]\nradiance = "lights.csv"\ncolumn = "{name}"\n' for name in lights()) + "\n"
parts = [*nuisances(), *targets()]
for session in SESSIONS:
    parts.append(f"# --- measurement session {session} ---\n")
    parts += [*flats(session), *edges(session), *charts(session)]
(HERE / "plan.toml").write_text(text + "\n".join(parts), encoding="utf-8")
plan = isetval.load_campaign(HERE / "plan.toml")
frames = sum(s.frames for s in plan.shots)
print(f"{len(plan.shots)} shots, {frames} frames in sessions {', '.join(plan.sessions)}")
