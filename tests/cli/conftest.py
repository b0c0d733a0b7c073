"""Small campaigns and a runner of commands."""

import json

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.toml import data_folder

WINDOW = (1464, 1968, 32, 32)


@pytest.fixture(scope="session")
def nominal():
    return isetval.load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="session")
def plan(nominal, small_plan):
    return small_plan(nominal.sensor)


@pytest.fixture(scope="session")
def lab(nominal, plan, tmp_path_factory):
    """A campaign folder shot by the nominal camera."""
    from isetval.files.campaign_writer import write_campaign

    folder = tmp_path_factory.mktemp("lab") / "captures"
    return write_campaign(isetval.simulate(nominal, plan, 5), folder, model=nominal)


@pytest.fixture
def run(capsys):
    """Runs a command; returns exit code, stdout, stderr."""

    def runner(*words):
        code = main([str(w) for w in words])
        out, err = capsys.readouterr()
        return code, out, err

    return runner


@pytest.fixture
def run_json(run):
    def runner(*words):
        code, out, err = run(*words, "--json")
        return code, json.loads(out) if out else None, err

    return runner


@pytest.fixture
def flat_dng(tmp_path):
    """An even field: Poisson electrons, gain 0.5 DN/e-, black 64; mean 200 e-."""
    rng = np.random.default_rng(1)
    codes = np.rint(64 + 0.5 * rng.poisson(200.0, (96, 96))).astype(int)
    path = tmp_path / "flat.dng"
    isetval.write_dng(path, isetval.Capture.from_array(codes, time_s=0.01, iso=100, bits=10))
    return path
