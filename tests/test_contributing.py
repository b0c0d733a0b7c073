"""The code of CONTRIBUTING.md, used as its text says: files put into the scanned folders, tests that pass."""

import dataclasses
import importlib
import importlib.util
import inspect
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import isetval
import isetval.effects
import isetval.measure.analyses
from isetval.app.cli import main
from isetval.app.demo import chosen_hidden
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.measure.campaign import analyses

ROOT = Path(__file__).resolve().parents[1]


def _module(path):
    """A file imported as a module."""
    spec = importlib.util.spec_from_file_location(f"contributing_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _failures(module, **fixtures):
    """Names of the tests of a module that an assertion of theirs stops."""
    tests = {name: test for name, test in vars(module).items() if name.startswith("test_")}
    assert tests
    failed = []
    for name, test in tests.items():
        try:
            test(**{key: fixtures[key] for key in inspect.signature(test).parameters})
        except AssertionError:
            failed.append(name)
    return failed


place = _module(ROOT / "tests" / "effects" / "conftest.py").place  # the fixture that the text names


@pytest.fixture
def blocks():
    """Effect, its test, analysis, its test."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S)


def _put(monkeypatch, package, folder, name, code):
    """The file in a folder that is scanned like the package's own."""
    folder.mkdir()
    (folder / f"{name}.py").write_text(code)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    importlib.invalidate_caches()
    monkeypatch.delitem(sys.modules, f"{package.__name__}.{name}", raising=False)


@pytest.fixture
def effect(blocks, tmp_path, monkeypatch):
    _put(monkeypatch, isetval.effects, tmp_path / "effects", "warm_side", blocks[0])
    isetval.effects.catalogue.cache_clear()
    yield blocks[1]
    isetval.effects.catalogue.cache_clear()
    sys.modules.pop("isetval.effects.warm_side", None)


@pytest.fixture
def analysis(blocks, tmp_path, monkeypatch):
    _put(monkeypatch, isetval.measure.analyses, tmp_path / "analyses", "color_ratios", blocks[2])
    analyses.cache_clear()
    yield blocks[3]
    analyses.cache_clear()
    sys.modules.pop("isetval.measure.analyses.color_ratios", None)


def test_the_effect_is_in_the_catalogue_and_can_be_hidden(effect, capsys):
    assert main(["effects", "warm_side"]) == 0
    assert "place 22.5" in capsys.readouterr().out
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    hidden = chosen_hidden(nominal, "warm_side:rate_e_per_s=3")
    names = [e.name for e in nominal.with_effect(hidden).effects]
    assert names.index("dark_current") < names.index("warm_side") < names.index("shot_noise")


def test_the_tests_of_the_effect_pass(effect, place, tmp_path):
    (tmp_path / "test_warm_side.py").write_text(effect)
    assert _failures(_module(tmp_path / "test_warm_side.py"), place=place) == []


def test_the_tests_of_the_effect_fail_for_a_wrong_effect(effect, place, tmp_path, monkeypatch):
    from isetval.effects.warm_side import WarmSide

    (tmp_path / "test_warm_side.py").write_text(effect)
    right = WarmSide.apply

    def doubled(self, signal, context):  # right at the left edge and at its null, wrong by a factor everywhere else
        return signal.with_values(2 * right(self, signal, context).values - signal.values)

    monkeypatch.setattr(WarmSide, "apply", doubled)
    assert _failures(_module(tmp_path / "test_warm_side.py"), place=place) == ["test_edges_and_middle_of_the_sensor"]


def test_the_tests_of_the_analysis_pass(analysis, tmp_path):
    (tmp_path / "test_color_ratios.py").write_text(analysis)
    assert _failures(_module(tmp_path / "test_color_ratios.py")) == []


def test_the_tests_of_the_analysis_fail_for_wrong_error_bars(analysis, tmp_path, monkeypatch):
    from isetval.measure.analyses import color_ratios

    (tmp_path / "test_color_ratios.py").write_text(analysis)
    right = color_ratios.analyze

    def too_sure(*args):
        block = right(*args)
        halved = tuple(dataclasses.replace(m, sigma=m.sigma / 2) for m in block.metrics)
        return dataclasses.replace(block, metrics=halved, correlation=np.eye(2))

    monkeypatch.setattr(color_ratios, "analyze", too_sure)
    assert _failures(_module(tmp_path / "test_color_ratios.py")) == ["test_pulls", "test_the_ratios_share_their_green"]


def test_the_analysis_stands_in_campaigns_and_comparisons(analysis):
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    light = Light("sphere", Spectrum(np.array([390.0, 710.0]), np.array([0.001, 0.001])))
    shot = Shot("flat", "flat", exposure=Exposure(0.01), frames=2, window=(1464, 1968, 32, 32), light="sphere")
    campaign = isetval.simulate(nominal, Campaign("c", (shot,), lights={"sphere": light}, sensor=nominal.sensor), 3)
    rows = [m for m in isetval.measure_campaign(campaign).metrics if m.name == "color_ratio"]
    assert [(m.channel, m.family, m.exposure_s) for m in rows] == [("R", "color_ratio", 0.01), ("B", "color_ratio", 0.01)]
    table = isetval.compare(nominal, campaign).table
    found = table[table.family == "color_ratio"]
    assert len(found) == 2
    assert (found.z.abs() < 4).all()
