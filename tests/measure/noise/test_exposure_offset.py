"""Light that starts late, photon numbers, and no response at all: what the means are held against, and what is said of it."""

import numpy as np
import pytest

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure import emva1288, photon_transfer, quality
from isetval.measure.noise.linearity import exposure_offset, mean_response

GAIN, READ_E, BLACK, EFFICIENCY = 0.021, 18.0, 3.3, 0.55  # an 8-bit industrial camera's numbers
STEP_S = 1e-3


def light_that_starts_late(seed, start_s, levels=16, side=96, flicker=0.0):
    """Pairs at 0, 1, 2 ... ms and their photons per pixel; mean proportional to t - start, 8 bits."""
    rng = np.random.default_rng(seed)
    offsets, response = 10 * rng.standard_normal((side, side)), 1 + 0.006 * rng.standard_normal((side, side))
    captures, photons = [], []
    for time_s in STEP_S * np.arange(levels):
        light = 11000 * max(time_s - start_s, 0.0) / (STEP_S * (levels - 1) - start_s) * rng.uniform(1 - flicker, 1)
        for _ in range(2):
            charge = rng.poisson(light * response) + offsets + READ_E * rng.standard_normal((side, side))
            codes = np.clip(np.round(GAIN * charge + BLACK), 0, 255).astype(np.uint16)
            # an exposure of 0 is no exposure time: a capture holds None for it
            captures.append(Capture.from_array(codes, cfa="MONO", black_dn=BLACK, white_dn=255, time_s=float(time_s) or None))
            photons.append(light / EFFICIENCY)
    return captures, photons


@pytest.mark.parametrize("start_s", [0.0, 0.5 * STEP_S, 0.97 * STEP_S], ids=["at once", "half a step", "second exposure"])
def test_gain_where_light_starts_late(start_s):
    pulls = []
    for seed in range(4):
        captures, photons = light_that_starts_late(seed, start_s)
        for stated in (None, photons):
            found = photon_transfer(captures, photons_per_pixel=stated)["MONO"]
            gain = found.gain_dn_per_e
            pulls.append((gain.value - GAIN) / gain.sigma)
            assert gain.sigma < 0.03 * GAIN
            assert found.linearity_from == ("exposure times" if stated is None else "photon numbers")
            if stated is None and start_s:
                # half a DN of black, .46 % of the top step, is what a dark taken from the weakest light may be off by
                assert abs(found.exposure_offset.value - start_s) < 4 * found.exposure_offset.sigma + 0.02 * STEP_S
                assert "exposure_offset" in found.flags
            else:
                assert found.exposure_offset.value == 0
                assert "exposure_offset" not in found.flags
    # pairs share frames with and without photons: four independent pulls, each twice
    assert np.mean(np.square(pulls)) < 1 + 4 * np.sqrt(2 / 4)


def test_quantum_efficiency_from_stated_photons():
    captures, photons = light_that_starts_late(11, 0.97 * STEP_S)
    found = photon_transfer(captures, photons_per_pixel=photons)["MONO"].quantum_efficiency
    assert abs(found.value - 100 * EFFICIENCY) < 4 * found.sigma
    assert found.sigma < 2.0
    table = emva1288(captures, photons_per_pixel=photons)
    assert table["MONO", "eta"].value == pytest.approx(found.value, rel=1e-12)
    # and from a rate, over the time that the light was on
    rate = 11000 / EFFICIENCY / (15 * STEP_S - 0.97 * STEP_S)
    by_time = emva1288(captures, photons_per_pixel_s=rate)["MONO", "eta"]
    assert abs(by_time.value - 100 * EFFICIENCY) < 4 * by_time.sigma + 0.02 * by_time.value
    with pytest.raises(InputError, match="3 entries"):
        photon_transfer(captures, photons_per_pixel=photons[:3])


def test_light_that_never_stands_still_leaves_variance_against_mean_alone():
    captures, _ = light_that_starts_late(12, 0.0, flicker=0.5)
    found = photon_transfer(captures)["MONO"]
    assert abs(found.gain_dn_per_e.value - GAIN) < 4 * found.gain_dn_per_e.sigma
    assert {"means_not_linear_in_time", "variance_against_mean_alone"} & set(found.flags)


def test_a_response_that_cannot_be_inverted_is_not_used():
    time = np.linspace(1, 10, 10)
    mean = 100 * time * (1 - 0.06 * time)  # falls from the eighth on
    found = mean_response(mean, np.full(10, 0.01), time_s=list(time), photons=[None] * 10)
    assert found.basis == "none"
    assert not found.known


def test_the_offset_in_closed_form():
    time = np.array([0.5, 1.0, 1.6, 2.5, 4.0, 6.0, 8.0])
    linear = 300 * (time - 0.4)
    for bend in (0.0, 0.03):
        mean = linear * (1 - bend * linear / linear[-1])
        found = exposure_offset(time, mean, np.full(7, 0.02))
        assert found is not None
        assert found.value == pytest.approx(0.4, abs=1e-3)  # the fit has the exact form: what is left is rounding and jitter
    assert exposure_offset(time, 300 * time, np.full(7, 0.02)) is None
    # an intercept within the black level's error is none of the light
    assert exposure_offset(time, linear, np.full(7, 0.02), black_sigma_dn=60.0) is None


def test_quality_tells_a_late_light_from_a_wrong_black_tag():
    captures, _ = light_that_starts_late(13, 0.6 * STEP_S)
    assert "exposure_offset" in quality(captures).reasons
    assert "black_level_differs_from_tag" not in quality(captures).reasons
