"""A named effect in another form than its own: what is said of it, and what is drawn."""

import re

import numpy as np

from isetval.app.report.form_plot import form_plot
from isetval.app.words import effect_words, shortfall_words, verdict_words

AT = np.linspace(0, 1, 5)
EFFECT = {
    "name": "vignetting",
    "parameters": {
        "v": {"value": 0.1, "sigma": 0.01, "unit": "1", "nominal": 0.0},
        "free_1": {"value": -0.7, "sigma": 0.1, "unit": "prior widths", "nominal": 0.0},
    },
    "present_in_model": False,
    "curve": {
        "axis": "field radius",
        "unit": "half diagonals",
        "quantity": "factor on the light",
        "at": list(AT),
        "value": {"": list(1 - 0.2 * AT)},
        "sigma": {"": [0.01] * 5},
        "own": {"": list(1 - 0.1 * AT**2)},
    },
}


def test_the_curve_is_drawn_with_its_band_and_its_own_form():
    picture = form_plot(EFFECT)
    points = re.search(r'<polygon points="([^"]*)"', picture).group(1).split()
    heights = np.array([float(p.split(",")[1]) for p in points])
    # four standard deviations apart everywhere, on the scale of the two lines: .2 of fall between first and last value
    line = re.findall(r'<polyline points="([^"]*)" class="curve grey"', picture)[0].split()
    fall = float(line[-1].split(",")[1]) - float(line[0].split(",")[1])
    np.testing.assert_allclose(heights[:5] - heights[5:][::-1], fall * 0.04 / 0.2, atol=0.2)
    assert picture.count("<polyline") == 2
    assert form_plot(EFFECT | {"curve": None}) == ""


def test_words_say_form_of_and_leave_the_curve_to_the_picture():
    assert effect_words(EFFECT) == "form of vignetting (free along the field radius): v 0.100 +- 0.010"
    assert shortfall_words(EFFECT) == "lacks a form of vignetting"
    assert "form of vignetting" in verdict_words({"verdict": "attributed", "effects": [EFFECT]})
    plain = {k: v for k, v in EFFECT.items() if k != "curve"}
    assert shortfall_words(plain) == "lacks vignetting"
