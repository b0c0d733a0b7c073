"""Every effect of the catalogue passes the battery; the nominal camera stands on it."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import isetval.effects as effects
from isetval.camera.chain import occurrences
from isetval.camera.model_file import load_model
from isetval.core.context import Context
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.sensor import Exposure
from isetval.core.signal import Signal
from isetval.testing import check_effect

DATA = Path(__file__).parents[2] / "data" / "pixel4a"
STRENGTHS = {
    "cos4": {"delta": 0.5},
    "full_well": {"well_e": 1500.0},
    "quantum_efficiency": {"file": "qe.csv", "base": str(DATA)},
    "ray_transfer": {"file": "isetval:lens/default_lens.json"},
    "raw_filtering": {"weight": 0.1},
    "reset_noise": {"sigma_e": 2.0},
    "black_clip": {"strength": 0.5},
    "exposure_time": {"offset_ms": 0.3, "relative": 0.01},
    "blooming": {"well_e": 2500.0},
    "transient_hits": {"rate_per_mpx_s": 1e4},
    "dust": {"width": 0.2},
    "wrong_white_tag": {"share": 0.95},
    "rolling_flicker": {"frequency_hz": 95.0},  # the battery exposes 0.1 s, whole periods of 100 Hz
}
GUIDE = (
    "defocus diffraction axial_color spherical coma astigmatism field_curvature sensor_tilt decenter cos4 "
    "vignetting veiling_glare ghost lateral_color distortion motion_blur microlens pixel_aperture "
    "charge_diffusion spectral_crosstalk channel_gain cfa_angle_shift ir_leak fluorescence "
    "conversion_gain read_noise dark_current dark_current_nonuniformity dsnu prnu row_fpn column_fpn temporal_row_noise rts "
    "hot_pixels black_level nonlinearity gain_knee full_well quantization brighter_fatter gr_gb_imbalance "
    "pdaf_pixels lag amp_glow temperature_drift exposure_time flicker light_nonuniformity spd_mismatch "
    "black_reflectance chart_tilt interreflection gloss ambient_light position_scale etalon_ripple "
    "gain_map_applied wrong_black_tag black_clip digital_gain raw_filtering lens_correction "
    "linearization_table aperture quantum_efficiency cfa shot_noise ray_transfer pixel_angular_response "
    "interpixel_capacitance correlated_row_noise alternating_columns blooming transient_hits rolling_flicker "
    "amplifier_crosstalk dust gloss_lobe "
)


def test_every_effect_of_the_guide_is_there_by_name():
    assert set(GUIDE.split()) <= set(effects.catalogue())


@pytest.mark.parametrize("name", list(effects.catalogue()))
def test_battery(name):
    cls = effects.catalogue()[name]
    check_effect(cls(**STRENGTHS.get(name, {})))


def test_diagnosis_can_try_every_candidate_from_its_null():
    for name, cls in effects.catalogue().items():
        free = [p for p in cls.parameters() if p.tau is not None and not p.shape]
        assert free or not cls.candidate, f"{name} is a candidate without a parameter to free"


class Borrowed(Effect):
    """An effect of an installed package."""

    name, stage, acts_on, gives = "borrowed", "pixel", "electron", "electron"


def points(monkeypatch, *values):
    found = [EntryPoint(f"p{i}", value, effects.ENTRY_POINTS) for i, value in enumerate(values)]
    monkeypatch.setattr(effects, "entry_points", lambda group: found)
    effects.catalogue.cache_clear()
    monkeypatch.setitem(sys.modules, "borrowed_effects", sys.modules[__name__])


@pytest.fixture(autouse=True)
def _fresh_catalogue():
    yield
    effects.catalogue.cache_clear()


def test_installed_packages_add_effects(monkeypatch):
    points(monkeypatch, "borrowed_effects:Borrowed")
    assert effects.catalogue()["borrowed"] is Borrowed


def test_broken_extensions_are_refused_by_name(monkeypatch):
    points(monkeypatch, "no_such_package:Thing")
    with pytest.raises(InputError, match=r"no_such_package:Thing.*mend or uninstall"):
        effects.catalogue()
    points(monkeypatch, "borrowed_effects:GUIDE")
    with pytest.raises(InputError, match="not an effect"):
        effects.catalogue()


def test_an_extension_cannot_take_a_name_in_use(monkeypatch):
    points(monkeypatch, "borrowed_effects:Borrowed", "isetval.effects.electrons:Prnu")
    assert "prnu" in effects.catalogue()  # the same class twice is no clash
    monkeypatch.setattr(Borrowed, "name", "prnu")
    effects.catalogue.cache_clear()
    with pytest.raises(InputError, match="'prnu' is in use"):
        effects.catalogue()


def chain(model, signal, context):
    for effect, nth in zip(model.effects, occurrences(model.effects), strict=True):
        signal = effect.apply(signal, context.for_effect(effect.name, nth))
    return signal.values[0]


@pytest.fixture(scope="module")
def camera():
    return load_model(DATA / "camera.toml")


def test_nominal_camera_exposes_an_even_field_as_a_hand_calculation_says(camera):
    """E = pi L / (4 N^2); electrons by the trapezoid rule over the published bands; DN = 64 + g N."""
    level, time_s = 0.002, 0.01
    context = Context(sensor=camera.sensor, window=(1384, 1888, 256, 256), exposure=Exposure(time_s=time_s), seed=3)
    grid = camera.wavelength_nm
    scene = Signal.of(np.full((grid.size, 1, 1), level), "radiance", shape=(256, 256), wavelength_nm=grid)
    dn = chain(camera, scene, context)
    rows = [line.split(",") for line in (DATA / "qe.csv").read_text().splitlines() if line[0].isdigit()]
    table = np.array(rows, float)
    irradiance = np.pi * level / (4 * 1.73**2)
    for channel, plane in enumerate((dn[::2, ::2], dn[::2, 1::2], dn[1::2, 1::2])):
        qe = np.interp(grid, table[:, 0], table[:, channel + 1])
        photons = irradiance * grid * 1e-9 / (6.62607015e-34 * 299792458.0) * (1.4e-6) ** 2 * time_s
        electrons = np.trapezoid(photons * qe, grid) + 0.261 * time_s
        # cos^4 over the middle: 1 - 2 (r/f)^2 on average, r^2 = (2 x 256^2/12) px^2
        electrons *= 1 - 2 * (2 * 256**2 / 12) * (1.4e-3 / 4.38) ** 2
        sd = np.sqrt(electrons * (1 + 0.0054**2 * electrons) + 2.954**2 + 0.497**2) * 0.1707 / 128
        assert plane.mean() == pytest.approx(64 + 0.1707 * electrons, abs=5 * sd)


def test_nominal_camera_in_the_dark_has_the_published_noise(camera):
    context = Context(sensor=camera.sensor, window=(0, 0, 256, 256), exposure=Exposure(time_s=0.01), seed=3)
    grid = camera.wavelength_nm
    dark = Signal.of(np.zeros((grid.size, 1, 1)), "radiance", shape=(256, 256), wavelength_nm=grid)
    dn = chain(camera, dark, context)
    expected = 0.3311  # DN^2 at .504 DN read noise with DSNU, black on an integer: exact quantisation, not sigma^2 + 1/12
    assert dn.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / dn.size) + 2e-3)


def test_adding_an_effect_leaves_the_noise_of_the_others(camera):
    grid = camera.wavelength_nm
    context = Context(sensor=camera.sensor, window=(0, 0, 64, 64), exposure=Exposure(time_s=0.01), seed=3, mode="derivative")
    light = Signal.of(np.full((grid.size, 1, 1), 0.002), "radiance", shape=(64, 64), wavelength_nm=grid)
    plain = camera.replace(camera.effect("quantization").changed(step_dn=0.0))
    more = plain.add(effects.catalogue()["row_fpn"](sigma_dn=0.7)).add(effects.catalogue()["reset_noise"](sigma_e=0.0))
    difference = chain(more, light, context) - chain(plain, light, context)
    assert difference[:, 0].std() > 0.3  # the rows' offsets are there
    np.testing.assert_allclose(difference - difference[:, :1], 0.0, atol=1e-9)  # and nothing else has changed
