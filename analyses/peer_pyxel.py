# %% [markdown]
# # Pyxel's calibration beside the detective, on the same frames
#
# Question: shown frames of a camera in which one constant is hidden to be wrong, does calibrating one named parameter at a
# time (Pyxel, the European Space Agency's detector simulator) and taking the one with the best fitness name it?
# Data: a dark and five flats of one exposure time, shot by another camera (`isetval.testing.foreign_camera`) with one of its
# constants at four times the size of practice (the full well at that of practice).  `isetval.diagnose` gets all frames;
# Pyxel, whose detector is monochrome, the Gr pixels of one frame of each level, with the nominal constants and the mean
# electrons told.
# Result: one row per hidden effect: what each names, and the value of the right parameter in each.
# Run time: about 20 s of CPU per hidden effect and parameter (six by six), of which 4 are Pyxel's start.
#
#     python analyses/peer_pyxel.py --pyxel /path/to/python/with/pyxel-sim/and/pygmo -o reports/peer_pyxel.json
#     python analyses/peer_pyxel.py --table reports/peer_pyxel.json

# %%
from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import isetval
from isetval.testing.foreign_camera import plan_file, scene, spectra
from isetval.testing.foreign_camera.camera_file import nominal_camera
from isetval.testing.foreign_camera.campaign import light_scales, write_frames
from isetval.testing.foreign_camera.concealed_effects import EFFECTS
from isetval.testing.foreign_camera.sensor import specimen_of

HERE = Path(__file__).resolve().parent
NOMINAL = HERE.parent / "data" / "pixel4a"
SIZE, FRAMES, STRENGTH, SEED = 80, 8, 4.0, 5
LEVELS = (0.004, 0.01, 0.02, 0.035, 0.058)  # of a white in the plan's light: 360 to 5200 e- in a second
PIXEL_UM, CHARGE_E, VOLT_PER_DN = 1.4, 1.602176634e-19, 1e-3
# Pyxel's parameters: key, the nominal value of a camera in its units, and the range searched around it.  Its converter cuts off
# where the camera rounds: half a code is added to the black level.
FREED = {
    "conversion_gain": ("detector.characteristics.charge_to_volt_conversion", lambda c: c.gain * VOLT_PER_DN, (0.7, 1.4)),
    "read_noise": (
        "pipeline.charge_measurement.output_node_noise.arguments.std_deviation",
        lambda c: c.read_e * c.gain * VOLT_PER_DN,
        (0.0, 5.0),
    ),
    "dark_current": (
        "pipeline.charge_generation.dark_current.arguments.figure_of_merit",
        lambda c: c.dark_e_per_s * CHARGE_E * 1e9 / (PIXEL_UM * 1e-4) ** 2,
        (0.0, 20.0),
    ),
    "prnu": (
        "pipeline.charge_collection.fixed_pattern_noise.arguments.fixed_pattern_noise_factor",
        lambda c: 4 * c.prnu,  # its pattern is q (1 + e^(q f z)), q the quantum efficiency, here 1/2: of mean 1 and spread f/4
        (0.01, 10.0),
    ),
    "black_level": (
        "pipeline.charge_measurement.dc_offset.arguments.offset",
        lambda c: (c.black + 0.5) * VOLT_PER_DN,
        (0.9, 1.1),
    ),
    "full_well": ("detector.characteristics.full_well_capacity", lambda c: c.well_e, (0.5, 1.5)),
}


def main(words=None):
    """Run the trials that the command line asks for and print the table."""
    parser = argparse.ArgumentParser(description="Pyxel's calibration and isetval.diagnose on the same frames.")
    parser.add_argument("--pyxel", help="Python in which pyxel-sim and pygmo are installed")
    parser.add_argument("--table", type=Path, help="no trials: print the table of a JSON file that was written before")
    parser.add_argument("--generations", type=int, default=12, help="of Pyxel's search (default: %(default)s)")
    parser.add_argument("--population", type=int, default=12, help="of Pyxel's search (default: %(default)s)")
    parser.add_argument("--names", default=",".join(FREED), help="what is hidden (default: %(default)s)")
    parser.add_argument("-o", "--output", type=Path, help="JSON file")
    options = parser.parse_args(words)
    if options.table:
        print("\n".join(table(json.loads(options.table.read_text(encoding="utf-8"))["rows"])))
        return
    if not options.pyxel:
        parser.error("name the Python that runs Pyxel with --pyxel, or a written file with --table")
    rows = [trial(name, options) for name in options.names.split(",")]
    print("\n".join(table(rows)))
    if options.output:
        options.output.write_text(
            json.dumps({"strength": STRENGTH, "seed": SEED, "rows": rows}, indent=1) + "\n", encoding="utf-8"
        )


