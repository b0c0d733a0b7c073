"""Sequences that decode a file at every access: nothing is keyed by the object, and one set-up is held at a time."""

import weakref
from collections.abc import Sequence

import numpy as np
import pytest
from noise_camera import NoiseCamera, series

from isetval.core.capture import Capture
from isetval.measure import dark, emva1288, photon_transfer, quality


class Decoded(Sequence):
    """Captures that are made anew at every access, with a count of accesses and of what is alive."""

    def __init__(self, captures):
        self.files = [(c.mosaic.copy(), c.sensor, c.window, c.exposure) for c in captures]
        self.decoded = [0] * len(captures)
        self.alive, self.most = 0, 0

    def __len__(self):
        return len(self.files)

    def __getitem__(self, number):
        mosaic, sensor, window, exposure = self.files[number]
        capture = Capture(mosaic.copy(), sensor, window, exposure)
        self.decoded[range(len(self))[number]] += 1
        self.alive += 1
        self.most = max(self.most, self.alive)
        weakref.finalize(capture, self._gone)
        return capture

    def _gone(self):
        self.alive -= 1


def numbers(result):
    frame = result.to_frame()
    return dict(zip(zip(frame.iloc[:, 0], frame.iloc[:, 1], strict=True), frame["value"], strict=True))


@pytest.fixture
def captures():
    return series(NoiseCamera(np.random.default_rng(71), (64, 64), cfa="RGGB"), np.geomspace(100, 4500, 12), frames=3)


def test_photon_transfer(captures):
    decoded = Decoded(captures)
    found = photon_transfer(decoded)
    assert numbers(found) == pytest.approx(numbers(photon_transfer(captures)), rel=1e-12, nan_ok=True)
    assert decoded.most <= 3 + 1  # the frames of a set-up, and one that is on its way
    assert max(decoded.decoded) <= 3  # sorted, measured, and of the brightest levels neighbor covariances
    assert sum(decoded.decoded) <= 2 * len(captures) + 4 * 3
    assert decoded.alive == 0  # the result holds none


def test_darks_given_apart_and_the_emva_table(captures):
    darks, flats = Decoded(captures[:2]), Decoded(captures[2:])
    assert numbers(photon_transfer(flats, dark=darks)) == pytest.approx(
        numbers(photon_transfer(captures[2:], dark=captures[:2])), rel=1e-12, nan_ok=True
    )
    again = emva1288(Decoded(captures)).to_frame()["value"]
    assert list(again) == pytest.approx(list(emva1288(captures).to_frame()["value"]), rel=1e-12, nan_ok=True)


def test_darks_that_are_among_the_captures_too_are_left_out_of_the_levels(captures):
    plain = photon_transfer(captures[2:], dark=captures[:2])
    both = photon_transfer(Decoded(captures), dark=Decoded(captures[:2]))
    assert numbers(both) == pytest.approx(numbers(plain), rel=1e-12, nan_ok=True)


def test_dark():
    camera = NoiseCamera(np.random.default_rng(72), (64, 64), cfa="RGGB", dark_e_per_s=3.0)
    captures = [c for t in (0.1, 1.0, 4.0, 8.0) for c in camera.shoot(0.0, 3, time_s=t)]
    decoded = Decoded(captures[::-1])
    found = dark(decoded)
    assert numbers(found) == pytest.approx(numbers(dark(captures)), rel=1e-12, nan_ok=True)
    assert found["R"].frame_means_dn == pytest.approx(dark(captures)["R"].frame_means_dn[::-1], rel=1e-12)
    assert decoded.most <= 3 + 1
    assert max(decoded.decoded) <= 2
    assert decoded.alive == 0


def test_quality(captures):
    decoded = Decoded(captures)
    assert quality(decoded).findings == quality(captures).findings
    assert decoded.most <= 3 + 2  # a set-up, or two frames that are compared
