"""Lenses for tests: a textbook lens from its own numbers, and the published one where it lies beside the checkout."""

from pathlib import Path

import numpy as np
import pytest

from isetval.lens import RayTransferLens, load_lens
from isetval.lens.pass_region import EllipseRegion
from isetval.lens.polynomials import OutputPolynomial, RayPolynomials
from isetval.lens.tracing import WavelengthTable

FOCAL_MM, BACK_MM = 4.4, 0.46
PIXEL_4A = Path(__file__).resolve().parents[3] / "shared/data/pixel4a/rtf_pixel4a_rear_ellipse_poly4.json"


def polynomial(**terms):
    """``r1x0y2=3.0`` is 3 r dy^2."""
    powers = [[int(name[1]), int(name[3]), int(name[5])] for name in terms]
    return OutputPolynomial(np.array(powers), np.array(list(terms.values())))


def textbook_table(wavelength_nm, radius_mm, focal_mm=FOCAL_MM):
    """A thin lens with its stop, ``FOCAL_MM`` before the input plane.

    dx/dz is expanded as dx (1 + (dx^2 + dy^2) / 2); what leaves bends by -position / f.
    """
    h, k = FOCAL_MM, 1 / focal_mm
    place = {"r0x1y0": h, "r0x3y0": h / 2, "r0x1y2": h / 2}
    place_y = {"r1x0y0": 1.0, "r0x0y1": h, "r0x0y3": h / 2, "r0x2y1": h / 2}
    bent = {"r0x1y0": 1 - h * k, "r0x3y0": -h * k / 2, "r0x1y2": -h * k / 2}
    bent_y = {"r1x0y0": -k, "r0x0y1": 1 - h * k, "r0x0y3": -h * k / 2, "r0x2y1": -h * k / 2}
    outputs = {
        "outx": polynomial(**place),
        "outy": polynomial(**place_y),
        "outz": polynomial(r0x0y0=h - BACK_MM),
        "outdx": polynomial(**bent),
        "outdy": polynomial(**bent_y),
        "outdz": polynomial(r0x0y0=1.0),
    }
    positions = np.linspace(0, 3.8, 20)
    radii = np.full((20, 2), radius_mm)
    return WavelengthTable(wavelength_nm, EllipseRegion(positions, np.zeros((20, 2)), radii, h), RayPolynomials(outputs))


def textbook_lens(radius_mm=0.6, *, tables=None):
    return RayTransferLens("textbook", FOCAL_MM - BACK_MM, BACK_MM, 0.0, tables or (textbook_table(550.0, radius_mm),))


def focused_film_mm(object_m):
    """Film distance that is conjugate to an object, by the thin lens's formula."""
    return BACK_MM + FOCAL_MM**2 / (object_m * 1e3 - FOCAL_MM)


def pixel_4a():
    if not PIXEL_4A.is_file():
        pytest.skip("the published Pixel 4a lens is not beside this checkout")
    return load_lens(PIXEL_4A)
