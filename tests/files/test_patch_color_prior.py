"""How far off colors are that another camera's curves and a published chart stand in for, from the embedded tables."""

import numpy as np
import pytest

from isetval.core.scene import read_spectra
from isetval.core.toml import data_folder
from isetval.files.draft_priors import PATCH_COLOR

BANDS_NM = np.arange(400.0, 701.0, 5.0)
CHART_RMS = 0.06  # of a real chart off the published averages (`analyses/chart24_reflectances.py`)


def at_bands(name, columns=None):
    table = read_spectra(data_folder() / name)
    return np.array([table[c].at(BANDS_NM) for c in columns or table])


def seen(camera, light):
    """(channels, 24): logarithms of what each channel sees of each patch, its mean over the patches taken out."""
    lit = at_bands(f"{camera}/qe.csv", ("R", "G", "B")) * at_bands("spectra/illuminants.csv", (light,))
    logs = np.log(lit @ at_bands("spectra/chart24.csv").T)
    return logs - logs.mean(axis=1, keepdims=True)


@pytest.mark.parametrize(("light", "said"), [("D65", 0.074), ("A", 0.080)])
def test_the_drafted_width_is_that_between_two_cameras_and_of_a_chart(light, said):
    apart = float(np.std(seen("pixel4a", light) - seen("flea3", light)))
    assert apart == pytest.approx(said, abs=5e-4)  # as the constant's reason says
    assert np.hypot(apart, CHART_RMS) == pytest.approx(PATCH_COLOR, abs=0.005)