# %% one campaign, both answers
def trial(name, options):
    """What Pyxel and isetval say of frames with one constant hidden."""
    concealed = next(c for c in EFFECTS if c.key == name)
    nominal = nominal_camera(NOMINAL / "camera.toml", str(NOMINAL / "qe.csv"))
    parameters = concealed.parameters(STRENGTH if concealed.scaled else 1.0, nominal)
    camera = specimen_of(nominal, SEED, {name: parameters})
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        plan = write_plan(folder, nominal)
        codes = [plan_file.shoot_shot(plan, camera, i, SEED) for i in range(len(plan.shots))]
        for planned, frames in zip(plan.shots, codes, strict=True):
            write_frames(folder, planned, frames, camera)
        model, campaign = isetval.load_model(folder / "camera.toml"), isetval.load_campaign(folder)
        found = isetval.diagnose(model, campaign, with_next_captures=False)
        electrons = [float(scene.mean_electrons(nominal, p.place, plan.lights)[::2, 1::2].mean()) for p in plan.shots]
        fits = {own: pyxel(folder, own, nominal, codes, electrons, options) for own in FREED}
    best = min(fits, key=lambda own: fits[own]["fitness"])
    named = {e.name: {key: [p.value, p.sigma] for key, p in e.parameters.items()} for e in found.effects}
    truth = concealed.truth(parameters, nominal)
    return {"hidden": name, "truth": truth, "pyxel": fits, "pyxel_names": best, "isetval": found.verdict, "isetval_names": named}


def write_plan(folder, nominal):
    """A dark and flats of one second in the sphere's light; read back by the foreign camera."""
    grid = spectra.CSV_NM
    radiance = light_scales(nominal)["sphere"] * spectra.LIGHTS["sphere"](grid)
    spectra.write_table(folder / "sphere.csv", {"wavelength_nm": grid, "radiance": radiance}, "W/(sr m2 nm)")
    row, col = (nominal.rows - SIZE) // 4 * 2, (nominal.cols - SIZE) // 4 * 2
    for file in ("camera.toml", "qe.csv"):
        (folder / file).write_bytes((NOMINAL / file).read_bytes())
    lines = ['name = "peer"', 'camera = "camera.toml"', "[light.sphere]", 'radiance = "sphere.csv"']
    for i, level in enumerate((0.0, *LEVELS)):
        role, light = ("flat", f'light = "sphere"\nlight_level = {level}') if level else ("dark", "")
        files = ", ".join(f'"s{i}_{k}.dng"' for k in range(FRAMES))
        lines += [
            f'[[shot]]\nname = "s{i}"\nrole = "{role}"\nexposure_s = 1.0\nwindow = [{row}, {col}, {SIZE}, {SIZE}]',
            f"frames = {FRAMES}\nfiles = [{files}]\n{light}",
        ]
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return plan_file.read_plan(folder, nominal)


def pyxel(folder, own, nominal, codes, electrons, options):
    """Fitness and value of Pyxel's champion with one parameter freed, the value in units of its nominal one."""
    key, value, bounds = FREED[own]
    targets = []
    for i, frames in enumerate(codes):
        targets.append(str(folder / f"target_{i}.npy"))
        np.save(targets[-1], frames[0, ::2, 1::2].astype(float))
    at_nominal = {name: float(of(nominal)) for name, (_, of, _) in FREED.items()}
    job = {
        "rows": SIZE // 2, "cols": SIZE // 2, "targets": targets, "levels": [2 * e for e in electrons], "key": key, "seed": SEED,
        "generations": options.generations, "population": options.population, "pixel_um": PIXEL_UM,
        "bounds": [value(nominal) * b for b in bounds], "volt_per_e": at_nominal["conversion_gain"],
        "full_well_e": at_nominal["full_well"], "figure_of_merit": at_nominal["dark_current"], "prnu": at_nominal["prnu"],
        "offset_v": at_nominal["black_level"], "noise_v": at_nominal["read_noise"],
    }  # fmt: skip
    said, answer = folder / f"{own}.json", folder / f"{own}_answer.json"
    said.write_text(json.dumps(job), encoding="utf-8")
    words = [options.pyxel, str(HERE / "peers" / "pyxel_calibration.py"), str(said), str(answer)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder)
    if not answer.is_file():
        raise SystemExit(f"Pyxel gave no answer for {own}: {done.stderr.strip().splitlines()[-1:]}")
    found = json.loads(answer.read_text(encoding="utf-8"))
    return found | {"of_nominal": found["value"] / value(nominal)}


# %% the table
def table(rows):
    """Lines: hidden, what Pyxel names with its fitness against that of the right parameter, what isetval names."""
    out = [f"{'hidden':16} {'Pyxel names':16} {'fitness':>10} {'of the right':>12}  isetval"]
    for row in rows:
        fits, best = row["pyxel"], row["pyxel_names"]
        named = ", ".join(row["isetval_names"]) or "nothing"
        out.append(
            f"{row['hidden']:16} {best:16} {fits[best]['fitness']:10.4g} {fits[row['hidden']]['fitness']:12.4g}  "
            f"{row['isetval']}: {named}"
        )
    right = sum(row["pyxel_names"] == row["hidden"] for row in rows)
    ours = sum(list(row["isetval_names"]) == [row["hidden"]] for row in rows)
    return [*out, f"right: Pyxel {right} of {len(rows)}, isetval {ours} of {len(rows)}"]


if __name__ == "__main__":
    main()
