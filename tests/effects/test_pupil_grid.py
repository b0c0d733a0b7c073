"""Transfer functions of whole pictures, interpolated, against the quadrature at single frequencies."""

import numpy as np
import pytest

from isetval.effects.pupil import CircularPupil

FY, FX = np.fft.fftfreq(180)[:, None], np.fft.rfftfreq(300)[None, :]


@pytest.mark.parametrize(
    "aberrations",
    [
        {"spherical_waves": 0.05, "focus_um": 6.0},
        {"astigmatism_0_waves": 0.06, "astigmatism_45_waves": -0.03},
        {"coma_x_waves": 0.05, "coma_y_waves": 0.02, "focus_um": -3.0},
    ],
)
def test_a_pictures_transfer_function_is_that_of_its_frequencies(aberrations):
    pupil = CircularPupil(1.73, 1.4, 1.73, **aberrations)
    whole = np.broadcast_to(pupil.transfer(FX, FY, np.array(550.0)), (180, 151))
    rng = np.random.default_rng(5)
    row, col = rng.integers(0, 180, 300), rng.integers(0, 151, 300)
    single = pupil.transfer(FX[0, col], FY[row, 0], np.array(550.0))
    assert np.abs(whole[row, col] - single).max() < 1e-4
    assert whole[0, 0] == pytest.approx(1.0, abs=1e-6)
