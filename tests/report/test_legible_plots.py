"""Pictures that can be read: labels that do not lie on one another, no axes that are empty or without a scale."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import isetval
from isetval.app.plots import noise, shading
from isetval.app.plots.panels import own_axes, plain_log
from isetval.app.report.charts import ladder_bars
from isetval.app.report.diagnosis_parts import _suspects, candidates
from isetval.app.words import chance_words


def _labels(axis):
    """Extents of the labels that are drawn along x and along y, in pixels."""
    canvas = FigureCanvasAgg(axis.figure)
    canvas.draw()
    out = []
    for scale in (axis.xaxis, axis.yaxis):
        low, high = sorted(scale.get_view_interval())
        ticks = [t for t in (*scale.get_major_ticks(), *scale.get_minor_ticks()) if low <= t.get_loc() <= high]
        boxes = [t.label1.get_window_extent() for t in ticks if t.label1.get_visible() and t.label1.get_text()]
        out.append(boxes)
    return out


def _flats(levels, shape=(64, 64), cfa="MONO"):
    rng = np.random.default_rng(4)
    return [
        isetval.Capture.from_array(np.clip(64 + rng.poisson(level, shape), 0, 1023), cfa=cfa, time_s=1e-4 * level or 1e-4)
        for level in levels
        for _ in range(2)
    ]


@pytest.mark.parametrize("levels", [(400.0,), (60.0, 120.0, 240.0, 480.0), (16.0, 60.0, 170.0, 330.0), (2.0, 20.0, 200.0, 800.0)])
def test_labels_of_a_photon_transfer_do_not_overlap_and_are_at_least_two(levels):
    result = isetval.measure.photon_transfer(_flats(levels), dark=_flats((0.0,)))
    for axis in noise.transfer_figure(result).axes:
        for boxes in _labels(axis):
            assert len(boxes) > 1
            for i, box in enumerate(boxes):
                assert not any(box.overlaps(other) for other in boxes[i + 1 :]), axis.get_ylabel()


def test_labels_of_an_axis_are_told_apart():
    axis = own_axes(None)
    axis.plot([552.425], [552.425], "o")
    axis.set(xscale="log", yscale="log")
    plain_log(axis, "x", "y")
    _labels(axis)
    words = [tick.label1.get_text() for tick in axis.yaxis.get_major_ticks() if tick.label1.get_text()]
    assert len(words) == len(set(words)) > 1


@pytest.mark.parametrize(("cfa", "panels"), [("MONO", 3), ("RGGB", 4)])
def test_the_fall_off_has_no_empty_panel(cfa, panels):
    y, x = np.mgrid[-1:1:96j, -1:1:96j]
    rng = np.random.default_rng(5)
    mosaic = 64 + rng.poisson(800 * (1 - 0.3 * (x**2 + y**2)))
    figure = shading.falloff_figure(isetval.measure.relative_illumination(isetval.Capture.from_array(mosaic, cfa=cfa)))
    drawn = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    assert len(drawn) == panels
    assert all(axis.has_data() for axis in drawn)


def test_the_ladder_of_a_telephone_keeps_the_size_of_its_letters():
    row = {"model": "a", "n": 12, "mean_square_z": 3.0}
    families = ["dark_fixed_neighbour_covariance", "mtf"]
    broad, narrow = (ladder_bars(families, [dict.fromkeys(families, row)], narrow=narrow) for narrow in (False, True))
    # letters of 11 units in a card of 262 px: 6 px and 10 px
    width = {words: float(words.partition('viewBox="')[2].split()[2]) for words in (broad, narrow)}
    assert 11 * 262 / width[narrow] > 9 > 11 * 262 / width[broad]
    assert all(name.replace("_", " ") in narrow for name in families)


def test_suspects_that_chance_cannot_explain_are_sorted_by_what_they_explain():
    def suspect(name, dchi2, p):
        return {"name": name, "dchi2": dchi2, "p_corrected": p, "observable": True, "estimate": {}, "posterior": None}

    rows = candidates({"candidates": [suspect("a", 50.0, 0.0), suspect("b", 9.0, 0.01), suspect("c", 5000.0, 0.0)]})
    assert [(row["name"], row["p"]) for row in rows] == [("c", "< 1e-300"), ("a", "< 1e-300"), ("b", "0.01")]
    assert chance_words(1e-120) == "1e-120"


def test_bars_of_what_is_missing_show_an_effect_once():
    """Four corners of a glow are one effect in its best form, and fit as well as what is named."""

    def suspect(name, dchi2):
        return {"name": name, "dchi2": dchi2, "p_corrected": 0.0, "observable": True}

    corners = [suspect("amp_glow", 90.0), suspect("amp_glow (x0 -0.8)", 98.0), suspect("amp_glow (y0 -0.6)", 95.0)]
    effect = {"name": "dark_current", "equivalent": ["amp_glow"]}
    bars = _suspects({"candidates": [suspect("dark_current", 100.0), *corners, suspect("lag", 20.0)], "effects": [effect]})
    assert [(bar["name"], bar["mark"]) for bar in bars] == [
        ("dark current", "named"),
        ("amp glow (x0 -0.8)", "tied"),
        ("lag", ""),
    ]


def test_the_pattern_of_one_level_is_drawn_from_nothing():
    axis = noise.plot_fixed_pattern(isetval.measure.photon_transfer(_flats((400.0,)), dark=_flats((0.0,))))
    assert axis.get_xlim()[0] == axis.get_ylim()[0] == 0
    assert all(axis.get_ylim()[1] > np.max(line.get_ydata()) for line in axis.lines)
