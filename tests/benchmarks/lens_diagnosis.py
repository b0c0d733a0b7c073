"""What a diagnosis costs with a lens file in the light path, over one with `aperture`: the same plan, each with its own captures.

    python tests/benchmarks/lens_diagnosis.py

The camera with `aperture` has `defocus` beside it, so that the plan's errors of focus act in both.  Both hide the same effect
(`read_noise` of 3.6 e-), so that both searches fit and confirm a name.  Every run is a process of its own with an empty store, so
that nothing is kept from the other.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from timing import Row, table_lines

KINDS = ("aperture", "ray_transfer")
HIDDEN_E, LENS = 3.6, "isetval:lens/default_lens.json"
GOAL = 1.5


def plan(sensor):
    """Darks, flats over the field, and edges at two places and two foci."""
    from isetval.core.campaign import Campaign, Light, Nuisance, Shot
    from isetval.core.scene import EdgeTarget, Spectrum
    from isetval.core.sensor import Exposure

    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    middle = (1480, 1984, 64, 64)
    shots = [Shot(f"dark{t:g}", "dark", exposure=Exposure(time_s=t), window=middle, frames=4) for t in (0.01, 0.2)]
    for t in (0.004, 0.012, 0.03):
        shots.append(Shot(f"flat{t:g}", "flat", "center", exposure=Exposure(t), light="white", window=middle, frames=2))
    for i, at in enumerate(((1480, 60), (40, 60), (700, 900))):
        shots.append(Shot(f"field{i}", "flat", "field", exposure=Exposure(0.03), light="white", window=(*at, 64, 64), frames=2))
    for place, at in (("c", (1472, 1976)), ("f", (500, 700))):
        for focus in (-6.0, 6.0):
            edge = EdgeTarget("edge", angle_deg=5.0)
            shots.append(
                Shot(
                    f"edge_{place}{focus:g}",
                    "edge",
                    f"edge_{place}",
                    exposure=Exposure(0.02),
                    light="white",
                    window=(*at, 80, 80),
                    target=edge,
                    focus_um=focus,
                    distance_m=1.0,
                )
            )
    priors = (
        Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat", "edge")),
        Nuisance("focus_um", 2.0, "um", "set-up", roles=("edge",)),
        Nuisance("edge_shift_px", 0.5, "px", "set-up", roles=("edge",)),
        Nuisance("edge_angle_deg", 0.1, "deg", "set-up", roles=("edge",)),
    )
    return Campaign("lens cost", tuple(shots), lights={"white": white}, nuisances=priors, sensor=sensor)


def diagnosed(kind):
    """CPU seconds of a diagnosis with this first effect, and what it named."""
    import isetval
    from isetval.core.toml import data_folder
    from isetval.effects.optics_blur import Defocus
    from isetval.effects.ray_transfer import RayTransfer

    model = isetval.load_model(data_folder() / "pixel4a")
    if kind == "ray_transfer":
        kept = [e for e in model.effects if e.name not in RayTransfer.replaces]
        model = replace(model, effects=(RayTransfer(file=LENS, focus_distance_m=1.0), *kept), path=None)
    else:
        first, *others = model.effects
        model = replace(model, effects=(first, Defocus(), *others), path=None)
    noisy = [replace(e, sigma_e=HIDDEN_E) if e.name == "read_noise" else e for e in model.effects]
    captures = isetval.simulate(replace(model, effects=tuple(noisy), path=None), plan(model.sensor), seed=5, draw=True)
    cpu = time.process_time()
    found = isetval.diagnose(model, captures, with_next_captures=False)
    return time.process_time() - cpu, ",".join(e.name for e in found.effects) or found.verdict


def rows():
    """Times of both, and their ratio."""
    out, seconds = [], {}
    for kind in KINDS:
        with tempfile.TemporaryDirectory() as store:
            one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "XDG_CACHE_HOME": store}
            words = [sys.executable, __file__, kind]
            said = subprocess.run(words, env=os.environ | one, capture_output=True, text=True, check=True).stdout.split()
        seconds[kind] = float(said[0])
        out.append(Row(f"diagnosis with {kind}, cold ({said[1]}), s", "", seconds[kind], 1e3 * seconds[kind]))
    return [*out, Row("with a lens, over one with aperture", f"<= {GOAL}", seconds["ray_transfer"] / seconds["aperture"])]


if __name__ == "__main__":
    if sys.argv[1:]:
        print(*diagnosed(sys.argv[1]))
    else:
        load = os.getloadavg()[0]
        print("\n".join(table_lines(rows(), (load, os.getloadavg()[0]))))
