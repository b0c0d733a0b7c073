# %% [markdown]
# # Regression-test a camera model
# A camera model is software, and its numbers should not move unnoticed. The pytest plugin that comes with the package stores metrics with
# their error bars, and fails in words when one leaves them.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

import isetval
from isetval.core.toml import data_folder

folder = Path(tempfile.mkdtemp())
model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
model.save(folder / "camera.toml")

# %% [markdown]
# The test shoots a small plan with the model and checks the gain and the read noise that the ruler finds.

# %%
(folder / "test_camera.py").write_text(
    """
from pathlib import Path

import isetval
from isetval.core.toml import data_folder

HERE = Path(__file__).parent


def test_gain_and_read_noise(metric_check):
    names = ["A_dark0", *(f"A_flat{i}" for i in range(6))]
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(names)
    shot = isetval.simulate(isetval.load_model(HERE / "camera.toml"), plan, seed=7)
    flats = [frame for name in names[1:] for frame in shot.captures.read(name)]
    found = isetval.measure.photon_transfer(flats, dark=shot.captures.read("A_dark0"))["Gr"]
    for name in ("gain_dn_per_e", "read_noise_e"):
        quantity = getattr(found, name)
        metric_check(name, quantity.value, quantity.sigma, unit=quantity.unit)
"""
)


def run_tests(*options: str) -> subprocess.CompletedProcess:
    """Pytest in the folder, as a person or a CI job would run it."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


# %% [markdown]
# Store the numbers once, with a reason; from then on the test holds them.

# %%
assert run_tests("--isetval-update", "first version of the model").returncode == 0
assert run_tests().returncode == 0
print((folder / "stored_metrics" / "test_camera.json").read_text())

# %% [markdown]
# Somebody changes the model: 20 % more gain. The test says what moved, by how much, and how much was allowed.

# %%
gain = model.effect("conversion_gain")
model.with_effect(gain.changed(gain_dn_per_e=1.2 * gain.gain_dn_per_e)).save(folder / "camera.toml")
done = run_tests()
print("\n".join(line for line in done.stdout.splitlines() if line.startswith("E ")))
assert done.returncode == 1
assert "gain_dn_per_e: now" in done.stdout

# %% [markdown]
# The same on the command line, against captures: `isetval compare model.toml captures/ --limits limits.toml` ends with exit code 1 when a
# family of metrics leaves its limits, and `isetval rerun result.json` lists every number that moved since a result was written.
