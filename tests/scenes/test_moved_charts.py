"""A chart that moves by parts of a pixel: pixels see the share of both neighbours, and the inside of a patch does not ring."""

import numpy as np
import pytest

from isetval.core.signal import Moved, Product
from isetval.effects.pupil import CircularPupil
from isetval.scenes.pictures import SpectralPicture
from isetval.scenes.planar import StraightEdge

GRID_NM = np.array([450.0, 550.0, 650.0])
SIDE, MIDDLE = 24, 12
MARGIN_PX = 4  # what is cut from a patch before it is measured
UNIT = np.ones((3, 1, 1))


def chart():
    """A black patch beside a white one that begins in column 12."""
    label = np.zeros((SIDE + 192, SIDE + 192), np.intp)
    label[:, 96 + MIDDLE :] = 1
    return SpectralPicture.of_labels(label, np.tile([0.0, 1.0], (3, 1)), 96)


def square(fx, fy, wavelength_nm):
    """A pixel's aperture."""
    return np.sinc(fx) * np.sinc(fy)


def to_the_right(shift):
    return Moved(lambda wavelength_nm: (shift, 0.0))


@pytest.mark.parametrize("shift", [0.3, -0.3, 1.25])
def test_a_moved_chart_is_the_share_of_both_neighbours(shift):
    """The mean of a pixel over a step that lies ``shift`` px off its border."""
    found = chart().sample(UNIT, Product((to_the_right(shift),)), GRID_NM)
    expected = np.clip(np.arange(SIDE) - (MIDDLE + shift) + 1, 0, 1)
    assert found == pytest.approx(np.broadcast_to(expected, found.shape), abs=2e-6)  # transforms of single precision


@pytest.mark.parametrize("shift", [0.0, 0.3, -0.3])
def test_inside_a_patch_a_moved_chart_is_what_an_exact_edge_is(shift):
    """`StraightEdge` integrates the edge spread function without samples.  A phase in the place of the shares was off by .011."""
    pupil = CircularPupil(f_number=1.73, pixel_um=1.4, diffraction_f_number=1.73)
    transfer = Product((pupil.transfer, square, to_the_right(shift)))
    edge = StraightEdge((0.0, 1.0), np.zeros((SIDE, 1)), (np.arange(SIDE) - MIDDLE + 0.5)[None, :])
    exact = np.broadcast_to(edge.sample(UNIT, transfer, GRID_NM), (3, SIDE, SIDE))
    found = chart().sample(UNIT, transfer, GRID_NM)
    inside = np.r_[: MIDDLE - MARGIN_PX, MIDDLE + MARGIN_PX : SIDE]
    # what is left is the pattern of every second pixel that samples leave of a diffraction limited step, shift or none
    assert found[:, :, inside] == pytest.approx(exact[:, :, inside], abs=2.5e-3)
