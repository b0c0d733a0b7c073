"""Charts in narrow bands at many exposures are dealt into parts: exposures in turn, one band to judge by, one colour."""

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.capture import Capture
from isetval.core.captures import MemoryCaptures
from isetval.core.scene import ChartTarget, Patch, Spectrum, narrow_band
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.files.campaign_tables import Spectra
from isetval.files.campaign_writer import write_campaign
from isetval.files.chart_parts import brightest_channel, deal, write_chart_parts

SENSOR = Sensor(32, 48, 3.0, "RGGB", ((0.0, 0.0), (0.0, 0.0)), 255.0, 8)
CHART = ChartTarget(
    "chart", (Patch("white", (4, 28, 4, 22), Spectrum.flat(0.9)), Patch("grey", (4, 28, 26, 44), Spectrum.flat(0.2)))
)
RATE = {450: (0.1, 0.6, 1.0), 500: (0.1, 1.0, 0.8), 550: (0.2, 1.0, 0.1), 650: (1.0, 0.3, 0.1)}  # of R, G, B
TIMES_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def picture(nm, time_s):
    """Codes of both patches on black, clipped at 255: at 1 s the band's brightest colour is."""
    light = np.zeros((32, 48))
    for patch, reflectance in zip(CHART.patches, (0.9, 0.2), strict=True):
        light[patch.box[0] : patch.box[1], patch.box[2] : patch.box[3]] = reflectance
    red, green, blue = RATE[nm]
    rate = np.tile([[red, green], [green, blue]], (16, 24))
    return Capture(np.clip(np.round(400 * time_s * rate * light), 0, 255).astype(np.uint16), SENSOR, (0, 0), Exposure(time_s))


def campaign(bands, times_s=TIMES_S):
    shots, frames = [], {}
    for nm in bands:
        for i, time_s in enumerate(times_s):
            name = f"{nm}_{i}"
            window = Window(0, 0, 32, 48)
            shots.append(Shot(name, "chart", light=f"{nm}nm", exposure=Exposure(time_s), window=window, target=CHART))
            frames[name] = (picture(nm, time_s),)
    lights = {f"{nm}nm": Light(f"{nm}nm", narrow_band(nm, 10.0)) for nm in bands}
    return Campaign("bands", tuple(shots), MemoryCaptures(frames), lights, sensor=SENSOR)


def test_exposures_are_dealt_in_turn_and_a_band_is_left_for_the_judge():
    found = {(s.light, s.exposure.time_s): part for s, part in deal(campaign(RATE))}
    for nm in (450, 500, 650):
        assert [found[f"{nm}nm", t] for t in TIMES_S] == ["learn", "confirm", "judge"] * 2 + ["learn"]
    assert {part for (light, _), part in found.items() if light == "550nm"} == {"judge"}


def test_few_exposures_white_light_and_few_bands():
    assert deal(campaign((450, 650), TIMES_S[:2])) == []
    assert {part for _, part in deal(campaign((450, 650)))} == {"learn", "confirm", "judge"}
    white = campaign((450,))
    lamp = {"450nm": Light("450nm", Spectrum(np.array([380.0, 780.0]), np.array([1.0, 2.0])))}
    assert deal(Campaign("white", white.shots, white.captures, lamp, sensor=SENSOR)) == []


@pytest.mark.parametrize(("nm", "color"), [(450, "B"), (500, "G"), (550, "G"), (650, "R")])
def test_the_brightest_colour_is_read_where_nothing_is_clipped(nm, color):
    one = campaign((nm,))
    assert brightest_channel(one, one.shots) == color


def test_parts_are_written_beside_the_campaign_and_measured_in_one_colour(tmp_path):
    folder = write_campaign(campaign(RATE), tmp_path / "lab")
    files = write_chart_parts(folder / "campaign.toml")
    assert [file.name for file in files] == [f"campaign_{part}.toml" for part in ("learn", "confirm", "judge")]
    learn, confirm, judge = map(isetval.load_campaign, files)
    names = [s.name for part in (learn, confirm, judge) for s in part.shots]
    assert sorted(names) == sorted(s.name for s in isetval.load_campaign(folder).shots)
    rows = isetval.measure_campaign(learn, summaries=False).metrics
    seen = {light: {m.channel for m in rows if m.light == light} for light in ("450nm", "500nm", "650nm")}
    assert seen == {"450nm": {"B"}, "500nm": {"Gr", "Gb"}, "650nm": {"R"}}


def test_a_spectrum_of_somebody_else_is_never_overwritten(tmp_path):
    (tmp_path / "spectra").mkdir()
    mine = tmp_path / "spectra" / "lamp.csv"
    mine.write_text("mine")
    lamp = Spectrum([400.0, 700.0], [1.0, 2.0])
    assert Spectra(tmp_path).write("lamp", {"value": lamp}) == "spectra/lamp_.csv"
    assert Spectra(tmp_path).write("lamp", {"value": lamp}) == "spectra/lamp_.csv"  # the same content is the same file
    assert mine.read_text() == "mine"
