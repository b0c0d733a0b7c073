"""Results in a prompt and a notebook: one line, a tidy table with units, JSON, a picture."""

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

import isetval
from isetval.app.plots.drawing import PLOTS
from isetval.core.shown import Drawn, Shown
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

LONGEST_REPR = 500  # characters: a few lines of a terminal


@pytest.fixture(scope="module")
def shown():
    """One result of every kind, from captures of a camera with known numbers."""
    rng = np.random.default_rng(3)

    def frame(mean_e, time_s):
        codes = np.rint(64 + 0.5 * rng.poisson(mean_e, (64, 64)) + rng.normal(0, 1.5, (64, 64)))
        return isetval.Capture.from_array(np.clip(codes, 0, 1023).astype(int), time_s=time_s, iso=100, bits=10, pixel_um=2.0)

    flats = [frame(mean, mean / 1e4) for mean in (50, 200, 600, 1200) for _ in range(2)]
    darks = [frame(0.5 * t * 1e4, t) for t in (0.01, 0.02) for _ in range(3)]
    edge = edge_capture(EdgeTruth(EdgeBlur(gaussian_sigma_px=0.8), angle_deg=6.0))
    boxes = [(4 + 20 * (i // 6) % 60, 18 + 20 * (i // 6) % 60, 2 + 9 * (i % 6), 9 + 9 * (i % 6)) for i in range(18)]
    found = isetval.measure.find_edges(edge)
    return {
        "sfr": isetval.measure.sfr(edge),
        "refused": isetval.measure.sfr(flats[0]),
        "edges": found,
        "profile": isetval.measure.lens_profile(edge, [(0, edge.mosaic.shape[0], 0, edge.mosaic.shape[1])]),
        "transfer": isetval.measure.photon_transfer(flats, dark=darks),
        "dark": isetval.measure.dark(darks),
        "emva": isetval.measure.emva1288(flats, dark=darks),
        "patches": isetval.measure.uniform_patches(flats[:2]),
        "quality": isetval.measure.quality(flats),
        "illumination": isetval.measure.relative_illumination([flats[-1]]),
        "chart": isetval.measure.chart(flats[-1], boxes=boxes),
        "line": isetval.measure.line_profile(flats[-1], (10, 5), (50, 60)),
    }


def _check(result):
    words = repr(result)
    assert words.startswith(type(result).__name__)
    assert len(words) < LONGEST_REPR
    json.loads(json.dumps(result.to_json(), allow_nan=False))
    frame = result.to_frame()
    page = result._repr_html_()
    assert "<table" in page
    if isinstance(result, Drawn):
        assert isinstance(result.plot(), Axes)
        assert page.count("data:image/png;base64,") == 1
    return frame


def test_every_measurement_shows_itself(shown):
    for name, result in shown.items():
        frame = _check(result)
        if name not in ("edges", "quality", "patches"):  # places and verdicts, with units in the columns' names
            assert {"value", "unit"} <= set(frame.columns), name
            assert frame["unit"].astype(bool).all(), name


def test_frames_hold_the_numbers_of_the_result(shown):
    result = shown["transfer"]
    rows = result.to_frame().set_index(["plane", "name"])
    assert rows.loc[("Gr", "gain_dn_per_e"), "value"] == result["Gr"].gain_dn_per_e.value
    curve = shown["sfr"].to_frame().query("name == 'mtf'")
    assert np.array_equal(curve["value"], shown["sfr"].mtf)
    assert f"{shown['sfr'].mtf50_cy_px:.4f}" in repr(shown["sfr"])
    assert "refused" in repr(shown["refused"])


def test_the_loops_results_show_themselves(lab, nominal):
    campaign = isetval.load_campaign(lab)
    table = isetval.measure_campaign(campaign)
    _check(table)
    found = isetval.compare(nominal, campaign)
    assert {"measured", "simulated", "sigma", "unit"} <= set(_check(found).columns)
    assert "pixel4a" in repr(found)


@pytest.mark.slow
def test_a_diagnosis_and_a_plan_show_themselves(lab, nominal):
    _check(isetval.diagnose(nominal, isetval.load_campaign(lab)))
    _check(isetval.identify(nominal, isetval.load_campaign(lab), with_next_captures=False))


def test_a_picture_goes_into_given_axes_and_a_class_of_ones_own_can_be_drawn(shown):
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    assert shown["sfr"].plot(axes) is axes

    class Mine(Drawn):
        def headline(self):
            return "mine"

        def to_frame(self):
            return pd.DataFrame()

    with pytest.raises(TypeError, match="Mine has no picture"):
        Mine().plot()
    isetval.plots.draw.register(Mine, lambda result, ax=None: axes)
    assert Mine().plot() is axes


def test_every_drawn_result_of_the_package_has_a_plot():
    kinds = {cls for cls in Drawn.__subclasses__() if cls.__module__.startswith("isetval.")}
    assert kinds == set(PLOTS)
    assert all(issubclass(kind, Shown) for kind in PLOTS)
