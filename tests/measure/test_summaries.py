"""A campaign's summaries return what the camera was planted with."""

from dataclasses import replace

import numpy as np

from isetval import load_campaign, load_model, measure_campaign, simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.captures import MemoryCaptures
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure, Sensor
from isetval.core.toml import data_folder


def test_gain_and_read_noise_of_a_simulated_session_lie_within_their_error_bars():
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    plan = plan.only(s.name for s in plan.shots if s.role in ("dark", "flat"))
    table = measure_campaign(simulate(model, plan, seed=11))
    rows = [m for m in table.metrics if m.summary]
    planted = {"gain_dn_per_e": 0.1707, "read_noise_dn": 2.954 * 0.1707, "dark_current_dn_per_s": 0.261 * 0.1707}
    falloff = [m for m in rows if m.name == "relative_illumination"]
    assert {m.channel for m in falloff} == {"R", "Gr", "Gb", "B"}
    for m in falloff:
        radius_mm = float(m.region.split(" r ")[1].split()[0])
        closed_form = np.cos(np.arctan(radius_mm / 4.38)) ** 4  # the model's own fall-off
        assert abs(m.value - closed_form) < 4 * m.sigma, m
    for name, value in planted.items():
        found = [m for m in rows if m.name == name]
        assert {m.channel for m in found} == {"R", "Gr", "Gb", "B"}
        for m in found:
            assert abs(m.value - value) < 4 * m.sigma, (name, m.channel, m.value, m.sigma)


def test_the_fall_off_of_a_sensor_of_less_than_a_millimetre_is_told_at_its_tenths():
    """The demo's windows on a sensor of a tenth of the pixel pitch behind a tenth of the focal length: the same angles."""
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    captures = simulate(model, plan.only(s.name for s in plan.shots if s.role == "flat"), seed=11)
    frames = {
        shot.name: [replace(c, sensor=replace(c.sensor, pixel_um=0.14)) for c in captures.captures.read(shot.name)]
        for shot in captures.shots
    }
    small = replace(captures, captures=MemoryCaptures(frames), sensor=replace(captures.sensor, pixel_um=0.14))
    rows = [m for m in measure_campaign(small).metrics if m.summary and m.name == "relative_illumination"]
    radii = sorted({float(m.region.split(" r ")[1].split()[0]) for m in rows})
    assert radii == [0.1, 0.2, 0.3]
    for m in rows:
        closed_form = np.cos(np.arctan(float(m.region.split(" r ")[1].split()[0]) / 0.438)) ** 4
        assert abs(m.value - closed_form) < 4 * m.sigma, m


def test_summaries_can_be_left_out():
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    plan = plan.only([s.name for s in plan.shots if s.role == "dark"][:2])
    captures = simulate(model, plan, seed=1)
    plain = measure_campaign(captures, summaries=False)
    assert not any(m.summary for m in plain.metrics)
    assert [m.key() for m in measure_campaign(captures).metrics if not m.summary] == [m.key() for m in plain.metrics]


def test_a_full_frame_flat_gives_the_models_falloff():
    sensor = Sensor(604, 806, pixel_um=7.0, cfa="RGGB", black_dn=64, white_dn=1023, bits=10)
    model = replace(load_model(data_folder() / "pixel4a" / "camera.toml"), sensor=sensor)
    shot = Shot("full", "flat", exposure=Exposure(0.0002), frames=2, light="sphere")
    plan = Campaign("full", (shot,), lights={"sphere": Light("sphere", Spectrum.flat(0.008))}, sensor=sensor)
    rows = [m for m in measure_campaign(simulate(model, plan, seed=5)).metrics if m.name == "relative_illumination"]
    assert len(rows) == 24
    for m in rows:
        radius_mm = float(m.region.split()[1])
        assert abs(m.value - np.cos(np.arctan(radius_mm / 4.38)) ** 4) < 4 * m.sigma, m
