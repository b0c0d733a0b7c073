"""A small campaign shot by a camera with more dark current than its model knows, and its comparison."""

import json

import pytest

import isetval
from isetval.app.cli import main
from isetval.core.toml import data_folder

NAMES = ("A_dark0", "A_dark2", "A_flat2", "A_flat4", "A_edge_center_v_z0")


@pytest.fixture(scope="package")
def model():
    return isetval.load_model("isetval:pixel4a")


@pytest.fixture(scope="package")
def captures(model):
    """Shot by a camera with more dark current than its model knows."""
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(NAMES)
    camera = model.with_effect(model.effect("dark_current").changed(rate_e_per_s=2.0))
    return isetval.simulate(camera, plan, seed=3)


@pytest.fixture(scope="package")
def result(model, captures, tmp_path_factory):
    """The comparison of the nominal and the true model, as the command writes it."""
    from isetval.files.campaign_writer import write_campaign

    folder = tmp_path_factory.mktemp("budget")
    write_campaign(captures, folder / "lab", model=model)
    better = model.with_effect(model.effect("dark_current").changed(rate_e_per_s=2.0))
    isetval.camera.model_writer.save_model(isetval.load_model("isetval:pixel4a"), folder / "a.toml")
    better.save(folder / "b.toml")
    (folder / "b.toml").write_text((folder / "b.toml").read_text().replace('name = "pixel4a"', 'name = "mended"', 1))
    words = ["compare", folder / "a.toml", folder / "b.toml", folder / "lab", "-j", 1, "-q", "-o", folder / "c.json"]
    assert main([str(w) for w in words]) == 0
    return json.loads((folder / "c.json").read_text())
