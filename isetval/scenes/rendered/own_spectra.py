"""Spectra of the project's own papers, chart and light, from formulas: nobody's measurement.

A colored paper or paint is ``floor + sum of steps and bumps``: a step is a logistic function of
wavelength (the absorption edge of a dye), a bump a Gaussian.  The parameters were chosen by hand so that
the colors are those the words name.  They serve demonstrations and tests; a study of a real box gives
its own CSV files in the scene file.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.scene import Spectrum
from isetval.scenes.rendered.spectra import LONGEST_NM, SHORTEST_NM

Float = NDArray[np.float64]
GRID_NM: Float = np.arange(SHORTEST_NM, LONGEST_NM + 1, 5.0)
Term = tuple[str, float, float, float]

WHITE_LEVEL = 0.90
PAPERS: dict[str, tuple[float, tuple[Term, ...]]] = {
    # name: floor, terms (kind, center nm, width nm, height)
    "white_paper": (0.0, (("step", 375.0, 12.0, WHITE_LEVEL),)),
    "red_paper": (0.045, (("step", 605.0, 11.0, 0.72), ("bump", 375.0, 30.0, 0.06))),
    "green_paper": (0.085, (("bump", 535.0, 33.0, 0.38), ("step", 720.0, 25.0, 0.07))),
    "black_paint": (0.035, ()),
}
CHART_PATCHES: tuple[tuple[str, float, tuple[Term, ...]], ...] = (
    ("dark_brown", 0.05, (("step", 600.0, 35.0, 0.13),)),
    ("skin_light", 0.20, (("step", 575.0, 22.0, 0.42), ("bump", 440.0, 50.0, 0.05))),
    ("sky_blue", 0.13, (("bump", 465.0, 55.0, 0.22), ("step", 720.0, 20.0, 0.12))),
    ("leaf", 0.05, (("bump", 550.0, 38.0, 0.13), ("step", 705.0, 12.0, 0.22))),
    ("lilac_blue", 0.18, (("bump", 450.0, 45.0, 0.28), ("step", 655.0, 20.0, 0.26))),
    ("blue_green", 0.20, (("bump", 495.0, 60.0, 0.40),)),
    ("orange", 0.05, (("step", 575.0, 14.0, 0.55),)),
    ("deep_blue", 0.05, (("bump", 455.0, 38.0, 0.28), ("step", 700.0, 20.0, 0.14))),
    ("rose", 0.09, (("step", 600.0, 14.0, 0.47), ("bump", 430.0, 40.0, 0.06))),
    ("plum", 0.05, (("bump", 420.0, 40.0, 0.12), ("step", 645.0, 22.0, 0.24))),
    ("lime", 0.06, (("bump", 545.0, 40.0, 0.42), ("step", 560.0, 22.0, 0.28))),
    ("amber", 0.05, (("step", 558.0, 16.0, 0.62),)),
    ("blue", 0.04, (("bump", 445.0, 32.0, 0.27),)),
    ("green", 0.05, (("bump", 530.0, 34.0, 0.28),)),
    ("red", 0.04, (("step", 605.0, 12.0, 0.58),)),
    ("yellow", 0.05, (("step", 515.0, 14.0, 0.68),)),
    ("magenta", 0.12, (("step", 602.0, 13.0, 0.58), ("bump", 430.0, 48.0, 0.22))),
    ("cyan", 0.08, (("bump", 485.0, 52.0, 0.36),)),
    ("grey_1", 0.88, ()),
    ("grey_2", 0.58, ()),
    ("grey_3", 0.36, ()),
    ("grey_4", 0.19, ()),
    ("grey_5", 0.09, ()),
    ("grey_6", 0.035, ()),
)
GREY_PATCHES = tuple(f"grey_{i}" for i in range(1, 7))


def dye_reflectance(floor: float, terms: Sequence[Term]) -> Spectrum:
    """Reflectance ``floor + sum(terms)`` on the project's 5 nm grid; terms are (kind, center, width, height)."""
    value = np.full(GRID_NM.shape, float(floor))
    for kind, center, width, height in terms:
        u = (GRID_NM - center) / width
        value += height * (1 / (1 + np.exp(-u)) if kind == "step" else np.exp(-0.5 * u**2))
    return Spectrum(GRID_NM, value)


def papers() -> dict[str, Spectrum]:
    """Reflectances of the box's papers by name."""
    return {name: dye_reflectance(floor, terms) for name, (floor, terms) in PAPERS.items()}


def chart_reflectances() -> dict[str, Spectrum]:
    """The 24 reflectances of the project's chart by name, row by row from top left."""
    return {name: dye_reflectance(floor, terms) for name, floor, terms in CHART_PATCHES}


def lamp(peak_radiance: float = 0.02) -> Spectrum:
    """A warm white LED behind a diffuser: a blue line at 452 nm and a broad phosphor at 590 nm.

    ``peak_radiance`` is the radiance at the phosphor's peak in W/(sr m2 nm).
    """
    phosphor = np.exp(-0.5 * ((GRID_NM - 590.0) / np.where(GRID_NM < 590, 58.0, 68.0)) ** 2)
    blue = 0.42 * np.exp(-0.5 * ((GRID_NM - 452.0) / 11.0) ** 2)
    return Spectrum(GRID_NM, peak_radiance * (phosphor + blue))
