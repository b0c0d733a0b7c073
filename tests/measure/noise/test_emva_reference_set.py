"""A real CCD's EMVA 1288 series (working group's set 001, CC BY-SA 3.0; not in this repository): what its fit says of it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from isetval.core.capture import Capture
from isetval.measure import dark, photon_transfer

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "data" / "real" / "emva1288_set001"
pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="the shared real captures are not beside this checkout")


@dataclass
class Exposure:
    """One set-up of the descriptor: "b" with photons per pixel or "d"."""

    kind: str
    time_s: float
    photons: float
    captures: list


def read_series():
    """Set-ups in the order of the working group's descriptor."""
    out, white = [], 0
    for line in (FOLDER / "EMVA1288_Data.txt").read_text().splitlines():
        words = line.split()
        if words[:1] == ["n"]:
            white = 2 ** int(words[1]) - 1
        elif words[:1] in (["b"], ["d"]):
            out.append(Exposure(words[0], float(words[1]) * 1e-9, float(words[2]) if words[0] == "b" else 0.0, []))
        elif words[:1] == ["i"]:
            codes = cv2.imread(str(FOLDER / words[1].replace("\\", "/")), cv2.IMREAD_UNCHANGED)
            exposure = out[-1]
            exposure.captures.append(
                Capture.from_array(codes.astype(np.uint16), cfa="MONO", black_dn=0, white_dn=white, time_s=exposure.time_s)
            )
    return out


@pytest.fixture(scope="module")
def setups():
    return read_series()


@pytest.fixture(scope="module")
def transfer(setups):
    pairs = [s for s in setups if s.kind == "b" and len(s.captures) == 2]
    darks = next(s for s in setups if s.kind == "d").captures
    photons = [s.photons for s in pairs for _ in s.captures]
    lit = [c for s in pairs for c in s.captures]
    return photon_transfer(lit, dark=darks)["MONO"], photon_transfer(lit, dark=darks, photons_per_pixel=photons)["MONO"]


def test_gain_and_efficiency_agree_with_what_others_found(transfer):
    by_time, by_photons = transfer
    for found in transfer:
        # weighted line .283, quadratics .289 to .291 (guide on sensors, sections 3 and 8); all within 2 %
        assert abs(found.gain_dn_per_e.value - 0.288) < 0.02 * 0.288
        assert found.gain_dn_per_e.sigma < 0.01 * found.gain_dn_per_e.value
    assert abs(by_time.gain_dn_per_e.value - by_photons.gain_dn_per_e.value) < by_time.gain_dn_per_e.sigma
    # the reference code: 45.2 % with K .280, that is 12.66 DN per 100 photons; a bent response starts steeper than its chord
    dn_per_photon = by_photons.quantum_efficiency.value / 100 * by_photons.gain_dn_per_e.value
    assert dn_per_photon == pytest.approx(0.452 * 0.28006, rel=0.03)


def test_light_stays_on_two_microseconds_longer_than_stated(transfer):
    by_time, _ = transfer
    assert "exposure_offset" in by_time.flags
    # the mean at 40 us lies .83 DN above the line of the others, 385 DN/ms
    assert by_time.exposure_offset.value == pytest.approx(-0.83 / 385e3, rel=0.3)


def test_the_poor_fit_is_a_fixed_function_of_the_level_not_noise(setups, transfer):
    """25 independent pairs at one exposure repeat the departure of the curve's neighboring level, and scatter as they should."""
    by_time, _ = transfer
    assert "poor_fit" in by_time.flags
    assert 0.5 < by_time.level_scatter_percent < 1.2
    many = next(s for s in setups if s.kind == "b" and len(s.captures) == 50).captures
    variances = []
    for first, second in zip(many[::2], many[1::2], strict=True):
        difference = (first.mosaic.astype(float) - second.mosaic) / np.sqrt(2)
        variances.append(np.var(difference - difference.mean(axis=1, keepdims=True)) * 640 / 639)
    sampling = np.mean(variances) * np.sqrt(2 / (640 * 480))
    assert np.std(variances, ddof=1) == pytest.approx(sampling, rel=4 / np.sqrt(2 * 24))
    levels = [level for level in by_time.levels if level.used]
    black = by_time.black_dn.value
    mean = np.mean([c.mosaic.mean() for c in many]) - black
    near = min(levels, key=lambda level: abs(level.mean_dn - mean))
    others = [level for level in levels if level.numbers != near.numbers]
    smooth = np.polynomial.Polynomial.fit(
        [level.mean_dn for level in others], [level.variance_dn2 for level in others], 5, w=[1 / v.variance_dn2 for v in others]
    )
    pooled, single = np.mean(variances) / smooth(mean) - 1, near.variance_dn2 / smooth(near.mean_dn) - 1
    assert pooled < -10 * np.sqrt(2 / (640 * 480 * 25))
    assert abs(pooled - single) < 4 * np.sqrt(2 / (640 * 480))


def test_the_converters_codes_are_not_equally_wide(setups):
    """Odd among four: code widths repeat with period 4 by several percent, ten times what counting allows."""
    many = next(s for s in setups if s.kind == "b" and len(s.captures) == 50).captures
    counts = np.sum([np.bincount(c.mosaic.ravel(), minlength=4096) for c in many], axis=0)[1940:2020].astype(float)
    code = np.arange(80) / 80
    smooth = np.exp(np.polynomial.Polynomial.fit(code, np.log(counts), 6)(code))
    width = (counts / smooth - 1).reshape(-1, 4).mean(axis=0)
    assert np.ptp(width) > 0.05
    assert np.ptp(width) > 10 / np.sqrt(counts.sum() / 4)


def test_dark_current_from_mean_and_variance_agree_within_their_errors(setups, transfer):
    captures = [c for s in setups if s.kind == "d" and len(s.captures) == 2 for c in s.captures]
    found = dark(captures)["MONO"]
    gain = transfer[0].gain_dn_per_e
    by_mean = found.dark_current_dn_per_s.over(gain, "e-/s")
    by_variance = found.dark_current_variance_dn2_per_s.scaled(1 / gain.value**2, "e-/s")
    assert abs(by_mean.value - by_variance.value) < 2 * np.hypot(by_mean.sigma, by_variance.sigma)
