"""What `isetval campaign check` doubts of edges, before anything is measured."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import load_model, simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects.white_tag import WrongWhiteTag
from isetval.files.campaign_check import check_campaign, doubts_of_all

SHOT = {"exposure": Exposure(0.02), "light": "white", "frames": 1, "window": (1464, 1968, 128, 128)}


@pytest.fixture(scope="module")
def campaign():
    """A vertical and a horizontal edge, tilted by 5 and by -4 degrees."""
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    shots = (
        Shot("down", "edge", target=EdgeTarget("down", angle_deg=5.0), **SHOT),
        Shot("across", "edge", target=EdgeTarget("across", angle_deg=-4.0, orientation="horizontal"), **SHOT),
    )
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    return simulate(model, Campaign("edges", shots, lights={"white": white}, sensor=model.sensor), seed=2)


def doubts(campaign, **stated):
    shots = tuple(replace(shot, target=replace(shot.target, **stated.get(shot.name, {}))) for shot in campaign.shots)
    return {row.shot: row.doubts for row in check_campaign(replace(campaign, shots=shots))}


def test_edges_as_stated_are_not_doubted(campaign):
    assert doubts(campaign) == {"down": (), "across": ()}


def test_an_edge_that_is_tilted_the_other_way_is(campaign):
    """Ten degrees are 50 sigmas of any prior of its angle; a diagnosis named motion along 17 degrees in place of 25."""
    found = doubts(campaign, down={"angle_deg": -5.0}, across={"angle_deg": 4.0})
    for name, tilt, stated in (("down", 5.0, "-5"), ("across", -4.0, "4")):
        (words,) = found[name]
        start, end = "its edge is tilted by ", f" degrees, angle_deg says {stated}"
        assert words.startswith(start)
        assert words.endswith(end)
        assert float(words.removeprefix(start).removesuffix(end)) == pytest.approx(tilt, abs=0.5)


def test_an_edge_along_the_other_axis_is(campaign):
    found = doubts(campaign, down={"orientation": "horizontal"})
    assert found["down"] == ("its edge is vertical, orientation says horizontal",)


def test_a_channel_that_the_sensor_has_not_is_a_doubt_and_no_end(campaign):
    """All other shots are checked all the same."""
    shots = tuple(replace(shot, channel="MONO") if shot.name == "down" else shot for shot in campaign.shots)
    found = {row.shot: row.doubts for row in check_campaign(replace(campaign, shots=shots))}
    assert "needs one of R, Gr, Gb, B, G" in found["down"][0]
    assert found["across"] == ()


@pytest.mark.parametrize(
    ("light", "share", "start"),
    [
        (30.0, 0.03, "100 % of the pixels stand at code 994, below"),
        (30.0, 0.0, "100.0 % of the pixels stand at white"),
        (0.5, 0.03, None),
    ],
)
def test_bright_pixels_at_one_code_below_white_are(light, share, start):
    """Such planes are clipped in a model that ends at the stated white, which so compares nothing: a note is all there is."""
    model = load_model(data_folder() / "pixel4a" / "camera.toml").with_effect(WrongWhiteTag(share=share))
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    plan = Campaign("flats", (Shot("flat", "flat", light_level=light, **SHOT),), lights={"white": white}, sensor=model.sensor)
    (row,) = check_campaign(simulate(model, plan, seed=2))
    assert [words.startswith(start) for words in row.doubts] == ([True] if start else [])


def test_a_shot_in_no_light_is_a_doubt(campaign):
    shots = tuple(replace(shot, light=None) if shot.name == "down" else shot for shot in campaign.shots)
    found = {row.shot: row.doubts for row in check_campaign(replace(campaign, shots=shots))}
    assert found == {"down": ("no light: it cannot be compared with a model",), "across": ()}


def test_a_session_that_is_written_otherwise_is_doubted(campaign):
    down = campaign.shots[0]
    names = ("A", "A", "a", "B")
    shots = [replace(down, name=f"{i}", measurement_session=name) for i, name in enumerate(names)]
    assert doubts_of_all(replace(campaign, shots=tuple(shots))) == [
        "measurement_session 'a' (1 shots) is 'A' (2) written otherwise"
    ]
    assert doubts_of_all(campaign) == []


def test_tables_of_the_camera_are_read(campaign, tmp_path):
    """An efficiency whose wavelengths fall was found by `compare` only."""
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n400,0.1,0.1,0.1\n700,0.1,0.1,0.1\n", encoding="utf-8")
    model.replace(replace(model.effect("quantum_efficiency"), file="qe.csv", base=str(tmp_path))).save(tmp_path / "camera.toml")
    named = replace(campaign, camera="camera.toml", folder=tmp_path)
    assert doubts_of_all(named) == []
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n700,0.1,0.1,0.1\n400,0.1,0.1,0.1\n", encoding="utf-8")
    (words,) = doubts_of_all(named)
    assert "do not rise" in words
